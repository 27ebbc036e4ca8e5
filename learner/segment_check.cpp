#include "learner/segment_check.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>

#include "core/hash.h"
#include "core/segment_fields.h"

namespace omentum {

namespace {

constexpr std::uint8_t kRolloutFlags = step_flag::kTerminated | step_flag::kTruncated |
                                       step_flag::kFirst | step_flag::kHeld | step_flag::kGraspLost;
constexpr std::uint8_t kEnd = step_flag::kTerminated | step_flag::kTruncated;

template <typename... Args>
Failure failure(fmt::format_string<Args...> format, Args&&... args) {
  return Failure{fmt::format(format, std::forward<Args>(args)...)};
}

bool is_rollout(const RolloutTask& t) { return t.kind == TaskKind::kRollout; }

Result<void> check_identity(const RolloutSegment& s, const RolloutTask& t) {
  if (s.slot != t.slot || s.segment != t.segment || s.task_hash != t.task_hash) {
    return failure(
        "slot {} segment {} hash {:016x} answers another task (slot {} segment {} hash {:016x})",
        s.slot, s.segment, s.task_hash, t.slot, t.segment, t.task_hash);
  }
  if (s.policy_version != t.policy_version) {
    return failure("policy version {} instead of {}", s.policy_version, t.policy_version);
  }
  if (s.state_format != t.state_format) {
    return failure("state format {} instead of {}", s.state_format, t.state_format);
  }
  if (s.source != Source::kSimulation) return failure("not of a simulation: never trained on");
  if (s.failed > 1) return failure("failed is {}", s.failed);
  // A failed one ends early; an evaluation as soon as its hold is over.
  const bool whole = is_rollout(t) && s.failed == 0;
  if (whole ? s.steps != t.steps : s.steps > t.steps)
    return failure("{} steps instead of {}", s.steps, t.steps);
  if (s.failed == 0 && s.steps == 0) return failure("no steps");
  return {};
}

/// Frames before every stride-th step and after the last one, each as wide as the tissue.
bool frames_fit(std::size_t size, const RolloutSegment& s, const RolloutTask& t) {
  if (t.frame_stride == 0) return size == 0;
  const std::size_t frames = s.steps / t.frame_stride + 1;
  return s.failed != 0 || size % (3 * frames) == 0;
}

Result<void> check_lengths(const RolloutSegment& s, const PolicyShape& shape,
                           const RolloutTask& t) {
  const auto truncated =
      is_rollout(t)
          ? std::count_if(s.flags.begin(), s.flags.end(),
                          [](std::uint8_t flags) { return (flags & step_flag::kTruncated) != 0; })
          : 0;
  const auto rows_of = [&](Rows rows) -> std::size_t {
    switch (rows) {
      case Rows::kStep:
        return s.steps;
      case Rows::kRecordedStep:
        return t.frame_stride > 0 ? s.steps : 0;
      case Rows::kEpisode:
        return s.episode_end_step.size();
      case Rows::kTruncation:
        return static_cast<std::size_t>(truncated);
      case Rows::kEnd:
      case Rows::kFrame:
      case Rows::kState:
        break;
    }
    return 1;
  };
  Result<void> result;
  for_each_array(s, [&](const auto& array, const ArrayField& field) {
    if (!result || field.rows == Rows::kState) return;
    if (field.rows == Rows::kFrame) {
      if (!frames_fit(array.size(), s, t))
        result = failure("{} has {} entries, no whole frames", field.name, array.size());
      return;
    }
    const std::size_t width = field.width == kObservationWidth
                                  ? static_cast<std::size_t>(shape.observations)
                              : field.width == kActionWidth ? shape.columns()
                                                            : field.width;
    std::size_t wanted = rows_of(field.rows) * width;
    const void* self = &array;
    if (self == &s.actions_continuous && !shape.continuous) wanted = 0;
    // A failed segment may end without an observation.
    const bool absent = field.rows == Rows::kEnd && s.failed != 0 && array.empty();
    if (array.size() != wanted && !absent)
      result = failure("{} has {} entries instead of {}", field.name, array.size(), wanted);
  });
  return result;
}

Result<void> check_numbers(const RolloutSegment& s) {
  Result<void> result;
  for_each_array(s, [&](const auto& array, const ArrayField& field) {
    using Number = typename std::decay_t<decltype(array)>::value_type;
    if constexpr (std::is_floating_point_v<Number>) {
      const void* self = &array;
      // Where nothing was grasped there is no position.
      if (!result || self == &s.episode_grasp_position_in_world_m) return;
      if (!std::all_of(array.begin(), array.end(), [](Number v) { return std::isfinite(v); }))
        result = failure("{} holds a number that is not finite", field.name);
    }
  });
  return result;
}

Result<void> check_actions(const RolloutSegment& s, const PolicyShape& shape) {
  for (std::size_t step = 0; step < s.steps; ++step) {
    for (std::size_t b = 0; b < shape.columns(); ++b) {
      const bool used = !shape.continuous && b < shape.branches.size();
      const int size = used ? shape.branches[b] : 1;
      const int action = s.actions[step * shape.columns() + b];
      if (action >= size)
        return failure("step {} branch {}: action {} of {}", step, b, action, size);
    }
  }
  return {};
}

Result<void> check_outcomes(const RolloutSegment& s) {
  for (const std::uint8_t outcome : s.episode_outcome) {
    if (outcome > static_cast<std::uint8_t>(Outcome::kError)) return failure("outcome {}", outcome);
  }
  return {};
}

Result<void> check_episodes(const RolloutSegment& s, const RolloutTask& t) {
  std::size_t end = 0;
  std::uint64_t length = t.reset ? 0 : t.episode_step;
  bool fresh = t.reset || t.episode_step == 0;
  for (std::size_t step = 0; step < s.steps; ++step) {
    const std::uint8_t flags = s.flags[step];
    if ((flags & ~kRolloutFlags) != 0) return failure("step {}: flags {:#04x}", step, flags);
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
    ++end;
    length = 0;
    fresh = true;
  }
  if (end != s.episode_end_step.size())
    return failure("{} episode ends, {} in the flags", s.episode_end_step.size(), end);
  if (s.failed != 0) return {};  // the running episode is over as well
  if (s.end_episode_step != length)
    return failure("end_episode_step {} instead of {}", s.end_episode_step, length);
  if (s.end_episode != t.episode + end)
    return failure("end_episode {} instead of {}", s.end_episode, t.episode + end);
  return {};
}

/// An evaluation is one episode that ends with its last step, whatever its flags are.
Result<void> check_evaluation(const RolloutSegment& s) {
  for (const std::uint8_t flags : s.flags) {
    if ((flags & ~(kRolloutFlags | step_flag::kScripted)) != 0)
      return failure("flags {:#04x}", flags);
  }
  const std::size_t episodes = s.failed == 0 ? 1 : 0;
  if (s.episode_end_step.size() != episodes)
    return failure("{} episodes instead of {}", s.episode_end_step.size(), episodes);
  if (episodes == 1 && s.episode_end_step[0] != s.steps - 1)
    return failure("episode ends at step {} of {}", s.episode_end_step[0], s.steps);
  return {};
}

Result<void> check_end(const RolloutSegment& s, const RolloutTask& t) {
  if (is_rollout(t) && s.failed == 0 && s.end_state.empty() && s.end_episode_step != 0)
    return failure("end_state is empty within an episode");
  if (!s.end_state.empty() && hash_state(s.end_state) != s.end_hash)
    return failure("end_hash is not the hash of end_state");
  if (segment_crc(s) != s.payload_crc32c) return failure("CRC");
  return {};
}

}  // namespace

Result<void> check_segment(const RolloutSegment& segment, const PolicyShape& shape,
                           const RolloutTask& task) {
  if (Result<void> result = check_identity(segment, task); !result) return result;
  if (Result<void> result = check_lengths(segment, shape, task); !result) return result;
  if (Result<void> result = check_numbers(segment); !result) return result;
  if (Result<void> result = check_actions(segment, shape); !result) return result;
  if (Result<void> result = check_outcomes(segment); !result) return result;
  Result<void> episodes =
      is_rollout(task) ? check_episodes(segment, task) : check_evaluation(segment);
  if (!episodes) return episodes;
  return check_end(segment, task);
}

}  // namespace omentum
