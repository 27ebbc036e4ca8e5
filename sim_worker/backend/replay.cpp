#include "sim_worker/backend/replay.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <vector>

#include "core/check.h"
#include "core/config.h"
#include "core/hash.h"
#include "core/policy.h"
#include "core/rollout.h"
#include "core/task.h"
#include "sim_worker/backend/image_source.h"

namespace omentum {
namespace {

bool same(float a, float b) {
  return std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b);
}

/// ", the file ..." and the first thing wrong with it; empty for a whole one.
std::string damage_of(const EpisodeRecording& recording) {
  if (recording.complete && recording.problems.empty()) return {};
  return fmt::format(", the file {}: {}", recording.complete ? "is corrupt" : "ends early",
                     recording.problems.empty() ? "no end" : recording.problems.front());
}

/// Refuses what the back end must not be asked for.
void check_task(const std::string& name, const EpisodeRecording& recording, const SimSetup& setup) {
  const RolloutTask& task = recording.task;
  const RolloutSegment& segment = recording.segment;
  if (segment.source == Source::kDvrk) {
    throw_error("{}: recorded on the robot, there is no simulation to run again", name);
  }
  if (segment.steps == 0) throw_error("{}: no steps{}", name, damage_of(recording));
  std::size_t starts = 0;
  switch (task.start_set) {
    case StartSet::kTraining:
      starts = std::size_t{task.start_index} + 1;  // the index means nothing
      break;
    case StartSet::kGrid:
      starts = setup.scene.grid_starts.size();
      break;
    case StartSet::kGridDrawn:
      starts = setup.scene.grid_starts.size() *
               (1 + static_cast<std::size_t>(setup.config.randomise_size()));
      break;
    case StartSet::kRobotGrid:
      starts = setup.scene.robot_starts.size();
      break;
    case StartSet::kGraspLattice:
      starts = setup.scene.tissue.particles.size();
      break;
  }
  if (task.start_index >= starts) {
    throw_error("{}: start {} of set {}, allowed below {}", name, task.start_index,
                static_cast<std::uint32_t>(task.start_set), starts);
  }
  const PolicyShape shape = policy_shape(setup.config);
  if (shape.continuous) {
    if (segment.actions_continuous.size() != std::size_t{4} * segment.steps) {
      throw_error("{}: {} continuous actions for {} steps", name,
                  segment.actions_continuous.size() / 4, segment.steps);
    }
    for (const float value : segment.actions_continuous) {
      if (!std::isfinite(value)) throw_error("{}: an action is not a number", name);
    }
    return;
  }
  const std::size_t columns = shape.columns();
  if (segment.actions.size() != columns * segment.steps) {
    throw_error("{}: {} entries per action, needed {}", name,
                segment.actions.size() / segment.steps, columns);
  }
  for (std::size_t i = 0; i < segment.actions.size(); ++i) {
    const std::size_t branch = i % columns;
    if (branch >= shape.branches.size() || segment.actions[i] < shape.branches[branch]) continue;
    throw_error("{}: action {} of step {}, allowed below {}", name, segment.actions[i], i / columns,
                shape.branches[branch]);
  }
}

}  // namespace

void Replayer::prepare(const std::string& name, const EpisodeRecording& recording) {
  const std::string& wanted = recording.context.config_text;
  if (backend_ && prepared_for_ == wanted) return;
  backend_.reset();
  const auto setup = make_sim_setup(parse_config(name, wanted));
  backend_ = std::make_unique<SimBackend>(setup, 1, lane_width_, make_image_source(*setup));
  prepared_for_ = wanted;
}

ReplayReport Replayer::replay(const std::string& path) {
  const Result<EpisodeRecording> recording = load_episode(path);
  if (!recording) throw_error("{}", recording.error());
  return replay(path, recording.value());
}

RolloutSegment Replayer::run_again(const RolloutTask& task, const RolloutSegment& recorded) {
  const Script script = [&recorded](std::uint32_t step, std::span<Action> actions) {
    const std::size_t columns = recorded.actions.size() / recorded.steps;
    std::copy_n(recorded.actions.begin() + static_cast<std::ptrdiff_t>(columns * step), columns,
                actions[0].branch.begin());
    for (std::size_t k = 0; k < 4 && !recorded.actions_continuous.empty(); ++k)
      actions[0].continuous[k] = recorded.actions_continuous[std::size_t{4} * step + k];
  };
  RolloutTask again = task;
  again.steps = recorded.steps;
  const Actor actor(script, !recorded.actions_continuous.empty());
  return run_rollout(*backend_, actor, std::span(&again, 1), {}).front();
}

ReplayReport Replayer::replay(const std::string& name, const EpisodeRecording& recording) {
  prepare(name, recording);
  check_task(name, recording, backend_->setup());
  const RolloutSegment& segment = recording.segment;
  const auto width = static_cast<std::size_t>(backend_->observation_size());

  ReplayReport report;
  report.complete = damage_of(recording).empty();
  const auto differ = [&report](const std::string& what, const auto& recorded, const auto& now) {
    report.text = fmt::format("differs at step {}: {} recorded {}, now {}", report.steps, what,
                              recorded, now);
    return report;
  };
  if (segment.observations.size() != width * segment.steps) {
    return differ("observation size", segment.observations.size() / segment.steps, width);
  }
  const RolloutSegment now = run_again(recording.task, segment);
  if (now.failed != 0 && now.steps == 0) throw_error("{}: {}", name, now.failure);

  for (std::uint32_t step = 0; step < now.steps; ++step, ++report.steps) {
    for (std::size_t k = step * width; k < (step + 1) * width; ++k) {
      if (!same(segment.observations[k], now.observations[k]))
        return differ("observation " + observation_name(backend_->setup().config.task(),
                                                        static_cast<int>(k % width)),
                      segment.observations[k], now.observations[k]);
    }
    if (!same(segment.rewards[step], now.rewards[step]))
      return differ("reward", segment.rewards[step], now.rewards[step]);
    // The script bit says who chose the action, the first-step bit where the episode began.
    constexpr std::uint8_t kPhysical =
        step_flag::kTerminated | step_flag::kTruncated | step_flag::kHeld | step_flag::kGraspLost;
    const int flags = segment.flags[step] & kPhysical;
    const int flags_now = now.flags[step] & kPhysical;
    if (flags != flags_now) return differ("flags", flags, flags_now);
    if (step < segment.state_hashes.size() && segment.state_hashes[step] != now.state_hashes[step])
      return differ("state hash", fmt::format("{:016x}", segment.state_hashes[step]),
                    fmt::format("{:016x}", now.state_hashes[step]));
    if (step < segment.exposures.size() && !same(segment.exposures[step], now.exposures[step]))
      return differ("exposure", segment.exposures[step], now.exposures[step]);
  }
  if (now.failed != 0) return differ("state", "finite", now.failure);
  report.identical = true;
  report.text = fmt::format("identical steps={}{}", report.steps, damage_of(recording));
  return report;
}

}  // namespace omentum
