#include "learner/demonstrations.h"

#include <algorithm>
#include <cmath>
#include <string_view>

#include "core/check.h"
#include "core/config.h"
#include "core/episode_recording.h"
#include "core/policy.h"
#include "learner/checkpoint.h"

namespace omentum {
namespace {

constexpr const char* kOption = "--initialise-from-recordings";
constexpr std::uint8_t kEnd = step_flag::kTerminated | step_flag::kTruncated;

/// The parts of a configuration that decide what is observed, done and rewarded.
std::string what_is_acted_in(const pb::Config& config) {
  pb::Config parts;
  *parts.mutable_scene() = config.scene();
  parts.mutable_scene()->clear_name();
  parts.mutable_scene()->clear_source();
  *parts.mutable_task() = config.task();
  *parts.mutable_grasp() = config.grasp();
  *parts.mutable_defects() = config.defects();
  return print_config(parts);
}

bool all_finite(std::span<const float> values) {
  return std::all_of(values.begin(), values.end(), [](float v) { return std::isfinite(v); });
}

/// Steps up to the end of the episode that the recording begins with.
std::size_t steps_of_episode(const RolloutSegment& segment) {
  const auto end = std::find_if(segment.flags.begin(), segment.flags.end(),
                                [](std::uint8_t flags) { return (flags & kEnd) != 0; });
  return end == segment.flags.end() ? segment.flags.size()
                                    : static_cast<std::size_t>(end - segment.flags.begin()) + 1;
}

[[noreturn]] void refuse(const std::string& path, std::string_view why) {
  throw_error("{} {}: {}", kOption, path, why);
}

/// The file is whole and its episode one of the simulation that went well.
void check_whole(const std::string& path, const EpisodeRecording& recording) {
  const RolloutSegment& segment = recording.segment;
  if (!recording.problems.empty()) refuse(path, "damaged: " + recording.problems.front());
  if (!recording.complete) refuse(path, "cut off");
  if (segment.source != Source::kSimulation) refuse(path, "recorded on a robot");
  if (!segment.failure.empty()) refuse(path, "the episode failed: " + segment.failure);
  if (segment.steps == 0) refuse(path, "no steps");
}

/// Recordings of one configuration, read into one batch.
class Reader {
 public:
  explicit Reader(const pb::Config& config)
      : wanted_(what_is_acted_in(config)), shape_(policy_shape(config)) {
    result_.batch.slots = 1;
    result_.batch.observation_size = shape_.observations;
  }

  void take(const std::string& path);
  Demonstrations result() && { return std::move(result_); }

 private:
  void check_config(const std::string& path, const RecordingContext& context);
  void check_numbers(const std::string& path, const RolloutSegment& segment) const;
  void append(const RolloutSegment& segment);

  std::string wanted_;
  PolicyShape shape_;
  std::string checked_text_;  ///< of the last configuration that was found to be the same
  Demonstrations result_;
};

void Reader::check_config(const std::string& path, const RecordingContext& context) {
  if (!checked_text_.empty() && context.config_text == checked_text_) return;
  pb::Config recorded;
  try {
    recorded = parse_config("its configuration", context.config_text);
  } catch (const Error& error) {
    refuse(path, error.what());
  }
  const std::string difference = config_difference(what_is_acted_in(recorded), wanted_);
  if (!difference.empty()) {
    refuse(path, fmt::format("recorded with another scene, task or grasp, {} (recorded -> here)",
                             difference.substr(0, difference.find('\n'))));
  }
  checked_text_ = context.config_text;
}

void Reader::check_numbers(const std::string& path, const RolloutSegment& segment) const {
  const auto width = static_cast<std::size_t>(shape_.observations);
  if (segment.observations.size() != width * segment.steps) {
    refuse(path, fmt::format("{} observed values per step, here {}",
                             segment.observations.size() / segment.steps, width));
  }
  if (!all_finite(segment.observations)) refuse(path, "an observation is not finite");
  if (!all_finite(segment.rewards)) refuse(path, "a reward is not finite");
  if (shape_.continuous) {
    if (segment.actions_continuous.size() != std::size_t{4} * segment.steps)
      refuse(path, "no continuous actions");
    if (!all_finite(segment.actions_continuous)) refuse(path, "an action is not finite");
    return;
  }
  if (segment.actions.size() != shape_.columns() * segment.steps) {
    refuse(path, fmt::format("{} entries per action, here {}",
                             segment.actions.size() / segment.steps, shape_.columns()));
  }
  for (std::size_t i = 0; i < segment.actions.size(); ++i) {
    const std::size_t branch = i % shape_.columns();
    if (branch < shape_.branches.size() && segment.actions[i] >= shape_.branches[branch]) {
      refuse(path, fmt::format("action {} of branch {}, allowed below {}", segment.actions[i],
                               branch, shape_.branches[branch]));
    }
  }
}

void Reader::append(const RolloutSegment& segment) {
  const std::size_t steps = steps_of_episode(segment);
  const auto add = [](auto& to, const auto& from, std::size_t count) {
    to.insert(to.end(), from.begin(), from.begin() + static_cast<std::ptrdiff_t>(count));
  };
  Batch& batch = result_.batch;
  add(batch.observations, segment.observations,
      steps * static_cast<std::size_t>(shape_.observations));
  add(batch.branches, segment.actions, shape_.columns() * steps);
  if (shape_.continuous) add(batch.continuous, segment.actions_continuous, 4 * steps);
  add(batch.rewards, segment.rewards, steps);
  add(batch.flags, segment.flags, steps);
  // A recorded episode that nothing ended was left by who recorded it.
  if ((batch.flags.back() & kEnd) == 0) batch.flags.back() |= step_flag::kTruncated;
  batch.steps += static_cast<int>(steps);
  ++result_.episodes;
}

void Reader::take(const std::string& path) {
  const Result<EpisodeRecording> recording = load_episode(path);
  if (!recording) throw_error("{} {}", kOption, recording.error());
  check_whole(path, recording.value());
  check_config(path, recording.value().context);
  check_numbers(path, recording.value().segment);
  const std::vector<std::uint8_t>& outcome = recording.value().segment.episode_outcome;
  if (outcome.empty() || outcome.front() != static_cast<std::uint8_t>(Outcome::kTargetReached)) {
    result_.left_out.push_back(path);
    return;
  }
  append(recording.value().segment);
}

}  // namespace

Demonstrations read_demonstrations(const std::string& folder, const pb::Config& config) {
  Reader reader(config);
  std::vector<std::string> files;
  try {
    files = recordings_of(folder);
  } catch (const Error& error) {
    throw_error("{} {}", kOption, error.what());
  }
  for (const std::string& file : files) reader.take(file);
  Demonstrations result = std::move(reader).result();
  if (result.episodes == 0)
    throw_error("{} {}: none of its {} episodes reached p_T", kOption, folder, files.size());
  return result;
}

}  // namespace omentum
