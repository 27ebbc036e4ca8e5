#include "learner/batch.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "core/check.h"
#include "core/rng.h"

namespace omentum {

namespace {

constexpr std::uint8_t kEnd = step_flag::kTerminated | step_flag::kTruncated;

template <typename T>
void append(std::vector<T>& to, const std::vector<T>& from) {
  to.insert(to.end(), from.begin(), from.end());
}

/// Decisions of the running episode before the first step of the segment.
std::uint32_t first_episode_step(const RolloutSegment& s) {
  if (s.episode_end_step.empty()) return s.end_episode_step - s.steps;
  return s.episode_length.front() - (s.episode_end_step.front() + 1);
}

double difference(float a, float b) {
  const double d = std::abs(static_cast<double>(a) - static_cast<double>(b));
  return std::isnan(d) ? std::numeric_limits<double>::infinity() : d;
}

}  // namespace

Batch assemble(std::span<const RolloutSegment> segments, const PolicyShape& shape) {
  OMENTUM_CHECK(!segments.empty());
  std::vector<const RolloutSegment*> ordered;
  for (const RolloutSegment& segment : segments) ordered.push_back(&segment);
  std::sort(ordered.begin(), ordered.end(),
            [](const RolloutSegment* a, const RolloutSegment* b) { return a->slot < b->slot; });

  Batch batch;
  batch.slots = static_cast<int>(ordered.size());
  batch.steps = static_cast<int>(ordered.front()->steps);
  batch.observation_size = shape.observations;
  for (const RolloutSegment* s : ordered) {
    OMENTUM_CHECK(static_cast<int>(s->steps) == batch.steps, "slot {} has {} steps", s->slot,
                  s->steps);
    OMENTUM_CHECK(batch.slot_ids.empty() || batch.slot_ids.back() < s->slot, "slot {} twice",
                  s->slot);
    batch.slot_ids.push_back(s->slot);
    batch.policy_versions.push_back(s->policy_version);
    append(batch.observations, s->observations);
    append(batch.branches, s->actions);
    append(batch.continuous, s->actions_continuous);
    append(batch.log_probs, s->log_probs);
    append(batch.rewards, s->rewards);
    append(batch.values, s->values);
    append(batch.flags, s->flags);
    append(batch.bootstrap_observations, s->bootstrap_observation);
    append(batch.final_observations, s->final_observations);
    std::uint32_t episode_step = first_episode_step(*s);
    for (const std::uint8_t flags : s->flags) {
      batch.episode_step.push_back(episode_step);
      episode_step = (flags & kEnd) != 0 ? 0 : episode_step + 1;
    }
  }
  std::int32_t truncated = 0;
  for (const std::uint8_t flags : batch.flags) {
    batch.final_index.push_back((flags & step_flag::kTruncated) != 0 ? truncated++ : -1);
  }
  return batch;
}

std::vector<std::uint32_t> shuffled_rows(std::uint64_t run_seed, std::uint64_t batch,
                                         std::uint32_t epoch, std::uint32_t count) {
  RandomStream stream(run_seed, epoch, Purpose::kShuffle, batch);
  // Multiply-shift, rejecting the low products that would make it uneven.
  const auto below = [&stream](std::uint32_t bound) {
    const std::uint32_t uneven = (0u - bound) % bound;
    std::uint64_t product = 0;
    do {
      product = std::uint64_t{stream.next()} * bound;
    } while (static_cast<std::uint32_t>(product) < uneven);
    return static_cast<std::uint32_t>(product >> 32);
  };
  std::vector<std::uint32_t> rows(count);
  std::iota(rows.begin(), rows.end(), 0u);
  for (std::uint32_t i = count; i > 1; --i) std::swap(rows[i - 1], rows[below(i)]);
  return rows;
}

LogProbCheck complete_batch(Policy& behaviour, Batch& batch) {
  const std::size_t rows = batch.rows();
  std::vector<float> log_probs(rows);
  std::vector<float> values(rows);
  batch.branch_log_probs.resize(rows * behaviour.shape().columns());
  behaviour.evaluate(batch.observations, batch.branches, batch.continuous, log_probs, values,
                     batch.branch_log_probs);
  batch.bootstrap_values.resize(static_cast<std::size_t>(batch.slots));
  behaviour.estimate(batch.bootstrap_observations, batch.bootstrap_values);
  batch.final_values.resize(batch.final_observations.size() /
                            static_cast<std::size_t>(batch.observation_size));
  behaviour.estimate(batch.final_observations, batch.final_values);

  LogProbCheck check;
  for (std::size_t row = 0; row < rows; ++row) {
    const double log_prob_difference = difference(log_probs[row], batch.log_probs[row]);
    const double value_difference = difference(values[row], batch.values[row]);
    const bool first =
        check.largest_log_prob_difference == 0 && check.largest_value_difference == 0;
    if (first && (log_prob_difference != 0 || value_difference != 0)) {
      check.slot = batch.slot_ids[row / static_cast<std::size_t>(batch.steps)];
      check.step = static_cast<std::uint32_t>(row % static_cast<std::size_t>(batch.steps));
    }
    check.largest_log_prob_difference =
        std::max(check.largest_log_prob_difference, log_prob_difference);
    check.largest_value_difference = std::max(check.largest_value_difference, value_difference);
  }
  return check;
}

}  // namespace omentum
