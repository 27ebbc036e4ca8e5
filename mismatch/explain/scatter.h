#pragma once

#include <span>
#include <string>

#include "mismatch/evidence/evidence.h"

namespace omentum {

/// What each recording has of its own about a mean that all share: the mean is an effect, and what
/// scatters is nuisance.
struct Scatter {
  std::string number;  ///< with all that begin so: "pinch." is pinch.x and pinch.y
  std::string mean;    ///< effect whose atoms are the mean
  double least = 0;    ///< of its standard deviation [unit of the number]
};

/// The standard deviation of what scatters [unit of the number]: the mode of its posterior density,
/// everything else integrated (docs/mismatch.md 5.6), the mean free, so that it does not look like
/// scatter. `believed` is the middle of its prior, and the answer below five recordings, where an
/// estimate would say little. It fails where the evidence leaves a number open.
Result<double> learned_scatter(std::span<const Evidence> recordings, const Scatter& scatter,
                               double believed);

/// The prior of what scatters has this standard deviation.
void set_scatter(const Scatter& scatter, double sd, std::span<Evidence> recordings);

}  // namespace omentum
