#pragma once

#include <concepts>
#include <tuple>
#include <type_traits>

#include "core/segment_fields.h"
#include "core/simulation_records.h"
#include "core/topics.h"
#include "core/types.h"
#include "omentum.h"

/// The records field by field, for core/wire.cpp alone. Members have the same names in the
/// generated type and in the core type, so fields(generated, core, visitor) serves both directions:
/// out, the visitor fills the generated struct from the core one; in, the reverse. A field that is
/// missing in a list fails the round-trip test.
namespace omentum {

inline constexpr std::size_t kMaxWarnings = 8;  // bounds idlc has no name for
inline constexpr std::size_t kMaxNames = 64;

template <typename C, typename Record>
concept Is = std::same_as<std::remove_const_t<C>, Record>;

template <typename G, Is<PolicyWeights> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.policy_id, r.learner_epoch, r.policy_version, r.layout_hash, r.config_hash,
                    r.published_at_ns);
  });
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
  v.array(g.parameters, c.parameters, {"parameters", omentum_v1_MAX_PARAMETERS});
  v.array(g.obs_mean, c.obs_mean, {"obs_mean", omentum_v1_MAX_OBSERVATION});
  v.array(g.obs_inv_std, c.obs_inv_std, {"obs_inv_std", omentum_v1_MAX_OBSERVATION});
}

template <typename G, Is<RolloutTask> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.slot, r.segment, r.grant, r.worker_id, r.learner_epoch, r.task_hash,
                    r.policy_version, r.config_hash, r.greedy, r.start_index, r.steps, r.run_seed,
                    r.episode, r.episode_step, r.episode_limit, r.reset, r.state_format,
                    r.start_hash, r.frame_stride, r.policy_steps, r.hold_steps, r.granted_at_ns,
                    r.live_frames_hz);
  });
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
  v.enumerator(g.kind, c.kind, TaskKind::kEvaluate, "kind");
  v.enumerator(g.start_set, c.start_set, StartSet::kGridDrawn, "start_set");
  v.array(g.start_state, c.start_state, {"start_state", omentum_v1_MAX_STATE_BYTES});
}

template <typename G, Is<RolloutSegment> C, typename V>
void fields(G& g, C& c, V& v) {
  segment_fields(g, c, v);
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
}

template <typename G, Is<WorkerStatus> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.worker_id, r.pid, r.build_id, r.lanes, r.learner_epoch, r.policy_version,
                    r.tasks_received, r.tasks_declined_no_weights, r.tasks_declined_config,
                    r.tasks_declined_state, r.tasks_declined_epoch, r.tasks_abandoned,
                    r.tasks_in_progress, r.segments_published, r.write_timeouts, r.steps,
                    r.steps_per_s, r.sim_time_fraction, r.socket_receive_buffer_bytes,
                    r.rexmit_bytes, r.throttle_count, r.time_throttle_ns, r.alarms_raised,
                    r.frames_published);
  });
  v.text(g.host, c.host, "host");
  v.text(g.program_version, c.program_version, "program_version");
  v.enumerator(g.phase, c.phase, WorkerPhase::kDraining, "phase");
  v.texts(g.warnings, c.warnings, kMaxWarnings, "warnings");
  v.texts(g.alarms, c.alarms, omentum_v1_MAX_ALARMS, "alarms");
}

template <typename G, Is<LearnerStatus> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.learner_epoch, r.policy_version, r.batch, r.granted, r.regranted, r.received,
                    r.admitted, r.duplicate, r.stale, r.invalid, r.cancelled, r.foreign, r.overflow,
                    r.outstanding, r.audit_mismatch, r.workers_alive, r.oldest_task_age_s,
                    r.steps_total, r.steps_per_s, r.bytes_up_per_s, r.bytes_down_per_s,
                    r.mean_return, r.mean_length, r.approx_kl, r.entropy, r.explained_variance,
                    r.alarms_raised, r.steps_wanted);
  });
  v.text(g.run_id, c.run_id, "run_id");
  v.enumerator(g.phase, c.phase, LearnerPhase::kDone, "phase");
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
  v.array(g.worker_ids, c.worker_ids, {"worker_ids", omentum_v1_MAX_WORKERS});
  v.array(g.worker_phases, c.worker_phases, {"worker_phases", omentum_v1_MAX_WORKERS});
  v.array(g.worker_steps_per_s, c.worker_steps_per_s,
          {"worker_steps_per_s", omentum_v1_MAX_WORKERS});
  v.array(g.barred_worker_ids, c.barred_worker_ids, {"barred_worker_ids", omentum_v1_MAX_BARRED});
  v.texts(g.barred_reasons, c.barred_reasons, omentum_v1_MAX_BARRED, "barred_reasons");
  v.array(g.unheard_worker_ids, c.unheard_worker_ids,
          {"unheard_worker_ids", omentum_v1_MAX_BARRED});
  v.texts(g.alarms, c.alarms, omentum_v1_MAX_ALARMS, "alarms");
}

template <typename G, Is<EpisodeSummary> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.slot, r.episode, r.first_version, r.last_version, r.length_steps,
                    r.return_sum, r.return_discounted, r.exposure_fraction);
  });
  v.enumerator(g.source, c.source, Source::kDvrk, "source");
  v.enumerator(g.outcome, c.outcome, Outcome::kError, "outcome");
  v.fixed(g.start_position_in_world_m, c.start_position_in_world_m, "start_position_in_world_m");
  v.fixed(g.grasp_position_in_world_m, c.grasp_position_in_world_m, "grasp_position_in_world_m");
}

template <typename G, Is<RunManifest> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.learner_epoch, r.config_hash, r.layout_hash, r.build_id, r.run_seed, r.slots,
                    r.steps_per_segment, r.lead, r.state_format);
  });
  v.text(g.run_id, c.run_id, "run_id");
  v.text(g.config_text, c.config_text, "config_text");
  v.text(g.git_revision, c.git_revision, "git_revision");
  v.texts(g.observation_names, c.observation_names, kMaxNames, "observation_names");
  v.texts(g.action_names, c.action_names, kMaxNames, "action_names");
}

template <typename G, Is<ControlCommand> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.request, r.worker_id, r.slot, r.frames_hz, r.sent_at_ns);
  });
  v.text(g.run_id, c.run_id, "run_id");
  v.text(g.issuer, c.issuer, "issuer");
  v.enumerator(g.action, c.action, ControlAction::kFramesOff, "action");
}

template <typename G, Is<ControlReply> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) { return std::tie(r.request, r.worker_id, r.done); });
  v.text(g.run_id, c.run_id, "run_id");
  v.text(g.program, c.program, "program");
  v.text(g.text, c.text, "text");
}

template <typename G, Is<SimFrame> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.slot, r.worker_id, r.policy_version, r.episode, r.episode_step, r.sim_time_s,
                    r.grasped);
  });
  v.text(g.run_id, c.run_id, "run_id");
  v.array(g.particle_positions_in_world_m, c.particle_positions_in_world_m,
          {"particle_positions_in_world_m", omentum_v1_MAX_FRAME_VALUES});
  v.fixed(g.tool_position_in_world_m, c.tool_position_in_world_m, "tool_position_in_world_m");
}

template <typename G, Is<RobotStatus> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.gateway_id, r.pid, r.armed, r.dry_run, r.reason, r.is_homed, r.is_busy,
                    r.registered, r.measured_jaw_rad, r.setpoint_jaw_rad, r.goal_jaw_rad,
                    r.datagrams, r.malformed, r.foreign, r.unknown_keys, r.not_finite, r.reordered,
                    r.restarts, r.cut, r.unsent, r.sent, r.stops, r.latency_p50_ms,
                    r.latency_max_ms, r.jitter_p50_ms, r.jitter_max_ms, r.state_age_p50_ms,
                    r.state_age_max_ms, r.periods, r.late, r.missed, r.unwatched, r.episodes,
                    r.segments_published, r.write_failures, r.policy_version, r.sent_at_ns);
  });
  v.text(g.run_id, c.run_id, "run_id");
  v.text(g.robot, c.robot, "robot");
  v.text(g.host, c.host, "host");
  v.text(g.program_version, c.program_version, "program_version");
  v.enumerator(g.phase, c.phase, RobotPhase::kStopped, "phase");
  v.text(g.reason_name, c.reason_name, "reason_name");
  v.text(g.reason_text, c.reason_text, "reason_text");
  v.text(g.operating_state, c.operating_state, "operating_state");
  v.fixed(g.measured_cp_in_world_m, c.measured_cp_in_world_m, "measured_cp_in_world_m");
  v.fixed(g.setpoint_cp_in_world_m, c.setpoint_cp_in_world_m, "setpoint_cp_in_world_m");
  v.fixed(g.goal_cp_in_world_m, c.goal_cp_in_world_m, "goal_cp_in_world_m");
  v.fixed(g.measured_tip_in_world_m, c.measured_tip_in_world_m, "measured_tip_in_world_m");
  v.array(g.measured_jp, c.measured_jp, {"measured_jp", omentum_v1_MAX_ROBOT_JOINTS});
  v.array(g.setpoint_jp, c.setpoint_jp, {"setpoint_jp", omentum_v1_MAX_ROBOT_JOINTS});
  v.array(g.goal_jp, c.goal_jp, {"goal_jp", omentum_v1_MAX_ROBOT_JOINTS});
  v.array(g.refusals, c.refusals, {"refusals", omentum_v1_MAX_STOP_REASONS});
  v.texts(g.refusal_names, c.refusal_names, omentum_v1_MAX_STOP_REASONS, "refusal_names");
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
}

template <typename G, Is<SimulationGrant> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.asker_id, r.task, r.grant, r.worker_id, r.format, r.build_id, r.task_hash,
                    r.steps, r.granted_at_ns);
  });
  v.text(g.asker, c.asker, "asker");
  v.array(g.payload, c.payload, {"payload", omentum_v1_MAX_TASK_BYTES});
}

template <typename G, Is<SimulationPart> C, typename V>
void fields(G& g, C& c, V& v) {
  v.values(g, c, [](auto& r) {
    return std::tie(r.asker_id, r.task, r.grant, r.worker_id, r.task_hash, r.part, r.parts,
                    r.result_bytes, r.result_crc32c, r.compute_time_ns);
  });
  v.array(g.payload, c.payload, {"payload", omentum_v1_MAX_PART_BYTES});
  v.text(g.declined, c.declined, "declined");
}

/// What carries a record: its topic, generated type, and key(), the members that a sample without
/// data has as well.
template <TopicId kId, typename G, const dds_topic_descriptor_t& kDescription>
struct Carrier {
  using Generated = G;
  static constexpr TopicId kTopic = kId;
  static constexpr const dds_topic_descriptor_t& kDescriptor = kDescription;
  static auto key(auto& /*record*/) { return std::tie(); }
};

template <typename Record>
struct Wire;
template <>
struct Wire<PolicyWeights>
    : Carrier<TopicId::kPolicyWeights, omentum_v1_PolicyWeights, omentum_v1_PolicyWeights_desc> {
  static auto key(auto& r) { return std::tie(r.policy_id, r.learner_epoch); }
};
template <>
struct Wire<RolloutTask>
    : Carrier<TopicId::kRolloutTask, omentum_v1_RolloutTask, omentum_v1_RolloutTask_desc> {
  static auto key(auto& r) { return std::tie(r.slot); }
};
template <>
struct Wire<RolloutSegment>
    : Carrier<TopicId::kRolloutSegment, omentum_v1_RolloutSegment, omentum_v1_RolloutSegment_desc> {
};
template <>
struct Wire<WorkerStatus>
    : Carrier<TopicId::kWorkerStatus, omentum_v1_WorkerStatus, omentum_v1_WorkerStatus_desc> {
  static auto key(auto& r) { return std::tie(r.worker_id); }
};
template <>
struct Wire<LearnerStatus>
    : Carrier<TopicId::kLearnerStatus, omentum_v1_LearnerStatus, omentum_v1_LearnerStatus_desc> {
  static auto key(auto& r) { return std::tie(r.run_id, r.learner_epoch); }
};
template <>
struct Wire<EpisodeSummary>
    : Carrier<TopicId::kEpisodeSummary, omentum_v1_EpisodeSummary, omentum_v1_EpisodeSummary_desc> {
};
template <>
struct Wire<RunManifest>
    : Carrier<TopicId::kRunManifest, omentum_v1_RunManifest, omentum_v1_RunManifest_desc> {
  static auto key(auto& r) { return std::tie(r.run_id, r.learner_epoch); }
};
template <>
struct Wire<ControlCommand>
    : Carrier<TopicId::kControlCommand, omentum_v1_ControlCommand, omentum_v1_ControlCommand_desc> {
};
template <>
struct Wire<ControlReply>
    : Carrier<TopicId::kControlReply, omentum_v1_ControlReply, omentum_v1_ControlReply_desc> {};
template <>
struct Wire<SimFrame> : Carrier<TopicId::kSimFrame, omentum_v1_SimFrame, omentum_v1_SimFrame_desc> {
  static auto key(auto& r) { return std::tie(r.slot); }
};

template <>
struct Wire<RobotStatus>
    : Carrier<TopicId::kRobotState, omentum_v1_RobotStatus, omentum_v1_RobotStatus_desc> {
  static auto key(auto& r) { return std::tie(r.gateway_id); }
};

template <>
struct Wire<SimulationGrant> : Carrier<TopicId::kSimulationTask, omentum_v1_SimulationGrant,
                                       omentum_v1_SimulationGrant_desc> {
  static auto key(auto& r) { return std::tie(r.asker_id, r.task); }
};
template <>
struct Wire<SimulationPart> : Carrier<TopicId::kSimulationResult, omentum_v1_SimulationPart,
                                      omentum_v1_SimulationPart_desc> {};

}  // namespace omentum
