#pragma once

#include <cstdint>
#include <span>

#include "learner/batch.h"

namespace omentum {

struct AdvantageSettings {
  double gamma = 0.99;
  double lambda = 0.95;
  std::uint32_t time_horizon = 0;    ///< cut and bootstrap every so many steps; 0 = never
  bool bootstrap_truncation = true;  ///< false treats truncation as termination, for study
};

/// Generalised advantage estimation [Schulman16] over a completed batch. `rewards` (n) may be the
/// scaled ones. Writes advantages and returns = advantage + value, n each; sums in double,
/// backwards in time. Other sizes abort, as does a batch that complete_batch() has not seen.
///
///   last step of the segment   next value = V(bootstrap observation)
///   terminated                 next value = 0, nothing flows back over the end
///   truncated                  next value = V(final observation), nothing flows back over the end
///   time horizon               next value = V(next observation), nothing flows back over the cut
void estimate_advantages(const Batch& batch, std::span<const float> rewards,
                         const AdvantageSettings& settings, std::span<float> advantages,
                         std::span<float> returns);

/// Discounted sum of `rewards` (n) from every step to the end of its episode, for whole episodes
/// one after the other in one slot. Nothing follows a terminated one; a truncated one is taken to
/// go on for ever as it ended, with its last reward (with gamma 1: nothing follows). Aborts unless
/// there are as many flags as rewards.
std::vector<float> discounted_returns(std::span<const std::uint8_t> flags,
                                      std::span<const float> rewards, double gamma);

/// Mean and deviation of some advantages, chosen by index; all of them when `indices` is empty. In
/// double, in order.
struct MeanDeviation {
  double mean = 0;
  double deviation = 0;
};
/// `population` divides by n, otherwise by n - 1: of one value the deviation is then 0. Of none the
/// mean is NaN.
MeanDeviation mean_deviation(std::span<const float> values, std::span<const std::uint32_t> indices,
                             bool population);

}  // namespace omentum
