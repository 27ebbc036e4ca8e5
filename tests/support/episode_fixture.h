#pragma once

#include <cmath>
#include <cstddef>
#include <string>

#include "core/episode_recording.h"

namespace omentum::test {

/// A made-up episode of `steps` decisions with `particles` particles, every field filled with
/// something that differs from step to step. Not physics: for tests of recordings.
inline EpisodeRecording make_episode(std::uint32_t steps, std::uint32_t particles,
                                     std::uint32_t stride = 5) {
  EpisodeRecording episode;
  episode.context = {
      "grid100_greedy", "preset: \"test\"\n", 0x1234567890abcdefULL, "0123456789ab", 0.02,
      particles};
  RolloutTask& task = episode.task;
  task.kind = TaskKind::kEvaluate;
  task.start_set = StartSet::kGrid;
  task.start_index = 75;
  task.greedy = true;
  task.run_seed = 7;
  task.slot = 3;
  task.episode = 11;
  task.episode_limit = steps;
  task.steps = steps + 9;
  task.policy_steps = steps - 1;
  task.hold_steps = 2;
  task.segment = 5;
  task.reset = true;
  task.frame_stride = stride;
  task.policy_version = 293;
  task.config_hash = episode.context.config_hash;
  for (std::size_t k = 0; k < task.weights_hash.size(); ++k)
    task.weights_hash[k] = static_cast<std::uint8_t>(k * 7);
  RolloutSegment& segment = episode.segment;
  segment.slot = task.slot;
  segment.policy_version = task.policy_version;
  segment.steps = steps;
  segment.build_id = 99;
  for (std::uint32_t step = 0; step < steps; ++step) {
    const float phase = 0.01F * static_cast<float>(step);
    for (int k = 0; k < 14; ++k)
      segment.observations.push_back(std::sin(phase + static_cast<float>(k)));
    for (std::uint32_t k = 0; k < 4; ++k)
      segment.actions.push_back(static_cast<std::uint8_t>((step + k) % 3));
    segment.rewards.push_back(-1 + phase);
    segment.flags.push_back(step > steps / 2 ? step_flag::kHeld : 0);
    segment.log_probs.push_back(-phase);
    segment.values.push_back(2 * phase);
    segment.state_hashes.push_back(0x9e3779b97f4a7c15ULL * (step + 1));
    segment.exposures.push_back(step > steps / 2 ? 0.5F : 0.0F);
    for (int k = 0; k < 3; ++k)
      segment.tool_positions_in_world_m.push_back(0.01F * static_cast<float>(k) + 0.0005F * phase);
  }
  for (std::uint32_t step = 0; step < steps + stride; step += stride) {
    episode.frame_steps.push_back(std::min(step, steps));
    for (std::uint32_t k = 0; k < 3 * particles; ++k) {
      segment.frame_positions_in_world_m.push_back(0.001F * static_cast<float>(k) +
                                                   1e-5F * static_cast<float>(step));
    }
  }
  segment.episode_outcome = {static_cast<std::uint8_t>(Outcome::kTargetReached)};
  segment.episode_return = {-12.5};
  segment.episode_length = {steps};
  segment.episode_exposure = {0.75F};
  segment.episode_grasped = {1};
  segment.episode_held = {1};
  segment.episode_grasp_position_in_world_m = {0.01F, 0.02F, 0.03F};
  segment.episode_start_position_in_world_m = {0.0F, 0.05F, 0.1F};
  segment.end_hash = 0xfeedULL;
  segment.physics_ticks = std::uint64_t{10} * steps;
  return episode;
}

}  // namespace omentum::test
