#pragma once

#include <cstdint>
#include <vector>

namespace omentum {

/// Permutation of 0 ... count-1 for one epoch of one batch: Fisher-Yates with unbiased bounded
/// draws (rejection) from the counters (slot = epoch, purpose shuffle, episode = batch, step =
/// call). A pure function of its arguments.
std::vector<std::uint32_t> shuffled_rows(std::uint64_t run_seed, std::uint64_t batch,
                                         std::uint32_t epoch, std::uint32_t count);

}  // namespace omentum
