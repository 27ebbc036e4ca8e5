#pragma once

#include <cstddef>
#include <cstdint>
#include <tuple>

#include "core/types.h"

/// The one list of the fields of a segment: the bus (core/wire.cpp), the CRC, the count of bytes,
/// the check at admission (learner/segment_check.h) and recordings loop over it. The CRC depends on
/// its order: do not change.
namespace omentum {

/// Longest state of an environment that a task or a segment carries [bytes].
inline constexpr std::size_t kMaxStateBytes = std::size_t{1} << 20;

/// Longest arrays of a segment, as in idl/omentum.idl (core/wire.cpp compares).
namespace segment_limit {
inline constexpr std::size_t kSteps = 20000;
inline constexpr std::size_t kStepValues = kActionBranches * kSteps;
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
/// Width of a row that is one action: action_columns() of the task.
inline constexpr std::size_t kActionWidth = ~std::size_t{0};

/// One array of a record.
struct ArrayField {
  const char* name;
  std::size_t bound;       ///< most entries on the wire
  Rows rows = Rows::kEnd;  ///< of a segment, as are the rest
  std::size_t width = 1;   ///< entries per row, or one of the above; unused for frames and state
  /// Field of StepRecord (rows per step) or EpisodeResult (per episode) of proto/recording.proto;
  /// null = not recorded.
  const char* recorded_as = nullptr;
};

/// Shows the visitor every field of two records with the same members, such as a segment and the
/// generated type of the bus, or a segment twice. `values` are part of the result and its CRC;
/// `delivery`, `enumerator` and `text` tell who computed it, when, and why it failed.
template <typename A, typename B, typename V>
void segment_fields(A& a, B& b, V& v) {
  using enum Rows;
  namespace limit = segment_limit;
  v.values(a, b, [](auto& r) {
    return std::tie(r.slot, r.segment, r.task_hash, r.policy_version, r.steps, r.end_episode,
                    r.end_episode_step, r.end_episode_limit, r.state_format, r.end_hash, r.failed,
                    r.physics_ticks);
  });
  v.delivery(a, b, [](auto& r) {
    return std::tie(r.grant, r.worker_id, r.learner_epoch, r.build_id, r.payload_crc32c,
                    r.compute_time_ns, r.wait_time_ns, r.granted_at_ns);
  });
  v.enumerator(a.source, b.source, Source::kDvrk, "source");
  v.text(a.failure, b.failure, "failure");
  v.array(a.observations, b.observations,
          {"observations", limit::kObservations, kStep, kObservationWidth, "observation"});
  v.array(a.actions, b.actions, {"actions", limit::kStepValues, kStep, kActionWidth, "action"});
  v.array(a.actions_continuous, b.actions_continuous,
          {"actions_continuous", limit::kStepValues, kStep, 4, "action_continuous"});
  v.array(a.log_probs, b.log_probs, {"log_probs", limit::kSteps, kStep, 1, "log_prob"});
  v.array(a.rewards, b.rewards, {"rewards", limit::kSteps, kStep, 1, "reward"});
  v.array(a.values, b.values, {"values", limit::kSteps, kStep, 1, "value"});
  v.array(a.flags, b.flags, {"flags", limit::kSteps, kStep, 1, "flags"});
  v.array(a.bootstrap_observation, b.bootstrap_observation,
          {"bootstrap_observation", limit::kObservation, kEnd, kObservationWidth});
  v.array(a.final_observations, b.final_observations,
          {"final_observations", limit::kObservations, kTruncation, kObservationWidth});
  v.array(a.episode_end_step, b.episode_end_step, {"episode_end_step", limit::kEpisodes, kEpisode});
  v.array(a.episode_return, b.episode_return,
          {"episode_return", limit::kEpisodes, kEpisode, 1, "return_sum"});
  v.array(a.episode_length, b.episode_length,
          {"episode_length", limit::kEpisodes, kEpisode, 1, "length_steps"});
  v.array(a.episode_outcome, b.episode_outcome,
          {"episode_outcome", limit::kEpisodes, kEpisode, 1, "outcome"});
  v.array(a.episode_exposure, b.episode_exposure,
          {"episode_exposure", limit::kEpisodes, kEpisode, 1, "exposure"});
  v.array(a.episode_grasped, b.episode_grasped,
          {"episode_grasped", limit::kEpisodes, kEpisode, 1, "grasped"});
  v.array(a.episode_held, b.episode_held, {"episode_held", limit::kEpisodes, kEpisode, 1, "held"});
  v.array(a.episode_grasp_position_in_world_m, b.episode_grasp_position_in_world_m,
          {"episode_grasp_position_in_world_m", limit::kStepValues, kEpisode, 3,
           "grasp_position_in_world_m"});
  v.array(a.episode_start_position_in_world_m, b.episode_start_position_in_world_m,
          {"episode_start_position_in_world_m", limit::kStepValues, kEpisode, 3,
           "start_position_in_world_m"});
  v.array(a.end_state, b.end_state, {"end_state", kMaxStateBytes, kState});
  v.array(a.state_hashes, b.state_hashes,
          {"state_hashes", limit::kSteps, kRecordedStep, 1, "state_hash"});
  v.array(a.frame_positions_in_world_m, b.frame_positions_in_world_m,
          {"frame_positions_in_world_m", limit::kObservations, kFrame});
  v.array(a.tool_positions_in_world_m, b.tool_positions_in_world_m,
          {"tool_positions_in_world_m", limit::kStepValues, kRecordedStep, 3,
           "tool_position_in_world_m"});
  v.array(a.exposures, b.exposures, {"exposures", limit::kSteps, kRecordedStep, 1, "exposure"});
}

/// Visitor that passes over every field; others hide what they want to see.
struct IgnoreFields {
  void values(const auto& /*a*/, const auto& /*b*/, auto /*members*/) {}
  void delivery(const auto& /*a*/, const auto& /*b*/, auto /*members*/) {}
  void enumerator(const auto& /*a*/, const auto& /*b*/, auto /*last*/, const char* /*name*/) {}
  void text(const auto& /*a*/, const auto& /*b*/, const char* /*name*/) {}
  void array(const auto& /*a*/, const auto& /*b*/, const ArrayField& /*about*/) {}
};

template <typename See>
struct SeeArrays : IgnoreFields {
  See& see;
  void array(auto& field, auto& /*same*/, const ArrayField& about) { see(field, about); }
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
