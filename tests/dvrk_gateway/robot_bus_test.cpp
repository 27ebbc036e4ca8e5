// What the gateway tells the bus of a run, from periods made by hand.
#include "dvrk_gateway/bus/robot_bus.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/segment_fields.h"
#include "tests/dvrk_gateway/ideal_robot.h"
#include "tests/support/domain.h"

namespace omentum {
namespace {

constexpr std::int64_t kNsPerMs = 1'000'000;
constexpr std::int64_t kPeriodNs = 20 * kNsPerMs;

SafetySetup some_setup() {
  return make_safety_setup({}, test::paper_mount(), Eigen::Isometry3d::Identity(), true);
}

/// Periods of an armed robot that stands still.
class Periods {
 public:
  explicit Periods(const SafetySetup& setup)
      : robot_(*setup.mount.instrument, setup.X_AR, {0.1, 0.2, 0.15, 0.3, -0.1, 0.2}) {
    period_.judgement.memory.phase = SafetyPhase::kActive;
    period_.judgement.memory.holding = true;
  }
  Period& next(std::int64_t after_ns = kPeriodNs) {
    ++period_.number;
    period_.began_ns += after_ns;
    robot_.report(period_.began_ns, 1e-9 * static_cast<double>(period_.began_ns));
    period_.robot = robot_.state;
    period_.judgement.stopped_now = false;
    period_.judgement.finding = {};
    period_.sent_ns = 0;
    return period_;
  }
  const test::IdealRobot& robot() const { return robot_; }

 private:
  test::IdealRobot robot_;
  Period period_;
};

TEST(RobotAccount, PlacesAreInWorldAndTheTipLiesBeyondTheControlPoint) {
  const SafetySetup setup = some_setup();
  Periods periods(setup);
  RobotAccount account(setup);
  Period& period = periods.next();
  const PsmPose goal = psm_forward({0, 0, 0.12, 0, 0, 0}, *setup.mount.instrument);
  period.judgement.memory.goal_RC = goal;
  account.add(period);
  const RobotStatus holding = account.status();
  EXPECT_TRUE(std::isnan(holding.goal_cp_in_world_m[0])) << "no goal is in force";
  EXPECT_TRUE(holding.goal_jp.empty());

  period.judgement.memory.holding = false;
  period.judgement.memory.goal_joints = {0, 0, 0.12, 0, 0, 0};
  period.judgement.memory.jaw = 0.25;
  account.add(period);
  const RobotStatus& status = account.status();
  const PsmPose pose = psm_forward(periods.robot().joints(), *setup.mount.instrument);
  const Eigen::Vector3d p_WC = setup.mount.X_WR * pose.p;
  const Eigen::Vector3d p_WG = setup.mount.X_WR * goal.p;
  const Eigen::Vector3d tip = Eigen::Vector3d::Map(status.measured_tip_in_world_m.data());
  for (int k = 0; k < 3; ++k) {
    const auto axis = static_cast<std::size_t>(k);
    EXPECT_NEAR(status.measured_cp_in_world_m[axis], p_WC[k], 1e-12);
    EXPECT_NEAR(status.setpoint_cp_in_world_m[axis], p_WC[k], 1e-12);
    EXPECT_NEAR(status.goal_cp_in_world_m[axis], p_WG[k], 1e-12);
  }
  EXPECT_NEAR((tip - p_WC).norm(), setup.mount.tip_offset, 1e-12);
  EXPECT_EQ(status.measured_jp, (std::vector<double>{0.1, 0.2, 0.15, 0.3, -0.1, 0.2}));
  EXPECT_EQ(status.goal_jp, (std::vector<double>{0, 0, 0.12, 0, 0, 0}));
  EXPECT_EQ(status.measured_jaw_rad, 0.5);
  EXPECT_EQ(status.goal_jaw_rad, 0.25);
  EXPECT_TRUE(status.armed && status.is_homed && status.registered);
  EXPECT_FALSE(status.is_busy);
  EXPECT_EQ(status.operating_state, "ENABLED");
}

TEST(RobotAccount, AStreamThatIsInvalidHasNoPlace) {
  const SafetySetup setup = some_setup();
  Periods periods(setup);
  RobotAccount account(setup);
  Period& period = periods.next();
  period.robot.measured_cp.payload.valid = false;
  period.robot.measured_js.payload.valid = false;
  account.add(period);
  EXPECT_TRUE(std::isnan(account.status().measured_cp_in_world_m[2]));
  EXPECT_TRUE(account.status().measured_jp.empty());
}

TEST(RobotAccount, AStopIsCountedOnceByItsReasonAndToldWhileItLasts) {
  const SafetySetup setup = some_setup();
  Periods periods(setup);
  RobotAccount account(setup);
  account.add(periods.next());
  Period& stop = periods.next();
  const Finding finding{.reason = StopReason::kStep, .value = 0.0007, .allowed = 0.0005, .part = 1};
  stop.judgement.finding = stop.judgement.memory.stop = finding;
  stop.judgement.memory.phase = SafetyPhase::kStopped;
  stop.judgement.stopped_now = true;
  account.add(stop);
  account.add(periods.next());
  const RobotStatus& status = account.status();
  EXPECT_EQ(status.stops, 1U);
  ASSERT_EQ(status.refusals.size(), static_cast<std::size_t>(kStopReasons) + 1);
  EXPECT_EQ(status.refusals[static_cast<std::size_t>(StopReason::kStep)], 1U);
  EXPECT_EQ(status.refusal_names.at(static_cast<std::size_t>(StopReason::kStep)), "STEP");
  EXPECT_EQ(status.reason, static_cast<std::uint32_t>(StopReason::kStep));
  EXPECT_EQ(status.reason_name, "STEP");
  EXPECT_EQ(status.reason_text, describe(finding));
  EXPECT_FALSE(status.armed);
  EXPECT_EQ(status.phase, RobotPhase::kStopped);
}

TEST(RobotAccount, DatagramsThatWereNotTakenAreCountedByTheirFate) {
  const SafetySetup setup = some_setup();
  Periods periods(setup);
  RobotAccount account(setup);
  Period& period = periods.next();
  period.robot.datagrams = 11;
  period.robot.malformed = 1;
  period.robot.foreign = 2;
  period.robot.unknown_keys = 3;
  period.robot.not_finite = 4;
  period.robot.reordered = 5;
  period.robot.restarts = 6;
  period.cut = 7;
  period.unsent = 8;
  period.late = 9;
  period.missed = 10;
  period.unwatched = 12;
  account.add(period);
  const RobotStatus& s = account.status();
  const std::vector<std::uint64_t> told = {s.malformed, s.foreign,  s.unknown_keys, s.not_finite,
                                           s.reordered, s.restarts, s.cut,          s.unsent,
                                           s.late,      s.missed,   s.datagrams,    s.unwatched};
  EXPECT_EQ(told, (std::vector<std::uint64_t>{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}));
}

TEST(RobotAccount, DurationsAreThoseOfTheLastWholeSecond) {
  const SafetySetup setup = some_setup();
  Periods periods(setup);
  RobotAccount account(setup);
  for (int k = 0; k < 100; ++k) {
    Period& period = periods.next();
    // The first second is slow, the second one fast; one of each is the slowest.
    const std::int64_t latency = (k < 50 ? 8 : 1) * kNsPerMs + (k % 50 == 20 ? 3 * kNsPerMs : 0);
    period.sent_ns = period.began_ns + latency;
    period.state_ns = period.began_ns;
    period.late_ns = latency / 2;
    account.add(period);
    if (k == 49) {
      EXPECT_TRUE(std::isnan(account.status().latency_p50_ms)) << "not whole yet";
    }
    if (k == 60) {
      EXPECT_DOUBLE_EQ(account.status().latency_p50_ms, 8);
      EXPECT_DOUBLE_EQ(account.status().latency_max_ms, 11);
    }
  }
  account.add(periods.next());
  EXPECT_DOUBLE_EQ(account.status().latency_p50_ms, 1);
  EXPECT_DOUBLE_EQ(account.status().latency_max_ms, 4);
  EXPECT_DOUBLE_EQ(account.status().jitter_p50_ms, 0.5);
  EXPECT_DOUBLE_EQ(account.status().state_age_max_ms, 4);
  EXPECT_EQ(account.status().sent, 100U);
}

/// A RobotBus and readers of what it publishes, in a domain of their own.
class RobotOnBus : public testing::Test {
 protected:
  RobotOnBus()
      : participant_(domain_.id(), test::loopback_profile().uri, "test"),
        states_(participant_, run_partition("r"), "states"),
        segments_(participant_, run_partition("r"), "segments", 64),
        summaries_(participant_, run_partition("r"), "summaries"),
        setup_(some_setup()),
        periods_(setup_),
        bus_(participant_, some_options(), setup_) {}

  static RobotBusOptions some_options() {
    RobotBusOptions options;
    options.run = "r";
    options.arm = "PSM2";
    options.build_id = 77;
    return options;
  }
  template <typename Record>
  std::vector<Arrival<Record>> take(BusReader<Record>& reader) {
    dds::Waitset waitset(participant_);
    waitset.attach(reader.raw());
    EXPECT_TRUE(waitset.wait(10'000 * kNsPerMs));
    std::vector<Arrival<Record>> taken;
    EXPECT_TRUE(reader.take(64, [&](Arrival<Record>&& a) { taken.push_back(std::move(a)); }));
    return taken;
  }

  test::PrivateDomain domain_;
  dds::Participant participant_;
  BusReader<RobotStatus> states_;
  BusReader<RolloutSegment> segments_;
  BusReader<EpisodeSummary> summaries_;
  SafetySetup setup_;
  Periods periods_;
  RobotBus bus_;
};

TEST_F(RobotOnBus, StateIsToldTenTimesASecondAndAtOnceWhenThePhaseChanges) {
  const auto told = [&] { return take(states_).at(0).record.periods; };
  bus_.on_period(periods_.next(kPeriodNs * 5));
  EXPECT_EQ(told(), 1U);
  for (int k = 0; k < 4; ++k) bus_.on_period(periods_.next());
  bus_.on_period(periods_.next());
  EXPECT_EQ(told(), 6U) << "those between are within 100 ms";
  Period& stopped = periods_.next();
  stopped.judgement.memory.phase = SafetyPhase::kStopped;
  bus_.on_period(stopped);
  EXPECT_EQ(told(), 7U) << "another phase";
}

TEST_F(RobotOnBus, StateNamesGatewayArmAndPinnedPolicy) {
  PolicyWeights weights;
  weights.policy_version = 31;
  weights.weights_hash.fill(9);
  bus_.pin(weights);
  bus_.on_period(periods_.next());
  const RobotStatus status = take(states_).at(0).record;
  EXPECT_EQ(status.gateway_id, bus_.gateway_id());
  EXPECT_EQ(status.run_id, "r");
  EXPECT_EQ(status.robot, "PSM2");
  EXPECT_EQ(status.pid, static_cast<std::uint32_t>(getpid()));
  EXPECT_EQ(status.policy_version, 31U);
  EXPECT_EQ(status.weights_hash, weights.weights_hash);
}

TEST_F(RobotOnBus, AnEpisodeIsPublishedAsOfARobotWithItsSummary) {
  RolloutTask task;
  task.episode = 5;
  RolloutSegment segment;
  segment.source = Source::kSimulation;  // whatever the back end says
  segment.policy_version = 31;
  segment.steps = 1;
  segment.observations = {4, 5};
  segment.actions = {0, 1, 2, 1};
  segment.log_probs = segment.rewards = segment.values = {0.5F};
  segment.flags = {step_flag::kFirst};
  segment.episode_end_step = {0};
  segment.episode_return = {0.5};
  segment.episode_length = {1};
  segment.episode_outcome = {static_cast<std::uint8_t>(Outcome::kSafetyStop)};
  segment.episode_exposure = {0.25F};
  segment.episode_grasped = segment.episode_held = {0};
  segment.episode_grasp_position_in_world_m = {NAN, NAN, NAN};
  segment.episode_start_position_in_world_m = {1, 2, 3};
  segment.payload_crc32c = segment_crc(segment);
  bus_.on_episode(task, segment);

  const RolloutSegment got = take(segments_).at(0).record;
  EXPECT_EQ(got.source, Source::kDvrk);
  EXPECT_EQ(got.worker_id, bus_.gateway_id());
  EXPECT_EQ(got.build_id, 77U);
  EXPECT_EQ(got.rewards, segment.rewards);
  EXPECT_EQ(got.payload_crc32c, segment_crc(got));
  const EpisodeSummary summary = take(summaries_).at(0).record;
  EXPECT_EQ(summary.source, Source::kDvrk);
  EXPECT_EQ(summary.outcome, Outcome::kSafetyStop);
  EXPECT_EQ(summary.episode, 5U);
  EXPECT_EQ(summary.last_version, 31U);
  bus_.on_period(periods_.next());
  const RobotStatus status = take(states_).at(0).record;
  EXPECT_EQ(status.episodes, 1U);
  EXPECT_EQ(status.segments_published, 1U);
  EXPECT_EQ(status.write_failures, 0U);
}

TEST(RobotBus, AGatewayThatLeavesIsDisposed) {
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "test");
  BusReader<RobotStatus> reader(participant, run_partition("r"), "states");
  const SafetySetup setup = some_setup();
  std::uint32_t id = 0;
  {
    RobotBusOptions options;
    options.run = "r";
    RobotBus bus(participant, options, setup);
    id = bus.gateway_id();
    Periods periods(setup);
    bus.on_period(periods.next());
  }
  std::vector<Arrival<RobotStatus>> arrivals;
  dds::Waitset waitset(participant);
  waitset.attach(reader.raw());
  ASSERT_TRUE(waitset.wait(10'000 * kNsPerMs));
  ASSERT_TRUE(reader.take(64, [&](Arrival<RobotStatus>&& a) { arrivals.push_back(std::move(a)); }));
  ASSERT_FALSE(arrivals.empty());
  EXPECT_EQ(arrivals.back().info.state, dds::InstanceState::kDisposed);
  EXPECT_EQ(arrivals.back().record.gateway_id, id);
}

}  // namespace
}  // namespace omentum
