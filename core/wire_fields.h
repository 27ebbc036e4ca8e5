#pragma once

#include <cstddef>
#include <type_traits>

#include "core/segment_fields.h"
#include "core/topics.h"
#include "core/types.h"
#include "omentum.h"

/// The records field by field, for core/wire.cpp alone. Every record has one list of its fields,
/// fields(generated, core, visitor), used in both directions: out, the visitor fills the generated
/// struct from the core one; in, the reverse. A field that is missing in the list fails the
/// round-trip test.
namespace omentum {

inline constexpr std::size_t kMaxWarnings = 8;  // bounds idlc has no name for
inline constexpr std::size_t kMaxNames = 64;

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, PolicyWeights>
void fields(G& g, C& c, V& v) {
  v.value(g.policy_id, c.policy_id, "policy_id");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.value(g.policy_version, c.policy_version, "policy_version");
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
  v.value(g.layout_hash, c.layout_hash, "layout_hash");
  v.value(g.config_hash, c.config_hash, "config_hash");
  v.sequence(g.parameters, c.parameters, omentum_v1_MAX_PARAMETERS, "parameters");
  v.sequence(g.obs_mean, c.obs_mean, omentum_v1_MAX_OBSERVATION, "obs_mean");
  v.sequence(g.obs_inv_std, c.obs_inv_std, omentum_v1_MAX_OBSERVATION, "obs_inv_std");
  v.value(g.published_at_ns, c.published_at_ns, "published_at_ns");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, RolloutTask>
void fields(G& g, C& c, V& v) {
  v.value(g.slot, c.slot, "slot");
  v.value(g.segment, c.segment, "segment");
  v.value(g.grant, c.grant, "grant");
  v.value(g.worker_id, c.worker_id, "worker_id");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.value(g.task_hash, c.task_hash, "task_hash");
  v.value(g.policy_version, c.policy_version, "policy_version");
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
  v.value(g.config_hash, c.config_hash, "config_hash");
  v.enumerator(g.kind, c.kind, TaskKind::kEvaluate, "kind");
  v.value(g.greedy, c.greedy, "greedy");
  v.enumerator(g.start_set, c.start_set, StartSet::kGraspLattice, "start_set");
  v.value(g.start_index, c.start_index, "start_index");
  v.value(g.steps, c.steps, "steps");
  v.value(g.run_seed, c.run_seed, "run_seed");
  v.value(g.episode, c.episode, "episode");
  v.value(g.episode_step, c.episode_step, "episode_step");
  v.value(g.episode_limit, c.episode_limit, "episode_limit");
  v.value(g.reset, c.reset, "reset");
  v.value(g.state_format, c.state_format, "state_format");
  v.value(g.start_hash, c.start_hash, "start_hash");
  v.sequence(g.start_state, c.start_state, omentum_v1_MAX_STATE_BYTES, "start_state");
  v.value(g.frame_stride, c.frame_stride, "frame_stride");
  v.value(g.policy_steps, c.policy_steps, "policy_steps");
  v.value(g.hold_steps, c.hold_steps, "hold_steps");
  v.value(g.granted_at_ns, c.granted_at_ns, "granted_at_ns");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, RolloutSegment>
void fields(G& g, C& c, V& v) { segment_fields(g, c, v); }

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, WorkerStatus>
void fields(G& g, C& c, V& v) {
  v.value(g.worker_id, c.worker_id, "worker_id");
  v.text(g.host, c.host, "host");
  v.text(g.program_version, c.program_version, "program_version");
  v.value(g.pid, c.pid, "pid");
  v.value(g.build_id, c.build_id, "build_id");
  v.value(g.lanes, c.lanes, "lanes");
  v.enumerator(g.phase, c.phase, WorkerPhase::kDraining, "phase");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.value(g.policy_version, c.policy_version, "policy_version");
  v.value(g.tasks_received, c.tasks_received, "tasks_received");
  v.value(g.tasks_declined_no_weights, c.tasks_declined_no_weights, "tasks_declined_no_weights");
  v.value(g.tasks_declined_config, c.tasks_declined_config, "tasks_declined_config");
  v.value(g.tasks_declined_state, c.tasks_declined_state, "tasks_declined_state");
  v.value(g.tasks_declined_epoch, c.tasks_declined_epoch, "tasks_declined_epoch");
  v.value(g.tasks_abandoned, c.tasks_abandoned, "tasks_abandoned");
  v.value(g.tasks_in_progress, c.tasks_in_progress, "tasks_in_progress");
  v.value(g.segments_published, c.segments_published, "segments_published");
  v.value(g.write_timeouts, c.write_timeouts, "write_timeouts");
  v.value(g.steps, c.steps, "steps");
  v.value(g.steps_per_s, c.steps_per_s, "steps_per_s");
  v.value(g.sim_time_fraction, c.sim_time_fraction, "sim_time_fraction");
  v.value(g.socket_receive_buffer_bytes, c.socket_receive_buffer_bytes,
          "socket_receive_buffer_bytes");
  v.value(g.rexmit_bytes, c.rexmit_bytes, "rexmit_bytes");
  v.value(g.throttle_count, c.throttle_count, "throttle_count");
  v.value(g.time_throttle_ns, c.time_throttle_ns, "time_throttle_ns");
  v.texts(g.warnings, c.warnings, kMaxWarnings, "warnings");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, LearnerStatus>
void fields(G& g, C& c, V& v) {
  v.text(g.run_id, c.run_id, "run_id");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.value(g.policy_version, c.policy_version, "policy_version");
  v.value(g.batch, c.batch, "batch");
  v.enumerator(g.phase, c.phase, LearnerPhase::kDone, "phase");
  v.value(g.granted, c.granted, "granted");
  v.value(g.regranted, c.regranted, "regranted");
  v.value(g.received, c.received, "received");
  v.value(g.admitted, c.admitted, "admitted");
  v.value(g.duplicate, c.duplicate, "duplicate");
  v.value(g.stale, c.stale, "stale");
  v.value(g.invalid, c.invalid, "invalid");
  v.value(g.cancelled, c.cancelled, "cancelled");
  v.value(g.foreign, c.foreign, "foreign");
  v.value(g.overflow, c.overflow, "overflow");
  v.value(g.outstanding, c.outstanding, "outstanding");
  v.value(g.audit_mismatch, c.audit_mismatch, "audit_mismatch");
  v.value(g.workers_alive, c.workers_alive, "workers_alive");
  v.value(g.oldest_task_age_s, c.oldest_task_age_s, "oldest_task_age_s");
  v.value(g.steps_total, c.steps_total, "steps_total");
  v.value(g.steps_per_s, c.steps_per_s, "steps_per_s");
  v.value(g.bytes_up_per_s, c.bytes_up_per_s, "bytes_up_per_s");
  v.value(g.bytes_down_per_s, c.bytes_down_per_s, "bytes_down_per_s");
  v.value(g.mean_return, c.mean_return, "mean_return");
  v.value(g.mean_length, c.mean_length, "mean_length");
  v.value(g.approx_kl, c.approx_kl, "approx_kl");
  v.value(g.entropy, c.entropy, "entropy");
  v.value(g.explained_variance, c.explained_variance, "explained_variance");
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
  v.sequence(g.worker_ids, c.worker_ids, omentum_v1_MAX_WORKERS, "worker_ids");
  v.sequence(g.worker_phases, c.worker_phases, omentum_v1_MAX_WORKERS, "worker_phases");
  v.sequence(g.worker_steps_per_s, c.worker_steps_per_s, omentum_v1_MAX_WORKERS,
             "worker_steps_per_s");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, EpisodeSummary>
void fields(G& g, C& c, V& v) {
  v.enumerator(g.source, c.source, Source::kDvrk, "source");
  v.value(g.slot, c.slot, "slot");
  v.value(g.episode, c.episode, "episode");
  v.value(g.first_version, c.first_version, "first_version");
  v.value(g.last_version, c.last_version, "last_version");
  v.value(g.length_steps, c.length_steps, "length_steps");
  v.value(g.return_sum, c.return_sum, "return_sum");
  v.value(g.return_discounted, c.return_discounted, "return_discounted");
  v.enumerator(g.outcome, c.outcome, Outcome::kError, "outcome");
  v.value(g.exposure_fraction, c.exposure_fraction, "exposure_fraction");
  v.fixed(g.start_position_in_world_m, c.start_position_in_world_m, "start_position_in_world_m");
  v.fixed(g.grasp_position_in_world_m, c.grasp_position_in_world_m, "grasp_position_in_world_m");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, RunManifest>
void fields(G& g, C& c, V& v) {
  v.text(g.run_id, c.run_id, "run_id");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.text(g.config_text, c.config_text, "config_text");
  v.value(g.config_hash, c.config_hash, "config_hash");
  v.value(g.layout_hash, c.layout_hash, "layout_hash");
  v.value(g.build_id, c.build_id, "build_id");
  v.text(g.git_revision, c.git_revision, "git_revision");
  v.value(g.run_seed, c.run_seed, "run_seed");
  v.value(g.slots, c.slots, "slots");
  v.value(g.steps_per_segment, c.steps_per_segment, "steps_per_segment");
  v.value(g.lead, c.lead, "lead");
  v.value(g.state_format, c.state_format, "state_format");
  v.texts(g.observation_names, c.observation_names, kMaxNames, "observation_names");
  v.texts(g.action_names, c.action_names, kMaxNames, "action_names");
}

// ------------------------------------------------------------------------------------------ keys

// Of a sample without data only these are set.

inline void read_key(const omentum_v1_PolicyWeights& g, PolicyWeights& c) {
  c.policy_id = g.policy_id;
  c.learner_epoch = g.learner_epoch;
}
inline void read_key(const omentum_v1_RolloutTask& g, RolloutTask& c) { c.slot = g.slot; }
inline void read_key(const omentum_v1_RolloutSegment& /*g*/, RolloutSegment& /*c*/) {}
inline void read_key(const omentum_v1_WorkerStatus& g, WorkerStatus& c) {
  c.worker_id = g.worker_id;
}
inline void read_key(const omentum_v1_LearnerStatus& g, LearnerStatus& c) {
  c.run_id = g.run_id == nullptr ? "" : g.run_id;
  c.learner_epoch = g.learner_epoch;
}
inline void read_key(const omentum_v1_EpisodeSummary& /*g*/, EpisodeSummary& /*c*/) {}
inline void read_key(const omentum_v1_RunManifest& g, RunManifest& c) {
  c.run_id = g.run_id == nullptr ? "" : g.run_id;
  c.learner_epoch = g.learner_epoch;
}

// ---------------------------------------------------------------------------------------- records

template <typename Record>
struct Wire;

template <>
struct Wire<PolicyWeights> {
  using Generated = omentum_v1_PolicyWeights;
  static constexpr TopicId kTopic = TopicId::kPolicyWeights;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_PolicyWeights_desc; }
};
template <>
struct Wire<RolloutTask> {
  using Generated = omentum_v1_RolloutTask;
  static constexpr TopicId kTopic = TopicId::kRolloutTask;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_RolloutTask_desc; }
};
template <>
struct Wire<RolloutSegment> {
  using Generated = omentum_v1_RolloutSegment;
  static constexpr TopicId kTopic = TopicId::kRolloutSegment;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_RolloutSegment_desc; }
};
template <>
struct Wire<WorkerStatus> {
  using Generated = omentum_v1_WorkerStatus;
  static constexpr TopicId kTopic = TopicId::kWorkerStatus;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_WorkerStatus_desc; }
};
template <>
struct Wire<LearnerStatus> {
  using Generated = omentum_v1_LearnerStatus;
  static constexpr TopicId kTopic = TopicId::kLearnerStatus;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_LearnerStatus_desc; }
};
template <>
struct Wire<EpisodeSummary> {
  using Generated = omentum_v1_EpisodeSummary;
  static constexpr TopicId kTopic = TopicId::kEpisodeSummary;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_EpisodeSummary_desc; }
};
template <>
struct Wire<RunManifest> {
  using Generated = omentum_v1_RunManifest;
  static constexpr TopicId kTopic = TopicId::kRunManifest;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_RunManifest_desc; }
};

}  // namespace omentum
