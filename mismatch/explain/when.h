#pragma once

#include <string>
#include <utility>
#include <vector>

#include "mismatch/explain/base_fit.h"

namespace omentum {

/// When an effect shows in a recording, on the clock of its cloud.
struct When {
  std::string recording;
  std::vector<std::pair<double, double>> intervals;  ///< in which frames gain by it [s]
  std::vector<std::string> phases;                   ///< of these: rest, lift, hold, return
  double onset = 0, onset_low = 0, onset_high = 0;   ///< 90 % [s]
};

/// Where a recording is better with `model` than with `base`; nothing where no frame clearly is.
/// The onset is a change point: before it the base holds, from then on the model
/// (docs/mismatch.md 5.6).
std::vector<When> when_of(const BaseFit& base, const BaseFit& model);

}  // namespace omentum
