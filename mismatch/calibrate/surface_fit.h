#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/calibrate/arrow_system.h"
#include "mismatch/calibrate/calibration.h"

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
/// on the simulated surfaces and their derivatives without simulating again. Which model is
/// simulated, and where its derivatives are from, says what is derived from it. Results do not
/// depend on the number of threads.
class SurfaceFit {
 public:
  SurfaceFit(const pb::Scene& scene, std::vector<Observation> observations,
             const CalibrationOptions& options);
  virtual ~SurfaceFit() = default;

  /// Where the markers are on the body (bind_markers()). Before any state is made.
  void set_markers(std::vector<MarkerPlace> places);
  /// A state where everything is as believed.
  FitState believed() const;
  /// Of the recordings in `which`; others stay empty. Columns: those of the model, and what
  /// set_difference() was given. A recording that cannot be simulated at `state` has no valid
  /// frames, and the reason as its failure.
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
  /// Where the markers of a frame are predicted (Likelihood::marker_places).
  std::vector<Eigen::Vector3d> marker_places(const Prediction& prediction, std::size_t recording,
                                             std::size_t frame, const FitState& at,
                                             const FitState& state);
  const std::vector<Eigen::Vector3i>& triangles() const {
    return likelihoods_.front()->triangles();
  }
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
  /// What stays under the jaws, in B as believed, where size or turn of a sheet change [m].
  Eigen::Vector2d held_place() const;
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
  double chance = 0.5;               ///< of a log likelihood: what equal simulations differ by
  double hold_for = 2;               ///< standard deviations that they do, at most
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

 protected:
  /// Of the recordings in `which`, with the columns that the model has.
  virtual std::vector<Prediction> predict_all(const FitState& state, const Numerics& numerics,
                                              bool with_columns,
                                              const std::vector<std::size_t>& which) = 0;
  /// What cannot be simulated has no valid frames and a failure.
  Prediction predict_one(const FitState& state, std::size_t recording, const Numerics& numerics,
                         bool with_columns) const;
  /// By `unknowns`, after they change.
  void set_beliefs();

 private:
  void tell_markers();
  double least_marker_noise_ = 0;  ///< measured in holds [m]
  std::vector<std::unique_ptr<Likelihood>> likelihoods_;
};

/// What of the frames of markers is worth as much as if they were independent: what is left of one
/// is like that of the frame before.
double independent_share(const std::vector<Block>& blocks);

/// slope times (other - base), as a column of a frame.
Eigen::VectorXf difference(const PredictedFrame& other, const PredictedFrame& base, double slope);

/// All numbers 0 ... count - 1.
std::vector<std::size_t> all_of(std::size_t count);

}  // namespace omentum
