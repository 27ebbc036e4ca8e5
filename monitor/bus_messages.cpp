#include "monitor/bus_messages.h"

#include <string>

namespace omentum {
namespace {

/// Octets as they are.
std::string bytes_of(const auto& octets) {
  return {reinterpret_cast<const char*>(octets.data()), octets.size()};
}

}  // namespace

pb::bus::PolicyWeights to_message(const PolicyWeights& from) {
  pb::bus::PolicyWeights to;
  to.set_policy_id(from.policy_id);
  to.set_learner_epoch(from.learner_epoch);
  to.set_policy_version(from.policy_version);
  to.set_weights_hash(bytes_of(from.weights_hash));
  to.set_layout_hash(from.layout_hash);
  to.set_config_hash(from.config_hash);
  to.mutable_parameters()->Assign(from.parameters.begin(), from.parameters.end());
  to.mutable_obs_mean()->Assign(from.obs_mean.begin(), from.obs_mean.end());
  to.mutable_obs_inv_std()->Assign(from.obs_inv_std.begin(), from.obs_inv_std.end());
  to.set_published_at_ns(from.published_at_ns);
  return to;
}

pb::bus::RolloutSegment to_message(const RolloutSegment& from) {
  pb::bus::RolloutSegment to;
  to.set_slot(from.slot);
  to.set_segment(from.segment);
  to.set_grant(from.grant);
  to.set_worker_id(from.worker_id);
  to.set_learner_epoch(from.learner_epoch);
  to.set_task_hash(from.task_hash);
  to.set_policy_version(from.policy_version);
  to.set_build_id(from.build_id);
  to.set_source(static_cast<pb::bus::Source>(from.source));
  to.set_steps(from.steps);
  to.mutable_observations()->Assign(from.observations.begin(), from.observations.end());
  to.set_actions(bytes_of(from.actions));
  to.mutable_actions_continuous()->Assign(from.actions_continuous.begin(),
                                          from.actions_continuous.end());
  to.mutable_log_probs()->Assign(from.log_probs.begin(), from.log_probs.end());
  to.mutable_rewards()->Assign(from.rewards.begin(), from.rewards.end());
  to.mutable_values()->Assign(from.values.begin(), from.values.end());
  to.set_flags(bytes_of(from.flags));
  to.mutable_bootstrap_observation()->Assign(from.bootstrap_observation.begin(),
                                             from.bootstrap_observation.end());
  to.mutable_final_observations()->Assign(from.final_observations.begin(),
                                          from.final_observations.end());
  to.mutable_episode_end_step()->Assign(from.episode_end_step.begin(), from.episode_end_step.end());
  to.mutable_episode_return()->Assign(from.episode_return.begin(), from.episode_return.end());
  to.mutable_episode_length()->Assign(from.episode_length.begin(), from.episode_length.end());
  to.set_episode_outcome(bytes_of(from.episode_outcome));
  to.mutable_episode_exposure()->Assign(from.episode_exposure.begin(), from.episode_exposure.end());
  to.set_episode_grasped(bytes_of(from.episode_grasped));
  to.set_episode_held(bytes_of(from.episode_held));
  to.mutable_episode_grasp_position_in_world_m()->Assign(
      from.episode_grasp_position_in_world_m.begin(), from.episode_grasp_position_in_world_m.end());
  to.mutable_episode_start_position_in_world_m()->Assign(
      from.episode_start_position_in_world_m.begin(), from.episode_start_position_in_world_m.end());
  to.set_end_episode(from.end_episode);
  to.set_end_episode_step(from.end_episode_step);
  to.set_end_episode_limit(from.end_episode_limit);
  to.set_state_format(from.state_format);
  to.set_end_hash(from.end_hash);
  to.set_end_state(bytes_of(from.end_state));
  to.set_failed(from.failed);
  to.set_failure(from.failure);
  to.set_physics_ticks(from.physics_ticks);
  to.mutable_state_hashes()->Assign(from.state_hashes.begin(), from.state_hashes.end());
  to.mutable_frame_positions_in_world_m()->Assign(from.frame_positions_in_world_m.begin(),
                                                  from.frame_positions_in_world_m.end());
  to.mutable_tool_positions_in_world_m()->Assign(from.tool_positions_in_world_m.begin(),
                                                 from.tool_positions_in_world_m.end());
  to.mutable_exposures()->Assign(from.exposures.begin(), from.exposures.end());
  to.set_payload_crc32c(from.payload_crc32c);
  to.set_compute_time_ns(from.compute_time_ns);
  to.set_wait_time_ns(from.wait_time_ns);
  to.set_granted_at_ns(from.granted_at_ns);
  to.set_weights_hash(bytes_of(from.weights_hash));
  return to;
}

pb::bus::WorkerStatus to_message(const WorkerStatus& from) {
  pb::bus::WorkerStatus to;
  to.set_worker_id(from.worker_id);
  to.set_host(from.host);
  to.set_program_version(from.program_version);
  to.set_pid(from.pid);
  to.set_build_id(from.build_id);
  to.set_lanes(from.lanes);
  to.set_phase(static_cast<pb::bus::WorkerPhase>(from.phase));
  to.set_learner_epoch(from.learner_epoch);
  to.set_policy_version(from.policy_version);
  to.set_tasks_received(from.tasks_received);
  to.set_tasks_declined_no_weights(from.tasks_declined_no_weights);
  to.set_tasks_declined_config(from.tasks_declined_config);
  to.set_tasks_declined_state(from.tasks_declined_state);
  to.set_tasks_declined_epoch(from.tasks_declined_epoch);
  to.set_tasks_abandoned(from.tasks_abandoned);
  to.set_tasks_in_progress(from.tasks_in_progress);
  to.set_segments_published(from.segments_published);
  to.set_write_timeouts(from.write_timeouts);
  to.set_steps(from.steps);
  to.set_steps_per_s(from.steps_per_s);
  to.set_sim_time_fraction(from.sim_time_fraction);
  to.set_socket_receive_buffer_bytes(from.socket_receive_buffer_bytes);
  to.set_rexmit_bytes(from.rexmit_bytes);
  to.set_throttle_count(from.throttle_count);
  to.set_time_throttle_ns(from.time_throttle_ns);
  to.mutable_warnings()->Assign(from.warnings.begin(), from.warnings.end());
  to.mutable_alarms()->Assign(from.alarms.begin(), from.alarms.end());
  to.set_alarms_raised(from.alarms_raised);
  to.set_frames_published(from.frames_published);
  return to;
}

pb::bus::LearnerStatus to_message(const LearnerStatus& from) {
  pb::bus::LearnerStatus to;
  to.set_run_id(from.run_id);
  to.set_learner_epoch(from.learner_epoch);
  to.set_policy_version(from.policy_version);
  to.set_batch(from.batch);
  to.set_phase(static_cast<pb::bus::LearnerPhase>(from.phase));
  to.set_workers_alive(from.workers_alive);
  to.set_oldest_task_age_s(from.oldest_task_age_s);
  to.set_steps_total(from.steps_total);
  to.set_steps_per_s(from.steps_per_s);
  to.set_bytes_up_per_s(from.bytes_up_per_s);
  to.set_bytes_down_per_s(from.bytes_down_per_s);
  to.set_mean_return(from.mean_return);
  to.set_mean_length(from.mean_length);
  to.set_approx_kl(from.approx_kl);
  to.set_entropy(from.entropy);
  to.set_explained_variance(from.explained_variance);
  to.set_weights_hash(bytes_of(from.weights_hash));
  to.mutable_worker_ids()->Assign(from.worker_ids.begin(), from.worker_ids.end());
  to.set_worker_phases(bytes_of(from.worker_phases));
  to.mutable_worker_steps_per_s()->Assign(from.worker_steps_per_s.begin(),
                                          from.worker_steps_per_s.end());
  to.mutable_barred_worker_ids()->Assign(from.barred_worker_ids.begin(),
                                         from.barred_worker_ids.end());
  to.mutable_unheard_worker_ids()->Assign(from.unheard_worker_ids.begin(),
                                          from.unheard_worker_ids.end());
  to.mutable_barred_reasons()->Assign(from.barred_reasons.begin(), from.barred_reasons.end());
  to.mutable_alarms()->Assign(from.alarms.begin(), from.alarms.end());
  to.set_alarms_raised(from.alarms_raised);
  to.set_steps_wanted(from.steps_wanted);
  to.set_granted(from.granted);
  to.set_regranted(from.regranted);
  to.set_received(from.received);
  to.set_admitted(from.admitted);
  to.set_duplicate(from.duplicate);
  to.set_stale(from.stale);
  to.set_invalid(from.invalid);
  to.set_cancelled(from.cancelled);
  to.set_foreign(from.foreign);
  to.set_overflow(from.overflow);
  to.set_outstanding(from.outstanding);
  to.set_audit_mismatch(from.audit_mismatch);
  return to;
}

pb::bus::EpisodeSummary to_message(const EpisodeSummary& from) {
  pb::bus::EpisodeSummary to;
  to.set_source(static_cast<pb::bus::Source>(from.source));
  to.set_slot(from.slot);
  to.set_episode(from.episode);
  to.set_first_version(from.first_version);
  to.set_last_version(from.last_version);
  to.set_length_steps(from.length_steps);
  to.set_return_sum(from.return_sum);
  to.set_return_discounted(from.return_discounted);
  to.set_outcome(static_cast<pb::bus::Outcome>(from.outcome));
  to.set_exposure_fraction(from.exposure_fraction);
  to.mutable_start_position_in_world_m()->Assign(from.start_position_in_world_m.begin(),
                                                 from.start_position_in_world_m.end());
  to.mutable_grasp_position_in_world_m()->Assign(from.grasp_position_in_world_m.begin(),
                                                 from.grasp_position_in_world_m.end());
  return to;
}

pb::bus::RunManifest to_message(const RunManifest& from) {
  pb::bus::RunManifest to;
  to.set_run_id(from.run_id);
  to.set_learner_epoch(from.learner_epoch);
  to.set_config_text(from.config_text);
  to.set_config_hash(from.config_hash);
  to.set_layout_hash(from.layout_hash);
  to.set_build_id(from.build_id);
  to.set_git_revision(from.git_revision);
  to.set_run_seed(from.run_seed);
  to.set_slots(from.slots);
  to.set_steps_per_segment(from.steps_per_segment);
  to.set_lead(from.lead);
  to.set_state_format(from.state_format);
  to.mutable_observation_names()->Assign(from.observation_names.begin(),
                                         from.observation_names.end());
  to.mutable_action_names()->Assign(from.action_names.begin(), from.action_names.end());
  return to;
}

pb::bus::ControlCommand to_message(const ControlCommand& from) {
  pb::bus::ControlCommand to;
  to.set_run_id(from.run_id);
  to.set_request(from.request);
  to.set_issuer(from.issuer);
  to.set_action(static_cast<pb::bus::ControlAction>(from.action));
  to.set_worker_id(from.worker_id);
  to.set_slot(from.slot);
  to.set_frames_hz(from.frames_hz);
  to.set_sent_at_ns(from.sent_at_ns);
  return to;
}

pb::bus::ControlReply to_message(const ControlReply& from) {
  pb::bus::ControlReply to;
  to.set_run_id(from.run_id);
  to.set_request(from.request);
  to.set_program(from.program);
  to.set_worker_id(from.worker_id);
  to.set_done(from.done);
  to.set_text(from.text);
  return to;
}

pb::bus::SimFrame to_message(const SimFrame& from) {
  pb::bus::SimFrame to;
  to.set_slot(from.slot);
  to.set_run_id(from.run_id);
  to.set_worker_id(from.worker_id);
  to.set_policy_version(from.policy_version);
  to.set_episode(from.episode);
  to.set_episode_step(from.episode_step);
  to.set_sim_time_s(from.sim_time_s);
  to.mutable_particle_positions_in_world_m()->Assign(from.particle_positions_in_world_m.begin(),
                                                     from.particle_positions_in_world_m.end());
  to.mutable_tool_position_in_world_m()->Assign(from.tool_position_in_world_m.begin(),
                                                from.tool_position_in_world_m.end());
  to.set_grasped(from.grasped);
  return to;
}

pb::bus::RobotStatus to_message(const RobotStatus& from) {
  pb::bus::RobotStatus to;
  to.set_gateway_id(from.gateway_id);
  to.set_run_id(from.run_id);
  to.set_robot(from.robot);
  to.set_host(from.host);
  to.set_pid(from.pid);
  to.set_program_version(from.program_version);
  to.set_phase(static_cast<pb::bus::RobotPhase>(from.phase));
  to.set_armed(from.armed);
  to.set_dry_run(from.dry_run);
  to.set_reason(from.reason);
  to.set_reason_name(from.reason_name);
  to.set_reason_text(from.reason_text);
  to.set_operating_state(from.operating_state);
  to.set_is_homed(from.is_homed);
  to.set_is_busy(from.is_busy);
  to.set_registered(from.registered);
  to.mutable_measured_cp_in_world_m()->Assign(from.measured_cp_in_world_m.begin(),
                                              from.measured_cp_in_world_m.end());
  to.mutable_setpoint_cp_in_world_m()->Assign(from.setpoint_cp_in_world_m.begin(),
                                              from.setpoint_cp_in_world_m.end());
  to.mutable_goal_cp_in_world_m()->Assign(from.goal_cp_in_world_m.begin(),
                                          from.goal_cp_in_world_m.end());
  to.mutable_measured_tip_in_world_m()->Assign(from.measured_tip_in_world_m.begin(),
                                               from.measured_tip_in_world_m.end());
  to.mutable_measured_jp()->Assign(from.measured_jp.begin(), from.measured_jp.end());
  to.mutable_setpoint_jp()->Assign(from.setpoint_jp.begin(), from.setpoint_jp.end());
  to.mutable_goal_jp()->Assign(from.goal_jp.begin(), from.goal_jp.end());
  to.set_measured_jaw_rad(from.measured_jaw_rad);
  to.set_setpoint_jaw_rad(from.setpoint_jaw_rad);
  to.set_goal_jaw_rad(from.goal_jaw_rad);
  to.set_datagrams(from.datagrams);
  to.set_malformed(from.malformed);
  to.set_foreign(from.foreign);
  to.set_unknown_keys(from.unknown_keys);
  to.set_not_finite(from.not_finite);
  to.set_reordered(from.reordered);
  to.set_restarts(from.restarts);
  to.set_cut(from.cut);
  to.set_unsent(from.unsent);
  to.set_sent(from.sent);
  to.mutable_refusals()->Assign(from.refusals.begin(), from.refusals.end());
  to.mutable_refusal_names()->Assign(from.refusal_names.begin(), from.refusal_names.end());
  to.set_stops(from.stops);
  to.set_latency_p50_ms(from.latency_p50_ms);
  to.set_latency_max_ms(from.latency_max_ms);
  to.set_jitter_p50_ms(from.jitter_p50_ms);
  to.set_jitter_max_ms(from.jitter_max_ms);
  to.set_state_age_p50_ms(from.state_age_p50_ms);
  to.set_state_age_max_ms(from.state_age_max_ms);
  to.set_periods(from.periods);
  to.set_late(from.late);
  to.set_missed(from.missed);
  to.set_unwatched(from.unwatched);
  to.set_episodes(from.episodes);
  to.set_segments_published(from.segments_published);
  to.set_write_failures(from.write_failures);
  to.set_policy_version(from.policy_version);
  to.set_weights_hash(bytes_of(from.weights_hash));
  to.set_sent_at_ns(from.sent_at_ns);
  return to;
}

}  // namespace omentum
