#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/fit/forward.h"
#include "mismatch/fit/likelihood.h"
#include "mismatch/fit/normal_equations.h"
#include "mismatch/fit/unknowns.h"
#include "mismatch/seen/seen_markers.h"

namespace omentum {

/// Numbers of recordings.
using Which = std::vector<std::size_t>;

/// Where all numbers of a fit stand.
struct FitState {
  Eigen::VectorXd shared;            ///< [Layout::shared()]
  std::vector<Eigen::VectorXd> own;  ///< of every recording [Layout::own()]
};

/// A number that is believed.
struct BelievedNumber {
  double value = 0, sd = 0;
};

/// What a fit is set up with beside scene and recordings.
struct FitSetup {
  std::string folder;  ///< meshes of the scene lie beside it
  pb::Priors priors;
  MarkerNotes markers;
  /// Time between the frames of recordings whose clocks count them [s]; none: clocks are right.
  std::optional<BelievedNumber> frame_period = {};
  /// Along each side of the sheet, of the smooth difference between model and tissue.
  int cosines_per_side = 4;
  /// What is stated of the camera's clock holds for each recording by itself, not for all alike.
  bool independent_clocks = false;
  /// What a row says, against beliefs: less than 1 where models differ by more than noise.
  double row_worth = 1;
  std::shared_ptr<Simulator> simulator;
  std::size_t threads = 1;
};

/// Column of a shared number that no simulation derives, of every frame of every recording.
struct DifferenceColumn {
  int column = 0;
  std::vector<std::vector<Eigen::VectorXf>> by;
};

/// What is fitted: recordings, a scene and the numbers that may differ between them. Searches take
/// it const, and any number of them may run on it at a time.
struct FitData {
  pb::Scene scene;  ///< as believed
  Scene made;       ///< of it
  FitSetup setup;
  std::vector<Observation> observations;
  std::vector<Unknown> unknowns;
  Layout layout;
  Beliefs beliefs;
  Likelihood likelihood;
  double least_marker_noise = 0;  ///< measured in holds [m]
  std::vector<DifferenceColumn> differences;
};

/// Every number that unknowns_of() names. Throws Error for a scene that cannot be.
FitData make_fit_data(const pb::Scene& scene, std::vector<Observation> observations,
                      const FitSetup& setup);
/// The same with other unknowns, of which the first is Young's modulus.
void set_unknowns(std::vector<Unknown> unknowns, FitData& data);
/// Where the markers are on the body (bind_markers()). Before any state is made.
void set_markers(std::vector<MarkerPlace> places, FitData& data);

/// A state where everything is as believed.
FitState believed_state(const FitData& data);
/// The scene at a state: of a recording, or with the shared numbers alone.
pb::Scene scene_of(const FitData& data, const FitState& state, std::size_t recording);
pb::Scene shared_scene(const FitData& data, const FitState& state);
/// What stays under the jaws, in B as believed, where size or turn of a sheet change [m].
Eigen::Vector2d held_place(const FitData& data);
Registration6 registration_of(const FitData& data, const FitState& state);

/// Surfaces of recordings simulated at a state, with their derivatives there; of recordings that
/// were not asked for empty.
struct Linearisation {
  FitState at;
  std::vector<Prediction> predictions;
};

/// The state without the smooth difference of a recording.
FitState without_difference(const FitData& data, FitState state, std::size_t recording);
/// A recording against its surfaces, carried from where they were simulated to `state`.
Comparison comparison(const FitData& data, const Linearisation& linear, const FitState& state,
                      std::size_t recording);

/// The prediction of one recording at a state.
Prediction predict_at(const FitData& data, const FitState& state, std::size_t recording,
                      const Numerics& numerics, bool with_columns);

/// slope times (other - base), as a column of a frame.
Eigen::VectorXf difference(const PredictedFrame& other, const PredictedFrame& base, double slope);
/// Adds the shared number `unknown`, whose column is `slope` times (other - base) of the surfaces,
/// now and in every simulation to come; in place of one of that path, else after all others.
void set_difference(const Unknown& unknown, const std::vector<Prediction>& other, double slope,
                    FitData& data, Linearisation& base, FitState& state);

/// All numbers 0 ... count - 1.
std::vector<std::size_t> all_of(std::size_t count);

}  // namespace omentum
