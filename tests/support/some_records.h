#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/simulation_records.h"
#include "core/types.h"

/// A record of every topic that passes the checks of core/wire.cpp, no two fields alike.
namespace omentum::test {

/// Fills every field with a different value, so that a field forgotten in one direction or swapped
/// with another shows.
class Counter {
 public:
  template <typename T>
  T next() {
    return static_cast<T>(++count_);
  }
  template <typename T>
  std::vector<T> list(std::size_t size) {
    std::vector<T> values(size);
    for (T& value : values) value = static_cast<T>(++count_);
    return values;
  }
  std::string text() { return "text " + std::to_string(++count_); }
  Sha256 hash() {
    Sha256 hash{};
    for (std::uint8_t& b : hash) b = static_cast<std::uint8_t>(++count_);
    return hash;
  }

 private:
  std::uint64_t count_ = 0;
};

inline PolicyWeights some(const PolicyWeights&) {
  Counter c;
  PolicyWeights r;
  r.policy_id = c.next<std::uint32_t>();
  r.learner_epoch = c.next<std::uint32_t>();
  r.policy_version = c.next<std::uint64_t>() + (std::uint64_t{1} << 40);
  r.weights_hash = c.hash();
  r.layout_hash = c.next<std::uint64_t>();
  r.config_hash = c.next<std::uint64_t>();
  r.parameters = c.list<float>(37'644);
  r.obs_mean = c.list<float>(12);
  r.obs_inv_std = c.list<float>(12);
  r.published_at_ns = c.next<std::int64_t>();
  return r;
}

inline RolloutTask some(const RolloutTask&) {
  Counter c;
  RolloutTask r;
  r.slot = c.next<std::uint32_t>();
  r.segment = c.next<std::uint64_t>() + (std::uint64_t{1} << 40);
  r.grant = c.next<std::uint32_t>();
  r.worker_id = c.next<std::uint32_t>();
  r.learner_epoch = c.next<std::uint32_t>();
  r.task_hash = c.next<std::uint64_t>();
  r.policy_version = c.next<std::uint64_t>();
  r.weights_hash = c.hash();
  r.config_hash = c.next<std::uint64_t>();
  r.kind = TaskKind::kEvaluate;
  r.greedy = true;
  r.start_set = StartSet::kGraspLattice;
  r.start_index = c.next<std::uint32_t>();
  r.steps = 5;
  r.run_seed = c.next<std::uint64_t>();
  r.episode = c.next<std::uint64_t>();
  r.episode_step = c.next<std::uint32_t>();
  r.episode_limit = c.next<std::uint32_t>();
  r.reset = true;
  r.state_format = c.next<std::uint32_t>();
  r.start_hash = c.next<std::uint64_t>();
  r.start_state = Bytes(23'064, std::byte{9});
  r.frame_stride = c.next<std::uint32_t>();
  r.policy_steps = c.next<std::uint32_t>();
  r.hold_steps = c.next<std::uint32_t>();
  r.granted_at_ns = -c.next<std::int64_t>();
  r.live_frames_hz = 12.5F;
  return r;
}

inline RolloutSegment some(const RolloutSegment&) {
  Counter c;
  RolloutSegment r;
  r.slot = c.next<std::uint32_t>();
  r.segment = c.next<std::uint64_t>();
  r.grant = c.next<std::uint32_t>();
  r.worker_id = c.next<std::uint32_t>();
  r.learner_epoch = c.next<std::uint32_t>();
  r.task_hash = c.next<std::uint64_t>();
  r.policy_version = c.next<std::uint64_t>();
  r.build_id = c.next<std::uint64_t>();
  r.source = Source::kDvrk;
  r.steps = 6;
  r.observations = c.list<float>(18);
  r.actions = c.list<std::uint8_t>(24);
  r.actions_continuous = c.list<float>(24);
  r.log_probs = c.list<float>(6);
  r.rewards = c.list<float>(6);
  r.values = c.list<float>(6);
  r.flags = c.list<std::uint8_t>(6);
  r.bootstrap_observation = c.list<float>(3);
  r.final_observations = c.list<float>(6);
  r.episode_end_step = {2, 5};
  r.episode_return = c.list<double>(2);
  r.episode_length = c.list<std::uint32_t>(2);
  r.episode_outcome = {0, 4};
  r.episode_exposure = c.list<float>(2);
  r.episode_grasped = c.list<std::uint8_t>(2);
  r.episode_held = c.list<std::uint8_t>(2);
  r.episode_grasp_position_in_world_m = c.list<float>(6);
  r.episode_start_position_in_world_m = c.list<float>(6);
  r.end_episode = c.next<std::uint64_t>();
  r.end_episode_step = c.next<std::uint32_t>();
  r.end_episode_limit = c.next<std::uint32_t>();
  r.state_format = c.next<std::uint32_t>();
  r.end_hash = c.next<std::uint64_t>();
  r.end_state = Bytes(23'064, std::byte{3});
  r.failed = 0;
  r.failure = c.text();
  r.physics_ticks = c.next<std::uint64_t>();
  r.state_hashes = c.list<std::uint64_t>(6);
  r.frame_positions_in_world_m = c.list<float>(30);
  r.tool_positions_in_world_m = c.list<float>(18);
  r.exposures = c.list<float>(6);
  r.payload_crc32c = c.next<std::uint32_t>();
  r.compute_time_ns = c.next<std::int64_t>();
  r.wait_time_ns = c.next<std::int64_t>();
  r.granted_at_ns = c.next<std::int64_t>();
  r.weights_hash = c.hash();
  return r;
}

inline WorkerStatus some(const WorkerStatus&) {
  Counter c;
  WorkerStatus r;
  r.worker_id = c.next<std::uint32_t>();
  r.host = c.text();
  r.program_version = c.text();
  r.pid = c.next<std::uint32_t>();
  r.build_id = c.next<std::uint64_t>();
  r.lanes = c.next<std::uint32_t>();
  r.phase = WorkerPhase::kDraining;
  r.learner_epoch = c.next<std::uint32_t>();
  for (std::uint64_t* field :
       {&r.policy_version, &r.tasks_received, &r.tasks_declined_no_weights,
        &r.tasks_declined_config, &r.tasks_declined_state, &r.tasks_declined_epoch,
        &r.tasks_abandoned, &r.tasks_in_progress, &r.segments_published, &r.write_timeouts,
        &r.steps, &r.socket_receive_buffer_bytes, &r.rexmit_bytes, &r.throttle_count,
        &r.time_throttle_ns}) {
    *field = c.next<std::uint64_t>();
  }
  r.steps_per_s = c.next<double>();
  r.sim_time_fraction = c.next<double>();
  r.warnings = {c.text(), "", c.text()};
  r.alarms = {c.text()};
  r.alarms_raised = c.next<std::uint64_t>();
  r.frames_published = c.next<std::uint64_t>();
  return r;
}

inline LearnerStatus some(const LearnerStatus&) {
  Counter c;
  LearnerStatus r;
  r.run_id = c.text();
  r.learner_epoch = c.next<std::uint32_t>();
  r.phase = LearnerPhase::kDone;
  for (std::uint64_t* field :
       {&r.policy_version, &r.batch, &r.granted, &r.regranted, &r.received, &r.admitted,
        &r.duplicate, &r.stale, &r.invalid, &r.cancelled, &r.foreign, &r.overflow, &r.outstanding,
        &r.audit_mismatch, &r.steps_total}) {
    *field = c.next<std::uint64_t>();
  }
  r.workers_alive = c.next<std::uint32_t>();
  for (double* field :
       {&r.oldest_task_age_s, &r.steps_per_s, &r.bytes_up_per_s, &r.bytes_down_per_s,
        &r.mean_return, &r.mean_length, &r.approx_kl, &r.entropy, &r.explained_variance}) {
    *field = c.next<double>();
  }
  r.weights_hash = c.hash();
  r.worker_ids = c.list<std::uint32_t>(3);
  r.worker_phases = c.list<std::uint8_t>(3);
  r.barred_worker_ids = c.list<std::uint32_t>(2);
  r.barred_reasons = {"declines", "invalid results"};
  r.worker_steps_per_s = c.list<double>(3);
  r.alarms = {c.text(), c.text()};
  r.alarms_raised = c.next<std::uint64_t>();
  r.steps_wanted = c.next<std::uint64_t>();
  r.unheard_worker_ids = c.list<std::uint32_t>(2);
  return r;
}

inline EpisodeSummary some(const EpisodeSummary&) {
  Counter c;
  EpisodeSummary r;
  r.source = Source::kDvrk;
  r.slot = c.next<std::uint32_t>();
  r.episode = c.next<std::uint64_t>();
  r.first_version = c.next<std::uint64_t>();
  r.last_version = c.next<std::uint64_t>();
  r.length_steps = c.next<std::uint32_t>();
  r.return_sum = c.next<double>();
  r.return_discounted = c.next<double>();
  r.outcome = Outcome::kError;
  r.exposure_fraction = c.next<float>();
  r.start_position_in_world_m = {c.next<double>(), c.next<double>(), c.next<double>()};
  r.grasp_position_in_world_m = {c.next<double>(), c.next<double>(), NAN};
  return r;
}

inline RunManifest some(const RunManifest&) {
  Counter c;
  RunManifest r;
  r.run_id = c.text();
  r.learner_epoch = c.next<std::uint32_t>();
  r.config_text = std::string(20'000, 'x');
  r.config_hash = c.next<std::uint64_t>();
  r.layout_hash = c.next<std::uint64_t>();
  r.build_id = c.next<std::uint64_t>();
  r.git_revision = c.text();
  r.run_seed = c.next<std::uint64_t>();
  r.slots = c.next<std::uint32_t>();
  r.steps_per_segment = c.next<std::uint32_t>();
  r.lead = c.next<std::uint32_t>();
  r.state_format = c.next<std::uint32_t>();
  r.observation_names = {c.text(), c.text()};
  r.action_names = {c.text()};
  return r;
}

inline ControlCommand some(const ControlCommand&) {
  Counter c;
  ControlCommand r;
  r.run_id = c.text();
  r.request = c.next<std::uint64_t>();
  r.issuer = c.text();
  r.action = ControlAction::kFramesOff;
  r.worker_id = c.next<std::uint32_t>();
  r.slot = c.next<std::uint32_t>();
  r.frames_hz = 12.5F;
  r.sent_at_ns = c.next<std::int64_t>();
  return r;
}

inline ControlReply some(const ControlReply&) {
  Counter c;
  ControlReply r;
  r.run_id = c.text();
  r.request = c.next<std::uint64_t>();
  r.program = c.text();
  r.worker_id = c.next<std::uint32_t>();
  r.done = true;
  r.text = c.text();
  return r;
}

inline SimFrame some(const SimFrame&) {
  Counter c;
  SimFrame r;
  r.slot = c.next<std::uint32_t>();
  r.run_id = c.text();
  r.worker_id = c.next<std::uint32_t>();
  r.policy_version = c.next<std::uint64_t>();
  r.episode = c.next<std::uint64_t>();
  r.episode_step = c.next<std::uint32_t>();
  r.sim_time_s = c.next<double>();
  r.particle_positions_in_world_m = c.list<float>(30);
  r.tool_position_in_world_m = {c.next<double>(), c.next<double>(), c.next<double>()};
  r.grasped = true;
  return r;
}

inline RobotStatus some(const RobotStatus&) {
  Counter c;
  RobotStatus r;
  r.gateway_id = c.next<std::uint32_t>();
  r.run_id = c.text();
  r.robot = c.text();
  r.host = c.text();
  r.pid = c.next<std::uint32_t>();
  r.program_version = c.text();
  r.phase = RobotPhase::kStopped;
  r.armed = true;
  r.dry_run = true;
  r.reason = c.next<std::uint32_t>();
  r.reason_name = c.text();
  r.reason_text = c.text();
  r.operating_state = c.text();
  r.is_homed = true;
  r.is_busy = true;
  r.registered = true;
  r.measured_cp_in_world_m = {c.next<double>(), c.next<double>(), c.next<double>()};
  r.setpoint_cp_in_world_m = {c.next<double>(), c.next<double>(), c.next<double>()};
  r.goal_cp_in_world_m = {c.next<double>(), c.next<double>(), c.next<double>()};
  r.measured_tip_in_world_m = {c.next<double>(), c.next<double>(), c.next<double>()};
  r.measured_jp = c.list<double>(6);
  r.setpoint_jp = c.list<double>(6);
  r.goal_jp = c.list<double>(6);
  r.measured_jaw_rad = c.next<double>();
  r.setpoint_jaw_rad = c.next<double>();
  r.goal_jaw_rad = c.next<double>();
  r.datagrams = c.next<std::uint64_t>();
  r.malformed = c.next<std::uint64_t>();
  r.foreign = c.next<std::uint64_t>();
  r.unknown_keys = c.next<std::uint64_t>();
  r.not_finite = c.next<std::uint64_t>();
  r.reordered = c.next<std::uint64_t>();
  r.restarts = c.next<std::uint64_t>();
  r.cut = c.next<std::uint64_t>();
  r.unsent = c.next<std::uint64_t>();
  r.sent = c.next<std::uint64_t>();
  r.refusals = c.list<std::uint64_t>(2);
  r.refusal_names = {c.text(), c.text()};
  r.stops = c.next<std::uint64_t>();
  r.latency_p50_ms = c.next<double>();
  r.latency_max_ms = c.next<double>();
  r.jitter_p50_ms = c.next<double>();
  r.jitter_max_ms = c.next<double>();
  r.state_age_p50_ms = c.next<double>();
  r.state_age_max_ms = c.next<double>();
  r.periods = c.next<std::uint64_t>();
  r.late = c.next<std::uint64_t>();
  r.missed = c.next<std::uint64_t>();
  r.unwatched = c.next<std::uint64_t>();
  r.episodes = c.next<std::uint64_t>();
  r.segments_published = c.next<std::uint64_t>();
  r.write_failures = c.next<std::uint64_t>();
  r.policy_version = c.next<std::uint64_t>();
  r.weights_hash = c.hash();
  r.sent_at_ns = c.next<std::int64_t>();
  return r;
}

inline SimulationGrant some(const SimulationGrant&) {
  Counter c;
  SimulationGrant r;
  r.asker_id = c.next<std::uint32_t>();
  r.task = c.next<std::uint32_t>();
  r.asker = c.text();
  r.grant = c.next<std::uint32_t>();
  r.worker_id = c.next<std::uint32_t>();
  r.format = c.next<std::uint32_t>();
  r.build_id = c.next<std::uint64_t>() + (std::uint64_t{1} << 40);
  r.task_hash = c.next<std::uint64_t>();
  r.steps = c.next<std::uint32_t>();
  r.payload = Bytes(11, std::byte{9});
  r.granted_at_ns = c.next<std::int64_t>();
  return r;
}

/// The last of two.
inline SimulationPart some(const SimulationPart&) {
  Counter c;
  SimulationPart r;
  r.asker_id = c.next<std::uint32_t>();
  r.task = c.next<std::uint32_t>();
  r.grant = c.next<std::uint32_t>();
  r.worker_id = c.next<std::uint32_t>();
  r.task_hash = c.next<std::uint64_t>() + (std::uint64_t{1} << 40);
  r.part = 1;
  r.parts = 2;
  r.payload = Bytes(7, std::byte{9});
  r.result_bytes = kPartBytes + r.payload.size();
  r.result_crc32c = c.next<std::uint32_t>();
  r.compute_time_ns = c.next<std::int64_t>();
  return r;
}

}  // namespace omentum::test
