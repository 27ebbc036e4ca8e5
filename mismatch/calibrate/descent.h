#pragma once

#include <functional>
#include <vector>

#include "mismatch/calibrate/surface_fit.h"

namespace omentum {

/// A search between simulations.
struct Descent {
  std::vector<Prediction> predictions;  ///< simulated, with columns
  FitState at;                          ///< where
  FitState state;                       ///< where their derivatives lead
  ArrowStep sure;                       ///< there
  bool settled = false;                 ///< nothing that is simulated moves any more
};

/// Simulates a state with its columns, of every recording that counts. What cannot be simulated has
/// no valid frames (SurfaceFit::simulate).
using SimulateState = std::function<std::vector<Prediction>(const FitState&)>;

/// How far a state is from where it was simulated: the farthest number against how sure it is.
double moved(const SurfaceFit& fit, const std::vector<std::size_t>& which, const FitState& at,
             const FitState& state, const ArrowStep& sure);
inline constexpr double kSmallMove = 0.25;  ///< needs no further simulation

/// Begins with `d.predictions` at `d.at`: improves on the derivatives, simulates, and again, at
/// most so many times, until nothing has moved() by more than `small`. A step after which the
/// simulation fits worse, or after which a recording cannot be simulated any more, is taken back,
/// and the derivatives are trusted less. At the end `d.predictions` are those of the best state
/// that was simulated.
void descend(SurfaceFit& fit, const SimulateState& simulate, const std::vector<std::size_t>& which,
             int most, double small, Descent& d);

}  // namespace omentum
