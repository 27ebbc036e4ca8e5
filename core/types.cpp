#include "core/types.h"

#include <cstring>

namespace omentum {

std::uint64_t hash_task(const RolloutTask& task) {
  std::uint64_t hash = kFnvOffset;
  const auto add = [&hash](const auto& value) {
    hash = fnv1a64(std::as_bytes(std::span(&value, 1)), hash);
  };
  add(task.config_hash);
  hash = fnv1a64(std::as_bytes(std::span(task.weights_hash)), hash);
  add(task.slot);
  add(task.segment);
  add(task.steps);
  add(static_cast<std::uint32_t>(task.kind));
  add(static_cast<std::uint32_t>(task.greedy));
  add(static_cast<std::uint32_t>(task.start_set));
  add(task.start_index);
  add(task.run_seed);
  add(task.episode);
  add(task.episode_step);
  add(task.episode_limit);
  add(task.policy_steps);
  add(task.hold_steps);
  add(static_cast<std::uint32_t>(task.reset));
  add(task.start_hash);
  add(task.frame_stride);
  return hash;
}

}  // namespace omentum
