#include "core/wire.h"

#include <gtest/gtest.h>

#include <cmath>

#include "omentum.h"  // generated: only to put garbage on the wire
#include "tests/support/domain.h"
#include "tests/support/some_records.h"

namespace omentum {
namespace {

using test::PrivateDomain;
using test::some;

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
               r.alarms_raised, r.steps_wanted, r.unheard_worker_ids);
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

std::string text_of(const SimulationGrant& r) {
  return texts(r.asker_id, r.task, r.asker, r.grant, r.worker_id, r.format, r.build_id, r.task_hash,
               r.steps, r.payload, r.granted_at_ns);
}
std::string text_of(const SimulationPart& r) {
  return texts(r.asker_id, r.task, r.grant, r.worker_id, r.task_hash, r.part, r.parts,
               r.result_bytes, r.result_crc32c, r.payload, r.compute_time_ns, r.declined);
}

/// The least that a record of its kind may hold.
template <typename Record>
Record least() {
  Record record;
  if constexpr (std::is_same_v<Record, RolloutTask>) record.reset = true;
  if constexpr (std::is_same_v<Record, SimulationGrant>) {
    record.steps = 1;
    record.payload.resize(1);
  }
  if constexpr (std::is_same_v<Record, SimulationPart>) {
    record.parts = 1;
    record.result_bytes = 1;
    record.payload.resize(1);
  }
  return record;
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
using Records =
    testing::Types<PolicyWeights, RolloutTask, RolloutSegment, WorkerStatus, LearnerStatus,
                   EpisodeSummary, RunManifest, ControlCommand, ControlReply, SimFrame, RobotStatus,
                   SimulationGrant, SimulationPart>;
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
  const TypeParam sent = least<TypeParam>();
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

TEST(WireChecks, PartsOfResultsHaveTheSizeThatFollowsFromTheWhole) {
  Pair<SimulationPart> pair;
  const auto arrives = [&pair](const SimulationPart& part) {
    EXPECT_TRUE(pair.writer.write(part));
    return pair.take().size() == 1;
  };
  SimulationPart part = some(SimulationPart{});
  EXPECT_TRUE(arrives(part));
  part.part = 2;
  EXPECT_FALSE(arrives(part));
  part = some(SimulationPart{});
  part.payload.pop_back();
  EXPECT_FALSE(arrives(part));
  part = some(SimulationPart{});
  part.parts = 3;
  EXPECT_FALSE(arrives(part));
  part = some(SimulationPart{});
  part.result_bytes = std::uint64_t{1} << 62;
  EXPECT_FALSE(arrives(part));
  part = {};
  EXPECT_FALSE(arrives(part)) << "neither a part nor a reason";
  part.declined = "another build";
  EXPECT_TRUE(arrives(part));
  part.parts = 1;
  EXPECT_FALSE(arrives(part));
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
