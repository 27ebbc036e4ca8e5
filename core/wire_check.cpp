// What a record must satisfy whatever carried it.
#include <algorithm>
#include <string>
#include <string_view>

#include "core/wire.h"
#include "omentum.h"

namespace omentum {
namespace {

// Lengths that belong together. Everything not named here is free.
class Lengths {
 public:
  Lengths& equal(std::size_t length, std::size_t wanted, std::string_view name) {
    if (length != wanted && failure_.empty()) {
      failure_ = fmt::format("{}: length {} is not {}", name, length, wanted);
    }
    return *this;
  }
  Lengths& none_or(std::size_t length, std::size_t wanted, std::string_view name) {
    return length == 0 ? *this : equal(length, wanted, name);
  }
  Lengths& require(bool ok, std::string_view reason) {
    if (!ok && failure_.empty()) failure_ = reason;
    return *this;
  }
  Result<void> result() const {
    return failure_.empty() ? Result<void>() : Result<void>(Failure{failure_});
  }

 private:
  std::string failure_;
};

}  // namespace

template <typename Record>
Result<void> check_record(const Record& /*record*/) {
  return {};
}

template <>
Result<void> check_record(const PolicyWeights& weights) {
  return Lengths()
      .equal(weights.obs_inv_std.size(), weights.obs_mean.size(), "obs_inv_std")
      .result();
}

template <>
Result<void> check_record(const RolloutTask& task) {
  return Lengths()
      .require(task.steps <= omentum_v1_MAX_STEPS, "steps: out of range")
      .none_or(task.commands.size(), std::size_t{4} * task.steps, "commands")
      .require(task.reset || !task.start_state.empty(), "start_state: empty without reset")
      .result();
}

template <>
Result<void> check_record(const RolloutSegment& s) {
  const std::size_t n = s.steps;
  const std::size_t observation = s.bootstrap_observation.size();
  const std::size_t episodes = s.episode_end_step.size();
  Lengths lengths;
  lengths.require(n <= omentum_v1_MAX_STEPS, "steps: out of range")
      .require(s.failed != 0 ? n == 0 || s.observations.size() % n == 0
                             : s.observations.size() == n * observation,
               "observations: length")
      .none_or(s.actions.size(), 4 * n, "actions")
      .none_or(s.actions_continuous.size(), 4 * n, "actions_continuous")
      .require(!s.actions.empty() || !s.actions_continuous.empty() || n == 0, "actions: none")
      .none_or(s.masks.size(), n, "masks")
      .equal(s.log_probs.size(), n, "log_probs")
      .equal(s.rewards.size(), n, "rewards")
      .equal(s.values.size(), n, "values")
      .equal(s.flags.size(), n, "flags")
      .equal(s.episode_return.size(), episodes, "episode_return")
      .equal(s.episode_length.size(), episodes, "episode_length")
      .equal(s.episode_outcome.size(), episodes, "episode_outcome")
      .equal(s.episode_exposure.size(), episodes, "episode_exposure")
      .equal(s.episode_grasped.size(), episodes, "episode_grasped")
      .equal(s.episode_held.size(), episodes, "episode_held")
      .equal(s.episode_grasp_position.size(), 3 * episodes, "episode_grasp_position")
      .equal(s.episode_start_position.size(), 3 * episodes, "episode_start_position")
      .none_or(s.state_hashes.size(), n, "state_hashes")
      .none_or(s.tool_positions_in_world_m.size(), 3 * n, "tool_positions_in_world_m")
      .none_or(s.exposures.size(), n, "exposures")
      .require(s.failed <= 1, "failed: out of range");
  // A failed segment ends without an observation.
  lengths.require(s.final_observations.empty() || s.failed != 0 ||
                      (observation > 0 && s.final_observations.size() % observation == 0),
                  "final_observations: not a multiple of the observation");
  for (std::size_t i = 0; i < std::min(episodes, s.episode_outcome.size()); ++i) {
    lengths.require(s.episode_outcome[i] <= static_cast<std::uint8_t>(Outcome::kError),
                    "episode_outcome: out of range");
    lengths.require(s.episode_end_step[i] < n, "episode_end_step: out of range");
  }
  return lengths.result();
}

template <>
Result<void> check_record(const LearnerStatus& status) {
  return Lengths()
      .equal(status.worker_phases.size(), status.worker_ids.size(), "worker_phases")
      .equal(status.worker_steps_per_s.size(), status.worker_ids.size(), "worker_steps_per_s")
      .result();
}

template Result<void> check_record(const WorkerStatus&);
template Result<void> check_record(const EpisodeSummary&);
template Result<void> check_record(const RunManifest&);

}  // namespace omentum
