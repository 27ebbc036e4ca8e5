#include "dvrk_gateway/safety/safety.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <set>
#include <string>

#include "core/check.h"
#include "core/config.h"
#include "tests/dvrk_gateway/ideal_robot.h"
#include "tests/support/allocation_count.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using testing::HasSubstr;
using testing::Not;

constexpr std::int64_t kPeriod = 20'000'000;
const Vector3d kStart(-0.0216, 0.058, 0.1076);  // p_WT

bool is_goal(const Judgement& judged) {
  return judged.send && judged.command.kind != RobotCommand::Kind::kHold;
}

/// The loop of the gateway in simulated time: an ideal robot, a policy that moves the tip in W, an
/// operator. `fault` may change what judge() is about to be given.
class Script {
 public:
  explicit Script(const pb::SafetyLimits& limits = {}, const ToolMount& mount = test::paper_mount(),
                  const Eigen::Isometry3d& X_AR = Eigen::Isometry3d::Identity())
      : setup(make_safety_setup(limits, mount, X_AR, true)),
        robot(*mount.instrument, X_AR, joints_for_tip(mount, kStart).value()),
        tip(kStart) {}

  SafetySetup setup;
  test::IdealRobot robot;
  SafetyMemory memory;
  GatewayEvents events;
  PolicyRequest request;
  std::int64_t now_ns = 1'000'000'000;
  double robot_s = 100;
  Vector3d tip;                                 ///< goal of the policy, p_WT
  Vector3d increment = Vector3d(0.0003, 0, 0);  ///< of each action
  bool acts = true, reports = true;
  std::function<void(Script&)> fault;

  RobotCommand goal_of(const Vector3d& p_WT) const {
    const Eigen::Isometry3d X_AW = setup.X_AR * setup.mount.X_WR.inverse();
    RobotCommand command;
    command.kind = RobotCommand::Kind::kServoCp;
    command.rotation = X_AW.linear() * setup.mount.R_WC;
    command.translation = X_AW * setup.mount.control_point(p_WT);
    command.jaw = 0.5;
    return command;
  }

  Judgement tick(std::int64_t dt_ns = kPeriod) {
    now_ns += dt_ns;
    robot_s += 0.02;
    if (reports) robot.report(now_ns, robot_s);
    request = {};
    if (acts && memory.phase == SafetyPhase::kActive) {
      tip += increment;
      request = {true, goal_of(tip)};
    }
    if (fault) fault(*this);
    const Judgement judged = judge(setup, memory, robot.state, request, events, now_ns);
    memory = judged.memory;
    if (judged.send) robot.obey(judged.command);
    return judged;
  }
  void ticks(int count) {
    for (int k = 0; k < count; ++k) tick();
  }
  void press_arm() { events.arm_ns = now_ns + 1; }
  /// Ready, then armed, then on the way for some periods.
  void go(int periods = 5) {
    ticks(10);
    ASSERT_EQ(memory.phase, SafetyPhase::kReady) << describe(tick().finding);
    press_arm();
    tick();
    ASSERT_EQ(memory.phase, SafetyPhase::kActive);
    for (int k = 0; k < periods; ++k) {
      const Judgement judged = tick();
      ASSERT_TRUE(is_goal(judged)) << describe(judged.finding);
    }
  }
  /// The first reason to stop within so many periods.
  StopReason stops_within(int periods) {
    for (int k = 0; k < periods; ++k) {
      if (const Judgement judged = tick(); judged.stopped_now) return judged.finding.reason;
    }
    return StopReason::kNone;
  }
};

pb::SafetyLimits dead_man_limits() {
  pb::SafetyLimits limits;
  limits.set_dead_man(true);
  return limits;
}

Eigen::Isometry3d turned_base() {
  Eigen::Isometry3d X_AR = Eigen::Isometry3d::Identity();
  X_AR.linear() = Eigen::AngleAxisd(0.8, Vector3d(1, 2, -1).normalized()).toRotationMatrix();
  X_AR.translation() = Vector3d(0.3, -0.2, 0.5);
  return X_AR;
}

// ---------------------------------------------------------------------------------------------
// Phases

TEST(SafetyPhases, ListeningUntilSomethingIsReceived) {
  Script script;
  script.robot.state = {};
  script.reports = false;
  const Judgement judged = script.tick();
  EXPECT_EQ(judged.memory.phase, SafetyPhase::kListening);
  EXPECT_EQ(judged.finding.reason, StopReason::kNothingReceived);
  EXPECT_FALSE(judged.send);
}

TEST(SafetyPhases, ReadyAfterTenConsecutiveGoodPeriods) {
  Script script;
  for (int k = 0; k < 9; ++k) {
    script.tick();
    EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting) << k;
  }
  script.tick();
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
}

TEST(SafetyPhases, OneBadPeriodCountsFromTheBeginning) {
  Script script;
  script.ticks(9);
  script.robot.state.operating_state.payload.is_busy = true;
  EXPECT_EQ(script.tick().finding.reason, StopReason::kBusy);
  script.robot.state.operating_state.payload.is_busy = false;
  script.ticks(9);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting);
  script.tick();
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
}

TEST(SafetyPhases, PeriodsWithoutANewTimestampDoNotCount) {
  Script script;
  script.tick();
  script.reports = false;
  for (int k = 0; k < 20; ++k) script.tick(1'000'000);
  EXPECT_EQ(script.memory.ready_count, 1U);
}

TEST(SafetyPhases, ReadyIsLostWithItsCondition) {
  Script script;
  script.ticks(12);
  script.robot.state.operating_state.payload.is_homed = false;
  EXPECT_EQ(script.tick().finding.reason, StopReason::kNotHomed);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting);
  script.press_arm();
  script.ticks(3);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting);
}

TEST(SafetyPhases, NothingIsSentBeforeArming) {
  Script script;
  script.fault = [](Script& s) { s.request = {true, s.goal_of(kStart)}; };
  for (int k = 0; k < 50; ++k) EXPECT_FALSE(script.tick().send);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
}

TEST(SafetyPhases, ArmedThereIsNothingToSendUntilThePolicyActs) {
  Script script;
  script.acts = false;
  script.go(0);
  for (int k = 0; k < 50; ++k) EXPECT_FALSE(script.tick().send);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kActive);
}

TEST(SafetyPhases, GoalsAreSentAsTheyAreAsked) {
  for (const Eigen::Isometry3d& X_AR : {Eigen::Isometry3d::Identity(), turned_base()}) {
    Script script({}, test::paper_mount(), X_AR);
    script.go(0);
    for (int k = 0; k < 100; ++k) {
      if (k == 50) script.increment = Vector3d(-0.0005, 0.0005, -0.0005);
      const Judgement judged = script.tick();
      ASSERT_TRUE(is_goal(judged)) << describe(judged.finding);
      EXPECT_EQ(judged.command.translation, script.request.command.translation);
      EXPECT_EQ(judged.command.rotation, script.request.command.rotation);
      EXPECT_FALSE(judged.jaw_clipped);
    }
  }
}

TEST(SafetyPhases, JointGoalsAreJudgedLikeCartesianOnes) {
  Script script;
  script.fault = [](Script& s) {
    if (!s.request.fresh) return;
    s.request.command.joints = joints_for_tip(s.setup.mount, s.tip).value();
    s.request.command.kind = RobotCommand::Kind::kServoJp;
  };
  script.go(40);
  script.tip.z() += 0.002;
  EXPECT_EQ(script.stops_within(1), StopReason::kStep);
}

TEST(SafetyPhases, AnEpisodeEndsWithHoldAndTheNextOneStartsAtTheSetPoint) {
  Script script;
  script.go();
  script.acts = false;
  script.fault = [](Script& s) { s.request = {true, RobotCommand{}}; };
  EXPECT_EQ(script.tick().command.kind, RobotCommand::Kind::kHold);
  script.fault = nullptr;
  int holds = 1;
  for (int k = 0; k < 30; ++k) {
    const Judgement judged = script.tick();
    if (judged.send) {
      EXPECT_EQ(judged.command.kind, RobotCommand::Kind::kHold);
      ++holds;
    }
  }
  EXPECT_EQ(holds, 3);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kActive);
  script.acts = true;
  EXPECT_TRUE(is_goal(script.tick()));
  // Elsewhere it does not start.
  script.acts = false;
  script.fault = [](Script& s) { s.request = {true, RobotCommand{}}; };
  script.tick();
  script.fault = nullptr;
  script.acts = true;
  script.tip += Vector3d(0.002, 0, 0);
  EXPECT_EQ(script.stops_within(1), StopReason::kStep);
}

// ---------------------------------------------------------------------------------------------
// Latch

TEST(SafetyLatch, AnEventBeforeReadyDoesNotArm) {
  Script script;
  script.ticks(5);
  script.press_arm();
  script.ticks(30);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
}

TEST(SafetyLatch, AnEventOfTheFutureOrLongAgoDoesNotArm) {
  Script script;
  script.ticks(12);
  script.events.arm_ns = script.now_ns + 10 * kPeriod;
  script.ticks(3);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
  script.events.arm_ns = script.now_ns;
  // The gateway stood still while the key was pressed.
  script.tick(1'000'000'000);
  EXPECT_NE(script.memory.phase, SafetyPhase::kActive);
}

TEST(SafetyLatch, DeadManModeNeedsTheKeyToArmAndToStayArmed) {
  Script script(dead_man_limits());
  script.ticks(12);
  script.press_arm();
  script.ticks(3);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
  script.fault = [](Script& s) { s.events.held_ns = s.now_ns; };
  script.press_arm();
  script.ticks(20);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kActive);
  script.fault = nullptr;
  EXPECT_EQ(script.stops_within(4), StopReason::kNone);
  EXPECT_EQ(script.stops_within(3), StopReason::kDeadManReleased);
}

// ---------------------------------------------------------------------------------------------
// Every reason to stop

struct Row {
  StopReason reason;
  int within;  ///< periods
  std::function<void(Script&)> fault;
  pb::SafetyLimits limits = {};
};

void invalidate(RobotState& state) { state.measured_cp.payload.valid = false; }

std::function<void(Script&)> asks(const std::function<void(RobotCommand&)>& change) {
  return [change](Script& s) { change(s.request.command); };
}

/// Goals through a point that the tip cannot reach, if nothing else were in the way.
std::function<void(Script&)> asks_for_tip(const Vector3d& p_WT) {
  return [p_WT](Script& s) { s.request = {true, s.goal_of(p_WT)}; };
}

/// Reported instead of the pose that goes with the goals.
std::function<void(Script&)> stands_at(double insertion) {
  return [insertion](Script& s) {
    PsmJoints q = s.robot.joints();
    q[2] = insertion;
    s.robot.place(q);
    s.robot.report(s.now_ns, s.robot_s);
  };
}

std::vector<Row> rows() {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  using State = OperatingState::State;
  std::vector<Row> rows = {
      {StopReason::kOperatorStop, 1, [](Script& s) { s.events.stop_ns = s.now_ns; }},
      {StopReason::kGatewayFault, 1, [](Script& s) { s.events.fault = true; }},
      {StopReason::kClockBackward, 1, [](Script& s) { s.now_ns -= 5 * kPeriod; }},
      {StopReason::kTickLate, 1,
       [](Script& s) {
         s.now_ns += 5 * kPeriod;
         s.robot.report(s.now_ns, s.robot_s);
       }},
      {StopReason::kForeignSource, 1, [](Script& s) { ++s.robot.state.foreign; }},
      {StopReason::kForeignSource, 1, [](Script& s) { s.robot.state.source.port = 7; }},
      {StopReason::kTimestampBackward, 1, [](Script& s) { ++s.robot.state.restarts; }},
      {StopReason::kTimestampBackward, 1,
       [](Script& s) { s.robot.state.setpoint_cp.payload.timestamp_s = 1; }},
      {StopReason::kStale, 3, [](Script& s) { s.reports = false; }},
      {StopReason::kStale, 1, [](Script& s) { s.robot.state.gap_s = 0.02; }},
      {StopReason::kStale, 3,
       [](Script& s) { s.robot.state.measured_js.advanced_ns = 1'300'000'000; }},
      {StopReason::kStale, 3,
       [](Script& s) { s.robot.state.operating_state.arrival_ns = 1'300'000'000; }},
      {StopReason::kFault, 1,
       [](Script& s) { s.robot.state.operating_state.payload.state = State::kFault; }},
      {StopReason::kNotEnabled, 1,
       [](Script& s) { s.robot.state.operating_state.payload.state = State::kPaused; }},
      {StopReason::kNotEnabled, 1,
       [](Script& s) { s.robot.state.operating_state.payload.state = State::kUnknown; }},
      {StopReason::kNotHomed, 1,
       [](Script& s) { s.robot.state.operating_state.payload.is_homed = false; }},
      {StopReason::kBusy, 1,
       [](Script& s) { s.robot.state.operating_state.payload.is_busy = true; }},
      {StopReason::kInvalid, 1, [](Script& s) { invalidate(s.robot.state); }},
      {StopReason::kInvalid, 1,
       [](Script& s) { s.robot.state.operating_state.payload.valid = false; }},
      {StopReason::kInvalid, 1,
       [nan](Script& s) { s.robot.state.setpoint_cp.payload.translation.y() = nan; }},
      {StopReason::kJointCount, 1, [](Script& s) { s.robot.state.measured_js.payload.count = 7; }},
      {StopReason::kJointCount, 1,
       [](Script& s) { s.robot.state.jaw_measured_js.payload.count = 0; }},
      {StopReason::kNotOrthonormal, 1,
       [](Script& s) { s.robot.state.setpoint_cp.payload.rotation *= 1.00001; }},
      {StopReason::kNotOrthonormal, 1,
       [nan](Script& s) { s.robot.state.measured_cp.payload.rotation(1, 1) = nan; }},
      {StopReason::kWrongInstrument, 1,
       [](Script& s) { s.robot.state.local_measured_cp.payload.translation.z() -= 0.05; }},
      {StopReason::kBaseFrame, 1,
       [](Script& s) { s.robot.state.measured_cp.payload.translation.z() -= 0.0001; }},
      {StopReason::kInCannula, 1, stands_at(0.05)},
      {StopReason::kSetpointApart, 3,
       [](Script& s) {
         s.robot.state.setpoint_cp.payload.translation.y() -= 0.0015;
         s.robot.state.setpoint_cp.payload.timestamp_s += 1e-3;
       }},
      {StopReason::kTracking, 6,
       [](Script& s) {
         for (auto* pose : {&s.robot.state.measured_cp.payload}) pose->timestamp_s += 1e-3;
         s.robot.state.measured_cp.payload.translation.y() -= 0.006;
       }},
      {StopReason::kEffort, 6,
       [](Script& s) { s.robot.state.measured_js.payload.effort[2] = -8.0; }},
      {StopReason::kEffort, 6,
       [](Script& s) { s.robot.state.measured_js.payload.effort[5] = 0.17; }},
      {StopReason::kPolicyLate, 2, [](Script& s) { s.request = {}; }},
      {StopReason::kNotFinite, 1, asks([nan](RobotCommand& c) { c.translation.x() = nan; })},
      {StopReason::kNotFinite, 1, asks([nan](RobotCommand& c) { c.rotation(0, 2) = nan; })},
      {StopReason::kNotFinite, 1, asks([nan](RobotCommand& c) { c.jaw = nan; })},
      {StopReason::kRotation, 1, asks([](RobotCommand& c) { c.rotation *= 1 + 1e-8; })},
      {StopReason::kRotation, 1, asks([](RobotCommand& c) { c.rotation.col(0) *= -1; })},
      {StopReason::kFeedForward, 1, asks([](RobotCommand& c) { c.has_velocity = true; })},
      {StopReason::kOutsideBox, 1, asks_for_tip(Vector3d(-0.0216, 0.058, 0.1195))},
      {StopReason::kJointLimit, 1, asks_for_tip(Vector3d(-0.0914, 0.11, 0.002))},
      {StopReason::kStep, 1,
       [](Script& s) {
         s.tip.y() += 0.00051;
         s.request.command = s.goal_of(s.tip);
       }},
      {StopReason::kJointStep, 1,
       [](Script& s) {
         const Eigen::AngleAxisd roll(0.08, Vector3d::UnitZ());
         s.request.command.rotation = s.request.command.rotation * roll;
       }},
      {StopReason::kTooFast, 8,
       [](Script& s) {
         s.now_ns -= kPeriod * 3 / 4;
         s.robot_s += 1e-4;
         s.robot.report(s.now_ns, s.robot_s);
       }},
  };
  // A robot that drops what it is told: the goal runs away from it.
  Row jump{StopReason::kJump, 12, [](Script& s) {
             s.robot.place(joints_for_tip(s.setup.mount, kStart).value());
             s.robot.report(s.now_ns, s.robot_s);
           }};
  jump.limits.set_setpoint_error_periods(50);
  rows.push_back(jump);
  rows.push_back({StopReason::kDeadManReleased, 7, [](Script&) {}, dead_man_limits()});
  return rows;
}

TEST(SafetyStops, EachFiresOnceSendsHoldThreeTimesAndLatches) {
  for (const Row& row : rows()) {
    SCOPED_TRACE(stop_reason_name(row.reason));
    Script script(row.limits);
    if (row.limits.dead_man()) script.fault = [](Script& s) { s.events.held_ns = s.now_ns; };
    script.go();
    script.fault = row.fault;
    Judgement judged;
    int periods = 0;
    do {
      judged = script.tick();
      ++periods;
      ASSERT_LE(periods, row.within) << "not stopped";
      ASSERT_TRUE(judged.send || !script.reports || row.reason == StopReason::kPolicyLate);
    } while (!judged.stopped_now);
    EXPECT_STREQ(stop_reason_name(judged.finding.reason), stop_reason_name(row.reason));
    EXPECT_EQ(judged.memory.phase, SafetyPhase::kStopped);
    EXPECT_EQ(judged.command.kind, RobotCommand::Kind::kHold);
    EXPECT_THAT(describe(judged.finding), Not(HasSubstr("\n")));

    // The cause goes away, the policy acts on, the operator presses the key to arm: nothing.
    script.fault = nullptr;
    script.reports = true;
    script.events.fault = false;
    script.events.held_ns = 0;
    const std::uint16_t port = script.robot.state.source.port;
    script.robot = test::IdealRobot(*script.setup.mount.instrument, script.setup.X_AR,
                                    joints_for_tip(script.setup.mount, kStart).value());
    script.robot.state.source.port = port;
    script.now_ns += 10 * kPeriod;
    script.robot_s += 10;
    int holds = 1;
    for (int k = 0; k < 60; ++k) {
      script.press_arm();
      judged = script.tick();
      EXPECT_FALSE(judged.stopped_now);
      ASSERT_EQ(judged.memory.stop.reason, row.reason);
      if (judged.send) {
        EXPECT_EQ(judged.command.kind, RobotCommand::Kind::kHold);
        EXPECT_LT(k, 2);
        ++holds;
      }
    }
    EXPECT_EQ(holds, 3);
    EXPECT_EQ(script.memory.phase, SafetyPhase::kStopped);

    // Acknowledged, it has to become ready and be armed anew.
    script.events.arm_ns = 0;
    script.events.acknowledge_ns = script.now_ns + 1;
    script.ticks(11);
    EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
    if (row.limits.dead_man()) script.fault = [](Script& s) { s.events.held_ns = s.now_ns; };
    script.tip = kStart;
    script.press_arm();
    script.ticks(3);
    EXPECT_EQ(script.memory.phase, SafetyPhase::kActive);
  }
}

TEST(SafetyStops, TheWayIntoTheCannulaAndThroughTheCentreIsRefused) {
  ToolMount mount = test::paper_mount();
  mount.workspace_min = Vector3d::Constant(-0.3);
  mount.workspace_max = Vector3d::Constant(0.3);
  const Vector3d p_WR = mount.X_WR.translation();
  for (const auto& [reason, p_WC] :
       {std::pair{StopReason::kCannula, Vector3d(p_WR - Vector3d(0, 0, 0.03))},
        {StopReason::kUnreachable, Vector3d(p_WR + Vector3d(0, 0, 1e-4))}}) {
    Script script({}, mount);
    script.go();
    script.fault = asks_for_tip(mount.tip(p_WC));
    EXPECT_EQ(script.stops_within(1), reason);
  }
}

// ---------------------------------------------------------------------------------------------
// Before arming

TEST(SafetyObstacles, TellWhatIsMissing) {
  Script old;
  old.robot.state.old_shapes_only = true;
  EXPECT_EQ(old.tick().finding.reason, StopReason::kOldShapes);

  Script stream;
  stream.fault = [](Script& s) { s.robot.state.local_measured_cp.seen = false; };
  const Judgement judged = stream.tick();
  EXPECT_EQ(judged.finding.reason, StopReason::kStreamMissing);
  EXPECT_THAT(describe(judged.finding), HasSubstr("local/measured_cp"));

  Script unregistered;
  unregistered.setup.registered = false;
  EXPECT_EQ(unregistered.tick().finding.reason, StopReason::kNoRegistration);

  // A tool that stands outside the box, or too near to a joint limit, is not driven in.
  Script outside;
  outside.setup.mount.workspace_max.z() = 0.1;
  EXPECT_EQ(outside.tick().finding.reason, StopReason::kOutsideBox);
  Script limit;
  limit.setup.joint_max[2] = 0.1;
  EXPECT_EQ(limit.tick().finding.reason, StopReason::kJointLimit);
}

TEST(SafetyObstacles, AWrongInstrumentIsNeverReady) {
  Script script({}, test::paper_mount(find_instrument("prograsp")));
  script.setup.mount.instrument = &large_needle_driver();
  script.ticks(30);
  EXPECT_EQ(script.tick().finding.reason, StopReason::kWrongInstrument);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting);
}

TEST(SafetyObstacles, PayloadsOfTwoMomentsAreNotCompared) {
  Script script;
  script.fault = [](Script& s) {
    s.robot.state.measured_js.payload.timestamp_s += 0.0007;
    s.robot.state.measured_js.payload.position[0] += 0.001;
  };
  script.ticks(12);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
}

// ---------------------------------------------------------------------------------------------
// What must not stop it

TEST(SafetyTolerance, OneLateActionRepeatsTheGoal) {
  Script script;
  script.go();
  for (int k = 0; k < 40; ++k) {
    script.acts = k % 2 == 0;
    const Judgement judged = script.tick();
    ASSERT_TRUE(is_goal(judged)) << describe(judged.finding);
    EXPECT_EQ(judged.command.translation, script.goal_of(script.tip).translation);
  }
}

TEST(SafetyTolerance, LostCommandsAndStatesWithinTheirLimitsDoNotStopIt) {
  // Commands are lost three in a row at full speed along every axis, states now and then.
  Script script;
  script.increment = Vector3d(0.0005, -0.0005, -0.0005);
  script.go(3);
  PsmJoints before = script.robot.joints();
  for (int k = 0; k < 60; ++k) {
    script.reports = k % 7 > 0;
    if (k % 6 == 0) before = script.robot.joints();
    const Judgement judged = script.tick();
    ASSERT_TRUE(is_goal(judged)) << describe(judged.finding);
    if (k % 6 < 3) script.robot.place(before);
  }
}

TEST(SafetyTolerance, JitterOfTheTickDoesNotStopIt) {
  Script script;
  script.go();
  for (int k = 0; k < 60; ++k) {
    const std::int64_t late = k % 3 == 0 ? 8'000'000 : k % 3 == 1 ? -8'000'000 : 0;
    ASSERT_TRUE(is_goal(script.tick(kPeriod + late)));
  }
}

TEST(SafetyTolerance, TrackingAndEffortAreForgivenWhenTheyPassInTime) {
  Script script;
  script.go();
  for (int k = 0; k < 40; ++k) {
    script.fault = k % 5 == 4 ? std::function<void(Script&)>() : [](Script& s) {
      s.robot.state.measured_js.payload.effort[0] = 3.3;
      s.robot.state.measured_cp.payload.timestamp_s += 1e-3;
      s.robot.state.measured_cp.payload.translation.x() += 0.006;
    };
    // The clean period is stamped like the others.
    if (!script.fault) {
      script.fault = [](Script& s) { s.robot.state.measured_cp.payload.timestamp_s += 1e-3; };
    }
    ASSERT_TRUE(is_goal(script.tick()));
  }
}

// ---------------------------------------------------------------------------------------------
// Jaw

TEST(SafetyJaw, IsClippedToItsRangeAndFollowsAtItsRate) {
  Script script;
  script.go();
  double before = 0.5;
  for (const double asked : {3.0, -2.0, 0.2}) {
    for (int k = 0; k < 60; ++k) {
      script.fault = asks([asked](RobotCommand& c) { c.jaw = asked; });
      script.increment = Vector3d::Zero();
      const Judgement judged = script.tick();
      ASSERT_TRUE(is_goal(judged));
      EXPECT_LE(std::abs(judged.command.jaw - before), 2 * 0.02 + 1e-12);
      EXPECT_GE(judged.command.jaw, -0.35);
      EXPECT_LE(judged.command.jaw, 1.396);
      EXPECT_EQ(judged.jaw_clipped, judged.command.jaw != asked);
      before = judged.command.jaw;
    }
    EXPECT_NEAR(before, std::clamp(asked, -0.35, 1.396), 1e-12);
  }
}

TEST(SafetyJaw, RangeIsThatOfTheInstrumentToo) {
  const SafetySetup setup =
      make_safety_setup({}, test::paper_mount(find_instrument("maryland_bipolar")),
                        Eigen::Isometry3d::Identity(), true);
  EXPECT_EQ(setup.jaw_min, -0.349);
}

// ---------------------------------------------------------------------------------------------
// Memory

TEST(SafetyMemoryUse, JudgingAllocatesNothing) {
  for (const Row& row : rows()) {
    Script script(row.limits);
    if (row.limits.dead_man()) script.fault = [](Script& s) { s.events.held_ns = s.now_ns; };
    script.go();
    script.robot.report(script.now_ns + 1, script.robot_s + 0.01);
    const PolicyRequest request{true, script.goal_of(script.tip)};
    for (int k = 0; k < 12; ++k) {
      // What the fault needs is allocated before.
      script.tick();
      script.fault = row.fault;
      const std::uint64_t before = test::allocation_count();
      const Judgement judged = judge(script.setup, script.memory, script.robot.state, request,
                                     script.events, script.now_ns + kPeriod);
      EXPECT_EQ(test::allocation_count(), before);
      EXPECT_TRUE(judged.send || judged.memory.phase == SafetyPhase::kStopped);
    }
  }
}

// ---------------------------------------------------------------------------------------------
// Set-up and texts

std::string refusal(const std::string& text) {
  try {
    pb::SafetyLimits limits;
    parse_text_proto("mine", text, limits);
    make_safety_setup(limits, test::paper_mount(), Eigen::Isometry3d::Identity(), true);
  } catch (const Error& error) {
    return error.what();
  }
  return "accepted";
}

TEST(SafetySetup, RefusesLimitsThatAreNoneWithTheirRange) {
  EXPECT_EQ(refusal(""), "accepted");
  EXPECT_EQ(refusal("step_m: 0.01"), "mine:1:1: step_m: 0.01 m, allowed 1e-05 ... 0.002");
  EXPECT_THAT(refusal("jump_m: nan"), HasSubstr("jump_m: nan m, allowed"));
  EXPECT_THAT(refusal("jaw_min_rad: 0.4 jaw_max_rad: 0.3"), HasSubstr("safety.jaw_min_rad: 0.4"));
  EXPECT_THAT(refusal("tick_gap_s: 0.02"), HasSubstr("safety.tick_gap_s: 0.02"));
  pb::SafetyLimits limits;
  limits.set_jump_m(1);
  EXPECT_THROW(make_safety_setup(limits, test::paper_mount(), Eigen::Isometry3d::Identity(), true),
               Error);
}

TEST(StopReasons, EachHasItsOwnNameAndText) {
  std::set<std::string> names, texts;
  for (int k = 1; k <= kStopReasons; ++k) {
    const auto reason = static_cast<StopReason>(k);
    names.insert(stop_reason_name(reason));
    const std::string text = describe({reason, 1.5, 2.5, 1});
    EXPECT_THAT(text, Not(HasSubstr("{")));
    EXPECT_THAT(text, Not(HasSubstr("\n")));
    texts.insert(text);
  }
  EXPECT_EQ(names.size(), static_cast<std::size_t>(kStopReasons));
  EXPECT_EQ(texts.size(), static_cast<std::size_t>(kStopReasons));
}

}  // namespace
}  // namespace omentum
