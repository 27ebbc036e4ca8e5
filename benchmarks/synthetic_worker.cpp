#include "benchmarks/synthetic_worker.h"

#include <chrono>
#include <thread>

#include "benchmarks/lanes_only.h"
#include "core/build_id.h"
#include "core/config.h"
#include "core/hash.h"
#include "core/limits.h"
#include "core/segment_fields.h"

namespace omentum {
namespace {

/// One episode that does not end.
RolloutSegment segment_of(const RolloutTask& task, int observations, std::size_t state_bytes) {
  const auto width = static_cast<std::size_t>(observations);
  RolloutSegment s;
  s.slot = task.slot;
  s.segment = task.segment;
  s.task_hash = task.task_hash;
  s.policy_version = task.policy_version;
  s.state_format = task.state_format;
  s.steps = task.steps;
  s.observations.assign(task.steps * width, 0.5F);
  s.actions.assign(std::size_t{4} * task.steps, 1);
  s.log_probs.assign(task.steps, -1);
  s.rewards.assign(task.steps, 0.1F);
  s.values.assign(task.steps, 0);
  s.flags.assign(task.steps, 0);
  if (task.reset || task.episode_step == 0) s.flags[0] = step_flag::kFirst;
  s.bootstrap_observation.assign(width, 0.5F);
  s.end_episode = task.episode;
  s.end_episode_step = (task.reset ? 0 : task.episode_step) + task.steps;
  s.end_episode_limit = task.episode_limit;
  s.end_state.assign(state_bytes, std::byte{7});
  s.end_hash = hash_state(s.end_state);
  s.payload_crc32c = segment_crc(s);
  return s;
}

}  // namespace

PolicyShape synthetic_shape() {
  PolicyShape shape;
  shape.observations = 11;
  shape.branches = {3, 3, 3, 2};
  shape.hidden = 8;  // the bus is measured with small weights; those of a preset apart
  return shape;
}

BusWorkerOptions synthetic_worker(const SyntheticWorker& worker) {
  BusWorkerOptions options;
  options.run = worker.run;
  options.domain = worker.domain;
  options.profile = find_dds_profile({}, DdsRole::kOther, worker.domain, 0).value();
  options.build_id = build_id();
  options.make_setup = [lanes = worker.lanes](const RunManifest& manifest) {
    WorkerSetup setup;
    setup.shape = synthetic_shape();
    setup.config_hash = kSyntheticConfigHash;
    if (!manifest.config_text.empty()) {
      const pb::Config config = parse_config("manifest", manifest.config_text);
      setup.shape = policy_shape(config);
      setup.config_hash = config_hash(config);
    }
    setup.backend = std::make_unique<LanesOnly>(lanes, setup.shape.observations, kSimStateFormat);
    return setup;
  };
  options.rollout = [worker](Backend& backend, Policy&, std::span<const RolloutTask> tasks,
                             const std::function<bool()>& stop) {
    std::vector<RolloutSegment> segments;
    double steps = 0;
    for (const RolloutTask& task : tasks) {
      segments.push_back(segment_of(task, backend.observation_size(), worker.state_bytes));
      steps += task.steps;
    }
    if (worker.steps_per_s > 0) {
      // All lanes take the time of a full group, as real ones do.
      const double full = steps / static_cast<double>(tasks.size()) * worker.lanes;
      const auto end = std::chrono::steady_clock::now() +
                       std::chrono::duration<double>(full / worker.steps_per_s);
      while (std::chrono::steady_clock::now() < end) {
        if (stop()) return std::vector<RolloutSegment>{};
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
    }
    return segments;
  };
  return options;
}

}  // namespace omentum
