#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/policy.h"
#include "core/types.h"

namespace omentum {

/// E segments of T steps in (slot, step) order: row = slot rank * T + step. Content and order never
/// depend on arrival. Arrays over all n = E T rows unless said otherwise.
struct Batch {
  int slots = 0;                               ///< E
  int steps = 0;                               ///< T
  int observation_size = 0;                    ///< O
  std::vector<std::uint32_t> slot_ids;         ///< E, ascending
  std::vector<std::uint64_t> policy_versions;  ///< E, the weights each segment was collected with
  std::vector<float> observations;             ///< n x O, raw
  std::vector<std::uint8_t> branches;          ///< n x action columns
  std::vector<float> continuous;               ///< n x 4, Gaussian head only
  std::vector<float> log_probs;                ///< joint, of the behaviour policy
  std::vector<float> rewards;
  std::vector<float> values;  ///< of the behaviour policy
  std::vector<std::uint8_t> flags;
  std::vector<std::uint32_t> episode_step;    ///< decisions of the episode before this one
  std::vector<float> bootstrap_observations;  ///< E x O, after the last step
  std::vector<float> final_observations;      ///< F x O, one per truncated step in row order
  std::vector<std::int32_t> final_index;      ///< n, row of final_observations or -1

  // Filled by complete_batch().
  std::vector<float> branch_log_probs;  ///< n x action columns, of the behaviour policy
  std::vector<float> bootstrap_values;  ///< E
  std::vector<float> final_values;      ///< F

  std::size_t rows() const {
    return static_cast<std::size_t>(slots) * static_cast<std::size_t>(steps);
  }
};

/// Joins rollouts that passed check_segment() and did not fail, in any order. Aborts where there
/// are none, where their numbers of steps differ, and for two of one slot.
Batch assemble(std::span<const RolloutSegment> segments, const PolicyShape& shape);

/// Permutation of 0 ... count-1 for one epoch of one batch: Fisher-Yates with unbiased bounded
/// draws [Lemire19] from the counters (slot = epoch, purpose shuffle, episode = batch, step =
/// call). A pure function of its arguments.
std::vector<std::uint32_t> shuffled_rows(std::uint64_t run_seed, std::uint64_t batch,
                                         std::uint32_t epoch, std::uint32_t count);

/// Result of recomputing the log-probabilities and values of a batch.
struct LogProbCheck {
  double largest_log_prob_difference = 0;  ///< must be exactly 0 (docs/learner.md 3.3)
  double largest_value_difference = 0;     ///< must be exactly 0
  std::uint32_t slot = 0;                  ///< where the first difference is
  std::uint32_t step = 0;
};

/// Recomputes log-probabilities and values with the behaviour weights, compares them bit for bit
/// with those received, and fills in what is not sent: log-probabilities per branch, values of
/// bootstrap and final observations. NaN counts as an infinite difference. Aborts where the batch
/// has other sizes than the shape of `behaviour`.
LogProbCheck complete_batch(Policy& behaviour, Batch& batch);

}  // namespace omentum
