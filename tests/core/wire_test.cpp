#include "core/wire.h"

#include <gtest/gtest.h>

#include <cmath>

#include "omentum.h"  // generated: only to put garbage on the wire
#include "tests/support/domain.h"

namespace omentum {
namespace {

using test::PrivateDomain;

// Fills every field with a different value, so that a field forgotten in one direction or swapped
// with another shows.
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

PolicyWeights some(const PolicyWeights&) {
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

RolloutTask some(const RolloutTask&) {
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

RolloutSegment some(const RolloutSegment&) {
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

WorkerStatus some(const WorkerStatus&) {
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

LearnerStatus some(const LearnerStatus&) {
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
  return r;
}

EpisodeSummary some(const EpisodeSummary&) {
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

RunManifest some(const RunManifest&) {
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

ControlCommand some(const ControlCommand&) {
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

ControlReply some(const ControlReply&) {
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

SimFrame some(const SimFrame&) {
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

RobotStatus some(const RobotStatus&) {
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

// Field-by-field text of a record; two records are equal when their texts are.
template <typename... Fields>
std::string texts(const Fields&... fields) {
  std::string all;
  const auto one = [&all](const auto& field) {
    using T = std::decay_t<decltype(field)>;
    if constexpr (std::is_same_v<T, std::string>) {
      all += field + "|";
    } else if constexpr (requires { field.begin(); }) {
      all += "[" + std::to_string(field.size()) + ":";
      for (const auto& value : field) {
        if constexpr (std::is_convertible_v<decltype(value), std::string>) {
          all += value + ",";
        } else {
          all += std::to_string(static_cast<double>(value)) + ",";
        }
      }
      all += "]|";
    } else if constexpr (std::is_enum_v<T>) {
      all += std::to_string(static_cast<std::uint32_t>(field)) + "|";
    } else {
      all += std::to_string(field) + "|";
    }
  };
  (one(fields), ...);
  return all;
}

std::string text_of(const PolicyWeights& r) {
  return texts(r.policy_id, r.learner_epoch, r.policy_version, r.weights_hash, r.layout_hash,
               r.config_hash, r.parameters, r.obs_mean, r.obs_inv_std, r.published_at_ns);
}
std::string text_of(const RolloutTask& r) {
  return texts(r.slot, r.segment, r.grant, r.worker_id, r.learner_epoch, r.task_hash,
               r.policy_version, r.weights_hash, r.config_hash, r.kind, r.greedy, r.start_set,
               r.start_index, r.steps, r.run_seed, r.episode, r.episode_step, r.episode_limit,
               r.reset, r.state_format, r.start_hash, r.start_state, r.frame_stride, r.policy_steps,
               r.hold_steps, r.granted_at_ns, r.live_frames_hz);
}
std::string text_of(const RolloutSegment& r) {
  return texts(
      r.slot, r.segment, r.grant, r.worker_id, r.learner_epoch, r.task_hash, r.policy_version,
      r.build_id, r.source, r.steps, r.observations, r.actions, r.actions_continuous, r.log_probs,
      r.rewards, r.values, r.flags, r.bootstrap_observation, r.final_observations,
      r.episode_end_step, r.episode_return, r.episode_length, r.episode_outcome, r.episode_exposure,
      r.episode_grasped, r.episode_held, r.episode_grasp_position_in_world_m,
      r.episode_start_position_in_world_m, r.end_episode, r.end_episode_step, r.end_episode_limit,
      r.state_format, r.end_hash, r.end_state, r.failed, r.failure, r.physics_ticks, r.state_hashes,
      r.frame_positions_in_world_m, r.tool_positions_in_world_m, r.exposures, r.payload_crc32c,
      r.compute_time_ns, r.wait_time_ns, r.granted_at_ns, r.weights_hash);
}
std::string text_of(const WorkerStatus& r) {
  return texts(r.worker_id, r.host, r.program_version, r.pid, r.build_id, r.lanes, r.phase,
               r.learner_epoch, r.policy_version, r.tasks_received, r.tasks_declined_no_weights,
               r.tasks_declined_config, r.tasks_declined_state, r.tasks_declined_epoch,
               r.tasks_abandoned, r.tasks_in_progress, r.segments_published, r.write_timeouts,
               r.steps, r.steps_per_s, r.sim_time_fraction, r.socket_receive_buffer_bytes,
               r.rexmit_bytes, r.throttle_count, r.time_throttle_ns, r.warnings, r.alarms,
               r.alarms_raised, r.frames_published);
}
std::string text_of(const LearnerStatus& r) {
  return texts(r.run_id, r.learner_epoch, r.policy_version, r.batch, r.phase, r.granted,
               r.regranted, r.received, r.admitted, r.duplicate, r.stale, r.invalid, r.cancelled,
               r.foreign, r.overflow, r.outstanding, r.audit_mismatch, r.workers_alive,
               r.oldest_task_age_s, r.steps_total, r.steps_per_s, r.bytes_up_per_s,
               r.bytes_down_per_s, r.mean_return, r.mean_length, r.approx_kl, r.entropy,
               r.explained_variance, r.weights_hash, r.worker_ids, r.worker_phases,
               r.worker_steps_per_s, r.barred_worker_ids, r.barred_reasons, r.alarms,
               r.alarms_raised, r.steps_wanted);
}
std::string text_of(const EpisodeSummary& r) {
  return texts(r.source, r.slot, r.episode, r.first_version, r.last_version, r.length_steps,
               r.return_sum, r.return_discounted, r.outcome, r.exposure_fraction,
               r.start_position_in_world_m, r.grasp_position_in_world_m);
}
std::string text_of(const RunManifest& r) {
  return texts(r.run_id, r.learner_epoch, r.config_text, r.config_hash, r.layout_hash, r.build_id,
               r.git_revision, r.run_seed, r.slots, r.steps_per_segment, r.lead, r.state_format,
               r.observation_names, r.action_names);
}

std::string text_of(const ControlCommand& r) {
  return texts(r.run_id, r.request, r.issuer, r.action, r.worker_id, r.slot, r.frames_hz,
               r.sent_at_ns);
}
std::string text_of(const ControlReply& r) {
  return texts(r.run_id, r.request, r.program, r.worker_id, r.done, r.text);
}
std::string text_of(const SimFrame& r) {
  return texts(r.slot, r.run_id, r.worker_id, r.policy_version, r.episode, r.episode_step,
               r.sim_time_s, r.particle_positions_in_world_m, r.tool_position_in_world_m,
               r.grasped);
}

std::string text_of(const RobotStatus& r) {
  return texts(
      r.gateway_id, r.run_id, r.robot, r.host, r.pid, r.program_version, r.phase, r.armed,
      r.dry_run, r.reason, r.reason_name, r.reason_text, r.operating_state, r.is_homed, r.is_busy,
      r.registered, r.measured_cp_in_world_m, r.setpoint_cp_in_world_m, r.goal_cp_in_world_m,
      r.measured_tip_in_world_m, r.measured_jp, r.setpoint_jp, r.goal_jp, r.measured_jaw_rad,
      r.setpoint_jaw_rad, r.goal_jaw_rad, r.datagrams, r.malformed, r.foreign, r.unknown_keys,
      r.not_finite, r.reordered, r.restarts, r.cut, r.unsent, r.sent, r.refusals, r.refusal_names,
      r.stops, r.latency_p50_ms, r.latency_max_ms, r.jitter_p50_ms, r.jitter_max_ms,
      r.state_age_p50_ms, r.state_age_max_ms, r.periods, r.late, r.missed, r.unwatched, r.episodes,
      r.segments_published, r.write_failures, r.policy_version, r.weights_hash, r.sent_at_ns);
}

// A writer and a reader of one topic in a domain of their own.
template <typename Record>
struct Pair {
  Pair()
      : participant(domain.id(), test::loopback_profile().uri, "test"),
        writer(participant, run_partition("r"), "w"),
        reader(participant, run_partition("r"), "r"),
        waitset(participant) {
    waitset.attach(reader.raw());
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(10);
    while (writer.matched() == 0 && std::chrono::steady_clock::now() < end) waitset.wait(1'000'000);
    EXPECT_EQ(writer.matched(), 1);
  }

  std::vector<Record> take() {
    std::vector<Record> records;
    EXPECT_TRUE(waitset.wait(10'000'000'000));
    const Result<int> taken = reader.take(64, [&records](Arrival<Record>&& arrival) {
      if (arrival.info.valid) records.push_back(std::move(arrival.record));
    });
    EXPECT_TRUE(taken);
    return records;
  }

  PrivateDomain domain;
  dds::Participant participant;
  BusWriter<Record> writer;
  BusReader<Record> reader;
  dds::Waitset waitset;
};

template <typename Record>
class Wire : public testing::Test {};
using Records = testing::Types<PolicyWeights, RolloutTask, RolloutSegment, WorkerStatus,
                               LearnerStatus, EpisodeSummary, RunManifest, ControlCommand,
                               ControlReply, SimFrame, RobotStatus>;
TYPED_TEST_SUITE(Wire, Records);

TYPED_TEST(Wire, EveryFieldMakesTheRoundTrip) {
  Pair<TypeParam> pair;
  const TypeParam sent = some(TypeParam{});
  const Result<void> ok = pair.writer.write(sent);
  ASSERT_TRUE(ok) << ok.error();
  const std::vector<TypeParam> got = pair.take();
  ASSERT_EQ(got.size(), 1u) << pair.reader.last_refusal();
  EXPECT_EQ(text_of(got[0]), text_of(sent));
}

TYPED_TEST(Wire, AnEmptyRecordMakesTheRoundTrip) {
  Pair<TypeParam> pair;
  TypeParam sent;
  if constexpr (std::is_same_v<TypeParam, RolloutTask>) sent.reset = true;
  ASSERT_TRUE(pair.writer.write(sent));
  const std::vector<TypeParam> got = pair.take();
  ASSERT_EQ(got.size(), 1u) << pair.reader.last_refusal();
  EXPECT_EQ(text_of(got[0]), text_of(sent));
}

TEST(WireChecks, WhatTheTypesCannotCarryIsRefusedAtTheWriter) {
  Pair<RunManifest> manifests;
  RunManifest manifest;
  manifest.observation_names.assign(65, "x");
  EXPECT_FALSE(manifests.writer.write(manifest));
  manifest.observation_names.assign(64, "x");
  manifest.config_text = std::string("a\0b", 3);
  EXPECT_FALSE(manifests.writer.write(manifest));
  manifest.config_text = "ab";
  EXPECT_TRUE(manifests.writer.write(manifest));

  Pair<RolloutTask> tasks;
  RolloutTask task;
  task.reset = true;
  task.start_state.resize((1u << 20) + 1);
  EXPECT_FALSE(tasks.writer.write(task));
  task.start_state.resize(1u << 20);
  EXPECT_TRUE(tasks.writer.write(task));
  task.kind = static_cast<TaskKind>(9);
  EXPECT_FALSE(tasks.writer.write(task));
}

TEST(WireChecks, TasksAndStatusAndWeightsWithBadLengthsAreRefused) {
  Pair<RolloutTask> tasks;
  RolloutTask task;
  task.steps = 5;
  task.reset = true;
  task.reset = false;  // no state either
  ASSERT_TRUE(tasks.writer.write(task));
  EXPECT_TRUE(tasks.take().empty());
  EXPECT_EQ(tasks.reader.refused(), 1u);

  Pair<LearnerStatus> statuses;
  LearnerStatus status;
  status.worker_ids = {1, 2};
  ASSERT_TRUE(statuses.writer.write(status));
  EXPECT_TRUE(statuses.take().empty());
  status = {};
  status.barred_worker_ids = {1};  // for no reason
  ASSERT_TRUE(statuses.writer.write(status));
  EXPECT_TRUE(statuses.take().empty());

  Pair<PolicyWeights> weights;
  PolicyWeights record;
  record.obs_mean = {1};
  ASSERT_TRUE(weights.writer.write(record));
  EXPECT_TRUE(weights.take().empty());
}

// Somebody writes our topics with our types but without our code.
TEST(WireChecks, GarbageInTheGeneratedTypesIsRefused) {
  const PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "test");
  const TopicSpec& spec = topic_spec(TopicId::kPolicyWeights);
  const dds::Topic topic(participant, spec, omentum_v1_PolicyWeights_desc);
  dds::Writer writer(participant, topic,
                     {.partitions = run_partition("r"), .entity_name = "rogue"});
  BusReader<PolicyWeights> reader(participant, run_partition("r"), "r");
  dds::Waitset waitset(participant);
  waitset.attach(reader.raw());
  omentum_v1_PolicyWeights sample{};
  const auto refused_after_write = [&] {
    EXPECT_TRUE(writer.write(&sample));
    EXPECT_TRUE(waitset.wait(10'000'000'000));
    EXPECT_TRUE(reader.take(64, [](Arrival<PolicyWeights>&&) { ADD_FAILURE(); }));
    return reader.refused();
  };
  EXPECT_EQ(refused_after_write(), 1u);  // a hash of no bytes
  std::uint8_t bytes[31] = {};
  sample.weights_hash._buffer = bytes;
  sample.weights_hash._length = sample.weights_hash._maximum = 31;
  EXPECT_EQ(refused_after_write(), 2u);
  EXPECT_NE(reader.last_refusal().find("weights_hash"), std::string::npos);
}

TEST(WireChecks, LifeCycleSamplesCarryTheKeyOnly) {
  Pair<LearnerStatus> pair;
  LearnerStatus status = some(LearnerStatus{});
  ASSERT_TRUE(pair.writer.write(status));
  ASSERT_EQ(pair.take().size(), 1u);
  ASSERT_TRUE(pair.writer.dispose(status));
  ASSERT_TRUE(pair.waitset.wait(10'000'000'000));
  int seen = 0;
  ASSERT_TRUE(pair.reader.take(64, [&](Arrival<LearnerStatus>&& arrival) {
    ++seen;
    EXPECT_FALSE(arrival.info.valid);
    EXPECT_EQ(arrival.info.state, dds::InstanceState::kDisposed);
    EXPECT_EQ(arrival.record.run_id, status.run_id);
    EXPECT_EQ(arrival.record.learner_epoch, status.learner_epoch);
    EXPECT_EQ(arrival.record.granted, 0u);
  }));
  EXPECT_EQ(seen, 1);
}

}  // namespace
}  // namespace omentum
