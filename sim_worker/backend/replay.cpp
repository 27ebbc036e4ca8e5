#include "sim_worker/backend/replay.h"

#include <bit>
#include <cmath>
#include <vector>

#include "core/check.h"
#include "core/config.h"
#include "core/hash.h"
#include "core/policy.h"
#include "core/task.h"
#include "sim_worker/backend/image_source.h"

namespace omentum {
namespace {

bool same(float a, float b) {
  return std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b);
}

/// Refuses what the back end must not be asked for.
void check_task(const std::string& name, const EpisodeRecording& recording, const SimSetup& setup) {
  const RolloutTask& task = recording.task;
  const RolloutSegment& segment = recording.segment;
  if (segment.source == Source::kDvrk) {
    throw_error("{}: recorded on the robot, there is no simulation to run again", name);
  }
  if (segment.steps == 0) throw_error("{}: no steps", name);
  std::size_t starts = 0;
  switch (task.start_set) {
    case StartSet::kTraining:
      starts = std::size_t{task.start_index} + 1;  // the index means nothing
      break;
    case StartSet::kGrid:
      starts = setup.scene.grid_starts.size();
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
  for (std::size_t i = 0; i < segment.actions.size(); ++i) {
    const std::size_t branch = i % 4;
    if (branch >= shape.branches.size() || segment.actions[i] < shape.branches[branch]) continue;
    throw_error("{}: action {} of step {}, allowed below {}", name, segment.actions[i], i / 4,
                shape.branches[branch]);
  }
}

}  // namespace

void Replayer::prepare(const std::string& name, const EpisodeRecording& recording) {
  const std::string& override = recording.task.scene_override;
  const std::string wanted = recording.context.config_text + "\n# override " + override;
  if (backend_ && prepared_for_ == wanted) return;
  backend_.reset();
  pb::Config config = parse_config(name, recording.context.config_text);
  if (!override.empty()) apply_override(config, "scene={" + override + "}");
  const auto setup = make_sim_setup(config, deploy_dir() + "/scenes");
  backend_ = std::make_unique<SimBackend>(setup, 1, lane_width_, make_image_source(*setup));
  prepared_for_ = wanted;
}

ReplayReport Replayer::replay(const std::string& path) {
  const Result<EpisodeRecording> recording = load_episode(path);
  if (!recording) throw_error("{}", recording.error());
  return replay(path, recording.value());
}

ReplayReport Replayer::replay(const std::string& name, const EpisodeRecording& recording) {
  prepare(name, recording);
  SimBackend& backend = *backend_;
  check_task(name, recording, backend.setup());
  const RolloutTask& task = recording.task;
  const RolloutSegment& segment = recording.segment;
  const auto width = static_cast<std::size_t>(backend.observation_size());

  ReplayReport report;
  report.complete = recording.complete;
  const auto differ = [&report](const std::string& what, const auto& recorded, const auto& now) {
    report.text = fmt::format("differs at step {}: {} recorded {}, now {}", report.steps, what,
                              recorded, now);
    return report;
  };
  if (segment.observations.size() != width * segment.steps) {
    return differ("observation size", segment.observations.size() / segment.steps, width);
  }
  if (task.reset) {
    backend.reset(0, start_of(task));
  } else if (const Result<void> loaded = backend.load(0, task.start_state); !loaded) {
    throw_error("{}: {}", name, loaded.error());
  }

  const std::vector<std::string> names = observation_names(backend.setup().config.task());
  std::vector<float> observation(width);
  std::vector<Action> actions(1);
  std::vector<StepOutcome> outcomes(1);
  for (std::uint32_t step = 0; step < segment.steps; ++step, ++report.steps) {
    backend.observe(0, observation);
    for (std::size_t k = 0; k < width; ++k) {
      const float recorded = segment.observations[step * width + k];
      if (same(recorded, observation[k])) continue;
      return differ("observation " + (k < names.size() ? names[k] : fmt::format("{}", k)), recorded,
                    observation[k]);
    }
    for (std::size_t k = 0; k < 4; ++k) {
      actions[0].branch[k] = segment.actions[std::size_t{4} * step + k];
      if (!segment.actions_continuous.empty()) {
        actions[0].continuous[k] = segment.actions_continuous[std::size_t{4} * step + k];
      }
    }
    backend.step(actions, outcomes);
    if (!same(segment.rewards[step], outcomes[0].reward)) {
      return differ("reward", segment.rewards[step], outcomes[0].reward);
    }
    // The script bit says who chose the action, the first-step bit where the episode began.
    constexpr std::uint8_t kPhysical =
        step_flag::kTerminated | step_flag::kTruncated | step_flag::kHeld | step_flag::kGraspLost;
    const int flags = (outcomes[0].terminated ? step_flag::kTerminated : 0) |
                      (outcomes[0].truncated ? step_flag::kTruncated : 0) |
                      (outcomes[0].held_before ? step_flag::kHeld : 0) |
                      (outcomes[0].grasp_lost ? step_flag::kGraspLost : 0);
    if ((segment.flags[step] & kPhysical) != flags) {
      return differ("flags", segment.flags[step] & kPhysical, flags);
    }
    if (step < segment.state_hashes.size()) {
      const std::uint64_t hash = hash_state(backend.save(0));
      if (segment.state_hashes[step] != hash) {
        return differ("state hash", fmt::format("{:016x}", segment.state_hashes[step]),
                      fmt::format("{:016x}", hash));
      }
    }
    if (step < segment.exposures.size()) {
      const float exposure = backend.facts(0).exposure;
      if (!same(segment.exposures[step], exposure)) {
        return differ("exposure", segment.exposures[step], exposure);
      }
    }
  }
  report.identical = true;
  report.text = fmt::format("identical steps={}", report.steps);
  if (!report.complete) {
    report.text += fmt::format(", the file ends early: {}",
                               recording.problems.empty() ? "no end" : recording.problems.front());
  }
  return report;
}

}  // namespace omentum
