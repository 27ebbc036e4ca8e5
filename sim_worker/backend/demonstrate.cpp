#include "sim_worker/backend/demonstrate.h"

#include <fmt/format.h>

#include <algorithm>
#include <vector>

#include "core/check.h"
#include "core/config.h"
#include "core/episode_recording.h"
#include "core/output_folder.h"
#include "core/rng.h"
#include "core/rollout.h"
#include "sim_worker/backend/image_source.h"
#include "sim_worker/backend/scripted_expert.h"
#include "sim_worker/models.h"

namespace omentum {
namespace {

/// Slots of the starts: training has at most rollout.slots of 4,096, so it never draws the same.
constexpr std::uint32_t kFirstSlot = 4096;

RolloutTask task_of_episode(const pb::Config& config, std::uint32_t episode) {
  RolloutTask task;
  task.kind = TaskKind::kEvaluate;
  task.config_hash = config_hash(config);
  task.run_seed = config.rollout().run_seed();
  task.slot = kFirstSlot + episode;
  task.reset = true;
  task.frame_stride = config.evaluation().frame_stride();
  task.steps = std::max(1U, config.task().episode_steps() / config.task().action_repeat());
  return task;
}

/// Moves each axis at random in a share of the decisions.
void shake(const RolloutTask& task, std::uint32_t step, double share, Action& action) {
  const PhiloxWords whether =
      random_words(task.run_seed, task.slot, Purpose::kAction, 0, task.episode, step);
  const PhiloxWords where =
      random_words(task.run_seed, task.slot, Purpose::kAction, 1, task.episode, step);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    if (!(static_cast<double>(uniform_24(whether[axis])) < share)) continue;
    action.branch[axis] = static_cast<std::uint8_t>(bounded(where[axis], 3));
    action.continuous[axis] = static_cast<float>(uniform_between(where[axis], -1, 1));
  }
}

}  // namespace

DemonstrationCount demonstrate(const pb::Config& config, const DemonstrationOptions& options,
                               const std::function<bool()>& stop) {
  OutputFolder output(options.folder);
  const auto setup = make_sim_setup(config);
  const LaneKernel<float>& kernel = choose_kernel(0);
  SimBackend backend(setup, kernel.lanes, 0, make_image_source(*setup));
  std::vector<float> frame;
  backend.positions(0, frame);
  RecordingContext context = recording_context(config, "demonstration", options.git_revision);
  context.particles = static_cast<std::uint32_t>(frame.size() / 3);

  output.begin();
  const auto lanes = static_cast<std::uint32_t>(kernel.lanes);
  DemonstrationCount count;
  for (std::uint32_t first = 0; first < options.episodes; first += lanes) {
    std::vector<RolloutTask> tasks;
    for (std::uint32_t i = first; i < std::min(options.episodes, first + lanes); ++i)
      tasks.push_back(task_of_episode(config, i));
    ScriptedExpert expert(backend);
    const Script script = [&](std::uint32_t step, std::span<Action> actions) {
      expert.act(actions);
      for (std::size_t k = 0; k < actions.size(); ++k)
        shake(tasks[k], step, options.tremor, actions[k]);
    };
    const Actor actor(script, config.task().action() == pb::ACTION_CONTINUOUS);
    const std::vector<RolloutSegment> segments = run_rollout(backend, actor, tasks, stop);
    if (segments.empty()) return {.stopped = true};
    for (std::size_t k = 0; k < segments.size(); ++k) {
      const std::string path =
          fmt::format("{}/demonstration_{:03}.mcap", output.path().string(), first + k);
      const Result<void> saved = save_episode(path, tasks[k], segments[k], context);
      if (!saved) throw_error("{}", saved.error());
      ++count.episodes;
      count.steps += segments[k].steps;
      const auto& outcome = segments[k].episode_outcome;
      if (!outcome.empty() && outcome.front() == static_cast<std::uint8_t>(Outcome::kTargetReached))
        ++count.reached;
    }
  }
  output.finish();
  return count;
}

}  // namespace omentum
