#include "core/types.h"

#include <span>

#include "core/segment_fields.h"

namespace omentum {
namespace {

/// Feeds the fields that count, each number as eight bytes.
struct Crc : IgnoreFields {
  std::uint32_t crc = 0;
  void values(const auto& segment, const auto& /*same*/, auto members) {
    const auto numbers = std::apply(
        [](const auto&... field) { return std::array{static_cast<std::uint64_t>(field)...}; },
        members(segment));
    crc = crc32c(std::as_bytes(std::span(numbers)), crc);
  }
  void array(const auto& field, const auto& /*same*/, const ArrayField& /*about*/) {
    crc = crc32c(std::as_bytes(std::span(field)), crc);
  }
};

}  // namespace

std::uint32_t segment_crc(const RolloutSegment& segment) {
  Crc visitor;
  segment_fields(segment, segment, visitor);
  return visitor.crc;
}

std::uint64_t hash_task(const RolloutTask& task) {
  std::uint64_t hash = kFnvOffset;
  const auto add = [&hash](const auto&... values) {
    ((hash = fnv1a64(std::as_bytes(std::span(&values, 1)), hash)), ...);
  };
  const auto number = [](auto value) { return static_cast<std::uint32_t>(value); };
  add(task.config_hash, task.weights_hash, task.slot, task.segment, task.steps, number(task.kind),
      number(task.greedy), number(task.start_set), task.start_index, task.run_seed, task.episode,
      task.episode_step, task.episode_limit, task.policy_steps, task.hold_steps, number(task.reset),
      task.start_hash, task.frame_stride);
  return hash;
}

EpisodeSummary summary_of(const RolloutSegment& segment, std::size_t i) {
  EpisodeSummary summary;
  summary.source = segment.source;
  summary.slot = segment.slot;
  summary.first_version = summary.last_version = segment.policy_version;
  summary.length_steps = segment.episode_length[i];
  summary.return_sum = segment.episode_return[i];
  summary.outcome = static_cast<Outcome>(segment.episode_outcome[i]);
  summary.exposure_fraction = segment.episode_exposure[i];
  for (std::size_t k = 0; k < 3; ++k) {
    summary.start_position_in_world_m[k] =
        static_cast<double>(segment.episode_start_position_in_world_m[3 * i + k]);
    summary.grasp_position_in_world_m[k] =
        static_cast<double>(segment.episode_grasp_position_in_world_m[3 * i + k]);
  }
  return summary;
}

}  // namespace omentum
