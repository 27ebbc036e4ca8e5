#pragma once

#include <cstddef>
#include <cstdint>

#include "core/types.h"

/// The one list of the fields of a segment, in wire order. The bus (core/wire.cpp), the CRC, the
/// count of bytes, the check at admission (learner/segment_check.h) and recordings loop over it.
namespace omentum {

/// Longest state of an environment that a task or a segment carries [bytes].
inline constexpr std::size_t kMaxStateBytes = std::size_t{1} << 20;

/// Longest arrays of a segment, as in idl/omentum.idl (core/wire.cpp compares).
namespace segment_limit {
inline constexpr std::size_t kSteps = 20000;
inline constexpr std::size_t kStepValues = 4 * kSteps;
inline constexpr std::size_t kObservation = 65536;
inline constexpr std::size_t kObservations = std::size_t{1} << 24;
inline constexpr std::size_t kEpisodes = 20000;
}  // namespace segment_limit

/// What an array has a row of.
enum class Rows : std::uint8_t {
  kStep,          ///< every step
  kRecordedStep,  ///< every step of a task with frame_stride > 0, else nothing
  kEpisode,       ///< every episode that ended inside the segment
  kTruncation,    ///< every truncated step of a rollout
  kEnd,           ///< the end of the segment: one row
  kFrame,         ///< the frames of a task with frame_stride > 0, as wide as the tissue has numbers
  kState          ///< bytes of the environment
};

/// Width of a row that is one observation.
inline constexpr std::size_t kObservationWidth = 0;

/// One array of a segment.
struct ArrayField {
  const char* name;
  std::size_t bound;  ///< most entries on the wire
  Rows rows;
  std::size_t width =
      1;  ///< entries per row, or kObservationWidth; no meaning for frames and state
  /// Field of StepRecord (rows per step) or EpisodeResult (per episode) of proto/recording.proto;
  /// null = not recorded.
  const char* recorded_as = nullptr;
};

/// Shows the visitor every field of two records that have the same members, such as a segment and
/// the generated type of the bus, or a segment twice. `value` is part of the result and of its CRC;
/// `delivery`, `enumerator` and `text` tell who computed it, when, and why it failed.
template <typename A, typename B, typename V>
void segment_fields(A& a, B& b, V& v) {
  namespace limit = segment_limit;
  v.value(a.slot, b.slot, "slot");
  v.value(a.segment, b.segment, "segment");
  v.delivery(a.grant, b.grant, "grant");
  v.delivery(a.worker_id, b.worker_id, "worker_id");
  v.delivery(a.learner_epoch, b.learner_epoch, "learner_epoch");
  v.value(a.task_hash, b.task_hash, "task_hash");
  v.value(a.policy_version, b.policy_version, "policy_version");
  v.delivery(a.build_id, b.build_id, "build_id");
  v.enumerator(a.source, b.source, Source::kDvrk, "source");
  v.value(a.steps, b.steps, "steps");
  v.array(a.observations, b.observations,
          {"observations", limit::kObservations, Rows::kStep, kObservationWidth, "observation"});
  v.array(a.actions, b.actions, {"actions", limit::kStepValues, Rows::kStep, 4, "action"});
  v.array(a.actions_continuous, b.actions_continuous,
          {"actions_continuous", limit::kStepValues, Rows::kStep, 4, "action_continuous"});
  v.array(a.log_probs, b.log_probs, {"log_probs", limit::kSteps, Rows::kStep, 1, "log_prob"});
  v.array(a.rewards, b.rewards, {"rewards", limit::kSteps, Rows::kStep, 1, "reward"});
  v.array(a.values, b.values, {"values", limit::kSteps, Rows::kStep, 1, "value"});
  v.array(a.flags, b.flags, {"flags", limit::kSteps, Rows::kStep, 1, "flags"});
  v.array(a.bootstrap_observation, b.bootstrap_observation,
          {"bootstrap_observation", limit::kObservation, Rows::kEnd, kObservationWidth});
  v.array(a.final_observations, b.final_observations,
          {"final_observations", limit::kObservations, Rows::kTruncation, kObservationWidth});
  v.array(a.episode_end_step, b.episode_end_step,
          {"episode_end_step", limit::kEpisodes, Rows::kEpisode});
  v.array(a.episode_return, b.episode_return,
          {"episode_return", limit::kEpisodes, Rows::kEpisode, 1, "return_sum"});
  v.array(a.episode_length, b.episode_length,
          {"episode_length", limit::kEpisodes, Rows::kEpisode, 1, "length_steps"});
  v.array(a.episode_outcome, b.episode_outcome,
          {"episode_outcome", limit::kEpisodes, Rows::kEpisode, 1, "outcome"});
  v.array(a.episode_exposure, b.episode_exposure,
          {"episode_exposure", limit::kEpisodes, Rows::kEpisode, 1, "exposure"});
  v.array(a.episode_grasped, b.episode_grasped,
          {"episode_grasped", limit::kEpisodes, Rows::kEpisode, 1, "grasped"});
  v.array(a.episode_held, b.episode_held,
          {"episode_held", limit::kEpisodes, Rows::kEpisode, 1, "held"});
  v.array(a.episode_grasp_position_in_world_m, b.episode_grasp_position_in_world_m,
          {"episode_grasp_position_in_world_m", limit::kStepValues, Rows::kEpisode, 3,
           "grasp_position_in_world_m"});
  v.array(a.episode_start_position_in_world_m, b.episode_start_position_in_world_m,
          {"episode_start_position_in_world_m", limit::kStepValues, Rows::kEpisode, 3,
           "start_position_in_world_m"});
  v.value(a.end_episode, b.end_episode, "end_episode");
  v.value(a.end_episode_step, b.end_episode_step, "end_episode_step");
  v.value(a.end_episode_limit, b.end_episode_limit, "end_episode_limit");
  v.value(a.state_format, b.state_format, "state_format");
  v.value(a.end_hash, b.end_hash, "end_hash");
  v.array(a.end_state, b.end_state, {"end_state", kMaxStateBytes, Rows::kState});
  v.value(a.failed, b.failed, "failed");
  v.text(a.failure, b.failure, "failure");
  v.value(a.physics_ticks, b.physics_ticks, "physics_ticks");
  v.array(a.state_hashes, b.state_hashes,
          {"state_hashes", limit::kSteps, Rows::kRecordedStep, 1, "state_hash"});
  v.array(a.frame_positions_in_world_m, b.frame_positions_in_world_m,
          {"frame_positions_in_world_m", limit::kObservations, Rows::kFrame});
  v.array(a.tool_positions_in_world_m, b.tool_positions_in_world_m,
          {"tool_positions_in_world_m", limit::kStepValues, Rows::kRecordedStep, 3,
           "tool_position_in_world_m"});
  v.array(a.exposures, b.exposures,
          {"exposures", limit::kSteps, Rows::kRecordedStep, 1, "exposure"});
  v.delivery(a.payload_crc32c, b.payload_crc32c, "payload_crc32c");
  v.delivery(a.compute_time_ns, b.compute_time_ns, "compute_time_ns");
  v.delivery(a.wait_time_ns, b.wait_time_ns, "wait_time_ns");
  v.delivery(a.granted_at_ns, b.granted_at_ns, "granted_at_ns");
}

/// Visitor that passes over every field; others hide what they want to see.
struct IgnoreFields {
  template <typename T>
  void value(T& /*field*/, T& /*same*/, const char* /*name*/) {}
  template <typename T>
  void delivery(T& /*field*/, T& /*same*/, const char* /*name*/) {}
  template <typename T, typename C>
  void enumerator(T& /*field*/, T& /*same*/, C /*last*/, const char* /*name*/) {}
  template <typename T>
  void text(T& /*field*/, T& /*same*/, const char* /*name*/) {}
  template <typename T>
  void array(T& /*field*/, T& /*same*/, const ArrayField& /*about*/) {}
};

template <typename See>
struct SeeArrays : IgnoreFields {
  See& see;
  template <typename T>
  void array(T& field, T& /*same*/, const ArrayField& about) {
    see(field, about);
  }
};

/// Calls see(vector, ArrayField) for every array of a segment.
template <typename Segment, typename See>
void for_each_array(Segment& segment, See&& see) {
  SeeArrays<See> visitor{{}, see};
  segment_fields(segment, segment, visitor);
}

/// CRC-32C over the result a segment carries: everything but who computed it, when, and why it
/// failed.
std::uint32_t segment_crc(const RolloutSegment& segment);

}  // namespace omentum
