#pragma once

#include <functional>
#include <string>
#include <vector>

#include "mismatch/fit/forward_model.h"
#include "mismatch/fit/search.h"

namespace omentum {

/// Where a search begins.
struct Start {
  FitState state;
  /// Recordings whose cloud fits clearly better with the jaws on the other side of the sheet.
  Which mirrored;
  std::string failure;  ///< why the shell gets nowhere; then the state is as believed
};

/// Registration, clock and what recordings have of their own, fitted where something was simulated;
/// and the cost there, comparable with that of other states.
struct FittedStart {
  FitState state;
  double cost = 0;
};
FittedStart fit_start(const FitData& data, const Linearisation& simulated, const Which& which,
                      int steps, const SearchLimits& limits);

/// By the shell at several stiffnesses, registration and clock fitted at each; without the
/// recordings that are mirrored, which are looked for one by one before they can spoil the others.
/// Of every recording eight frames at most are looked at.
/// `simulated`: called for every stiffness with its share of the work.
Start find_start(const FitData& data, ForwardModel& model, const Which& which,
                 const std::function<void(double share)>& simulated);

}  // namespace omentum
