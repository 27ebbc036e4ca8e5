#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/calibrate/arrow_system.h"
#include "mismatch/calibrate/calibration.h"
#include "mismatch/recording/recording.h"

namespace omentum {

/// Where all numbers of a calibration stand.
struct FitState {
  Eigen::VectorXd shared;            ///< [Layout::shared()]
  std::vector<Eigen::VectorXd> own;  ///< of every recording [Layout::own()]
};

/// Least and largest of the shared numbers.
struct Ranges {
  Eigen::VectorXd low, high;  ///< [Layout::shared()]
};

/// Recordings, a scene and what may differ between them: simulates at a state, and improves a state
/// on the simulated surfaces and their derivatives without simulating again. Results do not depend
/// on the number of threads.
class ReferenceFit {
 public:
  ReferenceFit(const pb::Scene& scene, std::vector<Observation> observations,
               const CalibrationOptions& options);

  /// Where the markers are on the body: at the places that are known of them; else over the nearest
  /// point of the surface in the first frame that shows them, of `predictions` as believed with
  /// columns. Those farther from it than 20 mm are on no tissue. Before any state is made.
  void bind_markers(const std::vector<Prediction>& predictions, std::vector<std::string>& warnings);
  /// Not all markers have a known place.
  bool needs_binding() const;
  /// A state where everything is as believed.
  FitState believed() const;
  /// Of the recordings in `which`; others stay empty. Columns: those of the simulation, and what
  /// set_difference() was given. A recording that cannot be simulated at `state` has no valid
  /// frames, and the reason as its failure; before that all are tried with smoother friction, which
  /// stays if it helps.
  std::vector<Prediction> simulate(const FitState& state, const Numerics& numerics,
                                   bool with_columns, const std::vector<std::size_t>& which);
  /// Steps of Gauss and Newton on surfaces simulated at `at`, until they are small against what
  /// the recordings tell. None makes the fit worse, and none leads farther from `at` than `trust`
  /// times what the derivatives hold for, nor out of the ranges of the numbers. Adapts the scale
  /// of the noise.
  void improve(const std::vector<Prediction>& predictions, const FitState& at,
               const std::vector<std::size_t>& which, int most_steps, FitState& state);
  /// - log of likelihood and beliefs, at a noise.
  double cost(const std::vector<Prediction>& predictions, const FitState& at,
              const std::vector<std::size_t>& which, const FitState& state,
              const NoiseModel& noise);
  std::vector<Block> compare(const std::vector<Prediction>& predictions, const FitState& at,
                             const std::vector<std::size_t>& which, const FitState& state,
                             const NoiseModel& noise, bool with_columns);
  /// Covariances at a state.
  ArrowStep posterior(const std::vector<Prediction>& predictions, const FitState& at,
                      const std::vector<std::size_t>& which, const FitState& state);
  /// Scales of what recordings have of their own, from how they came out.
  void adapt_beliefs(const ArrowStep& sure, const std::vector<std::size_t>& which,
                     const FitState& state);
  /// Distances of points from the surface, per frame; own numbers and modes as given.
  std::vector<std::vector<double>> distances(const Prediction& prediction, std::size_t recording,
                                             const FitState& at, const FitState& state,
                                             double reach);
  /// Markers of a recording, a row a frame: where they were seen and where they are predicted,
  /// NAME_seen_x_m ... and NAME_simulated_x_m ...; without columns where it has none on tissue.
  Series marker_table(const Prediction& prediction, std::size_t recording, const FitState& at,
                      const FitState& state);
  /// Predicted vertices as the camera has them.
  std::vector<Eigen::Vector3d> vertices(const Prediction& prediction, std::size_t recording,
                                        std::size_t frame, const FitState& at,
                                        const FitState& state) const;

  void change_law(pb::ElasticLaw law);
  /// Shared nuisance whose column is `slope` times (other - base) of the surfaces, now and in every
  /// simulation to come; in place of one of that path, else after all others.
  void set_difference(const Unknown& unknown, const std::vector<Prediction>& other, double slope,
                      std::vector<Prediction>& base, FitState& at, FitState& state);

  /// Where shared numbers may go from derivatives at `at`.
  Ranges ranges(const FitState& at) const;
  pb::Scene scene_of(const FitState& state, std::size_t recording) const;
  /// With the shared numbers alone.
  pb::Scene shared_scene(const FitState& state) const;
  Registration6 registration(const FitState& state) const;
  Eigen::VectorXd delta(const FitState& at, const FitState& state, std::size_t recording) const;

  pb::Scene scene;
  std::vector<Observation> observations;
  CalibrationOptions options;
  std::vector<Unknown> unknowns;
  Layout layout;
  Beliefs beliefs;
  Beliefs first_beliefs;  ///< before adapt_beliefs()
  NoiseModel noise;
  double trust = 1;                  ///< in the derivatives
  std::optional<double> held_clock;  ///< the camera's is known to be this [s]; else looked for
  bool hold_shared = false;          ///< shared numbers stay where they are in improve()
  std::vector<MarkerPlace> markers;  ///< of Observation::markers
  Scene made;                        ///< of `scene`

  /// Column of a shared number that no simulation derives, of every frame of every recording.
  struct Difference {
    int column = 0;
    std::vector<std::vector<Eigen::VectorXf>> by;
  };
  std::vector<Difference> differences;

 private:
  void set_beliefs();
  void place_known_markers(const std::vector<Eigen::Vector3i>& triangles,
                           const std::vector<Eigen::Vector3d>& rest);
  void tell_markers();
  double least_marker_noise_ = 0;  ///< measured in holds [m]
  double slip_speed_ = 0;  ///< of friction, where the scene's is too sharp to be solved [m/s]
  std::vector<std::unique_ptr<Likelihood>> likelihoods_;
};

/// What of the frames of markers is worth as much as if they were independent: what is left of one
/// is like that of the frame before.
double independent_share(const std::vector<Block>& blocks);

/// All numbers 0 ... count - 1.
std::vector<std::size_t> all_of(std::size_t count);

}  // namespace omentum
