#include "learner/batch.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/check.h"

namespace omentum {

namespace {

constexpr std::uint8_t kKnownFlags = step_flag::kTerminated | step_flag::kTruncated |
                                     step_flag::kFirst | step_flag::kHeld | step_flag::kGraspLost;
constexpr std::uint8_t kEnd = step_flag::kTerminated | step_flag::kTruncated;

template <typename... Args>
Failure failure(fmt::format_string<Args...> format, Args&&... args) {
  return Failure{fmt::format(format, std::forward<Args>(args)...)};
}

template <typename T>
bool all_finite(const std::vector<T>& values) {
  return std::all_of(values.begin(), values.end(), [](T value) { return std::isfinite(value); });
}

Result<void> check_identity(const RolloutSegment& s, const RolloutTask& t) {
  if (s.slot != t.slot || s.segment != t.segment || s.task_hash != t.task_hash) {
    return failure(
        "slot {} segment {} hash {:016x} answers another task (slot {} segment {} hash {:016x})",
        s.slot, s.segment, s.task_hash, t.slot, t.segment, t.task_hash);
  }
  if (s.failed != 0) return failure("failed after {} steps: {}", s.steps, s.failure);
  if (s.steps != t.steps) return failure("{} steps instead of {}", s.steps, t.steps);
  if (s.policy_version != t.policy_version) {
    return failure("policy version {} instead of {}", s.policy_version, t.policy_version);
  }
  return {};
}

Result<void> check_lengths(const RolloutSegment& s, const PolicyShape& shape) {
  const std::size_t steps = s.steps;
  const auto observations = static_cast<std::size_t>(shape.observations);
  const std::size_t episodes = s.episode_end_step.size();
  const auto truncated =
      static_cast<std::size_t>(std::count_if(s.flags.begin(), s.flags.end(), [](std::uint8_t f) {
        return (f & step_flag::kTruncated) != 0;
      }));
  struct Length {
    const char* name;
    std::size_t is, wanted;
  };
  const Length lengths[] = {
      {"flags", s.flags.size(), steps},
      {"observations", s.observations.size(), steps * observations},
      {"actions", s.actions.size(), steps * 4},
      {"actions_continuous", s.actions_continuous.size(), shape.continuous ? steps * 4 : 0},
      {"masks", s.masks.size(), s.masks.empty() || shape.continuous ? 0 : steps},
      {"log_probs", s.log_probs.size(), steps},
      {"rewards", s.rewards.size(), steps},
      {"values", s.values.size(), steps},
      {"bootstrap_observation", s.bootstrap_observation.size(), observations},
      {"final_observations", s.final_observations.size(), truncated * observations},
      {"episode_return", s.episode_return.size(), episodes},
      {"episode_length", s.episode_length.size(), episodes},
      {"episode_outcome", s.episode_outcome.size(), episodes},
      {"episode_exposure", s.episode_exposure.size(), episodes},
      {"episode_grasped", s.episode_grasped.size(), episodes},
      {"episode_held", s.episode_held.size(), episodes},
      {"episode_grasp_position", s.episode_grasp_position.size(), 3 * episodes},
      {"episode_start_position", s.episode_start_position.size(), 3 * episodes},
  };
  for (const Length& length : lengths) {
    if (length.is != length.wanted)
      return failure("{} has {} entries instead of {}", length.name, length.is, length.wanted);
  }
  return {};
}

Result<void> check_numbers(const RolloutSegment& s) {
  const std::pair<const char*, const std::vector<float>*> arrays[] = {
      {"observations", &s.observations},
      {"actions_continuous", &s.actions_continuous},
      {"log_probs", &s.log_probs},
      {"rewards", &s.rewards},
      {"values", &s.values},
      {"bootstrap_observation", &s.bootstrap_observation},
      {"final_observations", &s.final_observations},
      {"episode_exposure", &s.episode_exposure},
      {"episode_start_position", &s.episode_start_position},
  };
  for (const auto& [name, values] : arrays) {
    if (!all_finite(*values)) return failure("{} holds a number that is not finite", name);
  }
  if (!all_finite(s.episode_return))
    return failure("episode_return holds a number that is not finite");
  return {};
}

Result<void> check_actions(const RolloutSegment& s, const PolicyShape& shape) {
  for (std::size_t step = 0; step < s.steps; ++step) {
    int base = 0;
    for (std::size_t b = 0; b < 4; ++b) {
      const int action = s.actions[step * 4 + b];
      const bool used = !shape.continuous && b < shape.branches.size();
      const int size = used ? shape.branches[b] : 1;
      if (action >= size)
        return failure("step {} branch {}: action {} of {}", step, b, action, size);
      if (!used || s.masks.empty()) continue;
      if ((static_cast<unsigned int>(s.masks[step]) >> (base + action) & 1u) == 0) {
        return failure("step {} branch {}: action {} is masked", step, b, action);
      }
      base += size;
    }
  }
  return {};
}

Result<void> check_episodes(const RolloutSegment& s, const RolloutTask& t) {
  std::size_t end = 0;
  std::uint64_t length = t.reset ? 0 : t.episode_step;
  bool fresh = t.reset || t.episode_step == 0;
  for (std::size_t step = 0; step < s.steps; ++step) {
    const std::uint8_t flags = s.flags[step];
    if ((flags & ~kKnownFlags) != 0) return failure("step {}: flags {:#04x}", step, flags);
    if (((flags & step_flag::kFirst) != 0) != fresh)
      return failure("step {}: flag of the first step is wrong", step);
    if ((flags & kEnd) == kEnd) return failure("step {}: terminated and truncated", step);
    fresh = false;
    ++length;
    if ((flags & kEnd) == 0) continue;
    if (end >= s.episode_end_step.size() || s.episode_end_step[end] != step) {
      return failure("step {}: episode_end_step does not name this end", step);
    }
    if (s.episode_length[end] != length) {
      return failure("step {}: episode of {} steps says {}", step, length, s.episode_length[end]);
    }
    if (s.episode_outcome[end] > static_cast<std::uint8_t>(Outcome::kError)) {
      return failure("step {}: outcome {}", step, s.episode_outcome[end]);
    }
    ++end;
    length = 0;
    fresh = true;
  }
  if (end != s.episode_end_step.size())
    return failure("{} episode ends, {} in the flags", s.episode_end_step.size(), end);
  if (s.end_episode_step != length)
    return failure("end_episode_step {} instead of {}", s.end_episode_step, length);
  if (s.end_episode != t.episode + end)
    return failure("end_episode {} instead of {}", s.end_episode, t.episode + end);
  return {};
}

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

Result<void> check_segment(const RolloutSegment& segment, const PolicyShape& shape,
                           const RolloutTask& task) {
  if (Result<void> result = check_identity(segment, task); !result) return result;
  if (Result<void> result = check_lengths(segment, shape); !result) return result;
  if (Result<void> result = check_numbers(segment); !result) return result;
  if (Result<void> result = check_actions(segment, shape); !result) return result;
  return check_episodes(segment, task);
}

Batch assemble(std::span<const RolloutSegment> segments, const PolicyShape& shape) {
  OMENTUM_CHECK(!segments.empty());
  std::vector<const RolloutSegment*> ordered;
  for (const RolloutSegment& segment : segments) ordered.push_back(&segment);
  std::sort(ordered.begin(), ordered.end(),
            [](const RolloutSegment* a, const RolloutSegment* b) { return a->slot < b->slot; });
  const bool masked =
      std::any_of(ordered.begin(), ordered.end(), [](const auto* s) { return !s->masks.empty(); });

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
    if (masked) {
      append(batch.masks, s->masks);
      if (s->masks.empty()) batch.masks.resize(batch.masks.size() + s->steps, 0xFFFF);
    }
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

LogProbCheck complete_batch(Policy& behaviour, Batch& batch) {
  const std::size_t rows = batch.rows();
  std::vector<float> log_probs(rows);
  std::vector<float> values(rows);
  batch.branch_log_probs.resize(rows * 4);
  behaviour.evaluate(batch.observations, batch.branches, batch.continuous, batch.masks, log_probs,
                     values, batch.branch_log_probs);
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
