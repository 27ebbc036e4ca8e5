#pragma once

#include <cstring>

#include "core/hash.h"
#include "core/policy.h"
#include "core/segment_fields.h"
#include "core/types.h"

namespace omentum::test {

inline constexpr std::uint32_t kFakeObservation = 3;

inline PolicyShape fake_shape() {
  PolicyShape shape;
  shape.observations = kFakeObservation;
  shape.branches = {3, 3, 3, 2};
  shape.hidden = 8;
  return shape;
}

/// A pure function of the task and nothing else: a counter environment whose episodes last
/// `episode` steps and whose state is 16 bytes plus padding up to `state_bytes`. An evaluation is
/// one episode of all its steps, with frames of two particles where the task asks for them.
inline RolloutSegment fake_rollout(const RolloutTask& task, std::uint32_t episode = 50,
                                   std::size_t state_bytes = 16) {
  RolloutSegment s;
  s.slot = task.slot;
  s.segment = task.segment;
  s.grant = task.grant;
  s.worker_id = task.worker_id;
  s.learner_epoch = task.learner_epoch;
  s.task_hash = task.task_hash;
  s.policy_version = task.policy_version;
  s.granted_at_ns = task.granted_at_ns;
  s.state_format = task.state_format;
  s.steps = task.steps;
  std::uint64_t state = 0;
  if (task.reset) {
    state = fnv1a64(std::as_bytes(std::span(&task.run_seed, 1))) + task.slot * 1000 + task.episode;
  } else {
    std::memcpy(&state, task.start_state.data(), sizeof state);
  }
  const bool evaluation = task.kind == TaskKind::kEvaluate;
  std::uint64_t number = task.episode;
  std::uint32_t step = task.episode_step;
  std::uint32_t limit = task.episode_limit == 0 ? episode : task.episode_limit;
  for (std::uint32_t i = 0; i < task.steps; ++i) {
    std::uint8_t flags = step == 0 ? step_flag::kFirst : std::uint8_t{0};
    state = state * 6364136223846793005ULL + task.weights_hash[0] + 1;
    for (std::uint32_t o = 0; o < kFakeObservation; ++o) {
      s.observations.push_back(static_cast<float>((state >> (8 * o)) & 0xff));
    }
    for (int b = 0; b < 4; ++b) s.actions.push_back(static_cast<std::uint8_t>((state >> b) & 1));
    s.log_probs.push_back(-1.0f);
    s.values.push_back(0.5f);
    s.rewards.push_back(static_cast<float>(state >> 56));
    if (task.frame_stride > 0) {
      s.state_hashes.push_back(state);
      s.exposures.push_back(0.5F);
      s.tool_positions_in_world_m.insert(s.tool_positions_in_world_m.end(), 3, 0.01F);
    }
    ++step;
    const bool last = evaluation && i + 1 == task.steps;
    if (evaluation ? last : step == limit) {
      flags |= step_flag::kTruncated;
      if (!evaluation) s.final_observations.insert(s.final_observations.end(), kFakeObservation, 1);
      s.episode_end_step.push_back(i);
      s.episode_return.push_back(1);
      s.episode_length.push_back(step);
      s.episode_outcome.push_back(static_cast<std::uint8_t>(Outcome::kTruncated));
      s.episode_exposure.push_back(0);
      s.episode_grasped.push_back(0);
      s.episode_held.push_back(0);
      s.episode_grasp_position_in_world_m.insert(s.episode_grasp_position_in_world_m.end(), 3,
                                                 0.0f);
      s.episode_start_position_in_world_m.insert(s.episode_start_position_in_world_m.end(), 3,
                                                 0.0f);
      step = 0;
      limit = episode;
      ++number;
      state += number;
    }
    s.flags.push_back(flags);
  }
  if (task.frame_stride > 0)
    s.frame_positions_in_world_m.assign(std::size_t{6} * (task.steps / task.frame_stride + 1),
                                        0.1F);
  s.bootstrap_observation.assign(kFakeObservation, 2.0f);
  s.end_episode = number;
  s.end_episode_step = step;
  s.end_episode_limit = limit;
  s.end_state.assign(std::max(state_bytes, sizeof state), std::byte{7});
  std::memcpy(s.end_state.data(), &state, sizeof state);
  s.end_hash = hash_state(s.end_state);
  s.payload_crc32c = segment_crc(s);
  return s;
}

}  // namespace omentum::test
