#pragma once

#include <functional>
#include <string>
#include <vector>

#include "mismatch/calibrate/surface_fit.h"

namespace omentum {

/// Where a search begins.
struct Start {
  FitState state;
  /// Recordings whose cloud fits clearly better with the jaws on the other side of the sheet.
  std::vector<std::size_t> mirrored;
  std::string failure;  ///< why the shell gets nowhere; then the state is as believed
};

/// Surfaces of all recordings simulated at a state.
struct Simulated {
  FitState at;
  std::vector<Prediction> predictions;
};

/// Registration, clock and what recordings have of their own, fitted where something was simulated;
/// and the cost there, comparable with that of other states.
double fit_start(SurfaceFit& fit, const Simulated& simulated, const std::vector<std::size_t>& which,
                 int steps, FitState& state);

/// By the shell at several stiffnesses, registration and clock fitted at each; without the
/// recordings that are mirrored, which are looked for one by one before they can spoil the others.
/// Of every recording eight frames at most are looked at.
/// `simulated`: called for every stiffness with its share of the work.
Start find_start(SurfaceFit& fit, const std::vector<std::size_t>& which,
                 const std::function<void(double share)>& simulated);

}  // namespace omentum
