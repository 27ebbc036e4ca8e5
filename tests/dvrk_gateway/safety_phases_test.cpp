// From listening to armed: phases, the latch of the operator, what is in the way before arming.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/dvrk_gateway/safety_script.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::dead_man_limits;
using test::is_goal;
using test::kPeriod;
using test::kStart;
using test::SafetyScript;
using testing::HasSubstr;

Eigen::Isometry3d turned_robot() {
  Eigen::Isometry3d X_AR = Eigen::Isometry3d::Identity();
  X_AR.linear() = Eigen::AngleAxisd(0.8, Vector3d(1, 2, -1).normalized()).toRotationMatrix();
  X_AR.translation() = Vector3d(0.3, -0.2, 0.5);
  return X_AR;
}

// ---------------------------------------------------------------------------------------------
// Phases

TEST(SafetyPhases, ListeningUntilSomethingIsReceived) {
  SafetyScript script;
  script.robot.state = {};
  script.reports = false;
  const Judgement judged = script.tick();
  EXPECT_EQ(judged.memory.phase, SafetyPhase::kListening);
  EXPECT_EQ(judged.finding.reason, StopReason::kNothingReceived);
  EXPECT_FALSE(judged.send);
}

TEST(SafetyPhases, ReadyAfterTenConsecutiveGoodPeriods) {
  SafetyScript script;
  for (int k = 0; k < 9; ++k) {
    script.tick();
    EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting) << k;
  }
  script.tick();
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
}

TEST(SafetyPhases, OneBadPeriodCountsFromTheBeginning) {
  SafetyScript script;
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
  SafetyScript script;
  script.tick();
  script.reports = false;
  for (int k = 0; k < 20; ++k) script.tick(1'000'000);
  EXPECT_EQ(script.memory.ready_count, 1U);
}

TEST(SafetyPhases, ReadyIsLostWithItsCondition) {
  SafetyScript script;
  script.ticks(12);
  script.robot.state.operating_state.payload.is_homed = false;
  EXPECT_EQ(script.tick().finding.reason, StopReason::kNotHomed);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting);
  script.press_arm();
  script.ticks(3);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting);
}

TEST(SafetyPhases, NothingIsSentBeforeArming) {
  SafetyScript script;
  script.fault = [](SafetyScript& s) { s.request = {true, s.goal_of(kStart)}; };
  for (int k = 0; k < 50; ++k) EXPECT_FALSE(script.tick().send);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
}

TEST(SafetyPhases, ArmedThereIsNothingToSendUntilThePolicyActs) {
  SafetyScript script;
  script.acts = false;
  script.go(0);
  for (int k = 0; k < 50; ++k) EXPECT_FALSE(script.tick().send);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kActive);
}

TEST(SafetyPhases, GoalsAreSentAsTheyAreAsked) {
  for (const Eigen::Isometry3d& X_AR : {Eigen::Isometry3d::Identity(), turned_robot()}) {
    SafetyScript script({}, test::paper_mount(), X_AR);
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
  SafetyScript script;
  script.fault = [](SafetyScript& s) {
    if (!s.request.fresh) return;
    s.request.command.joints = joints_for_tip(s.setup.mount, s.tip).value();
    s.request.command.kind = RobotCommand::Kind::kServoJp;
  };
  script.go(40);
  script.tip.z() += 0.002;
  EXPECT_EQ(script.stops_within(1), StopReason::kStep);
}

TEST(SafetyPhases, AnEpisodeEndsWithHoldAndTheNextOneStartsAtTheSetPoint) {
  SafetyScript script;
  script.go();
  script.acts = false;
  script.fault = [](SafetyScript& s) { s.request = {true, RobotCommand{}}; };
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
  script.fault = [](SafetyScript& s) { s.request = {true, RobotCommand{}}; };
  script.tick();
  script.fault = nullptr;
  script.acts = true;
  script.tip += Vector3d(0.002, 0, 0);
  EXPECT_EQ(script.stops_within(1), StopReason::kStep);
}

// ---------------------------------------------------------------------------------------------
// Latch

TEST(SafetyLatch, AnEventBeforeReadyDoesNotArm) {
  SafetyScript script;
  script.ticks(5);
  script.press_arm();
  script.ticks(30);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
}

TEST(SafetyLatch, AnEventOfTheFutureOrLongAgoDoesNotArm) {
  SafetyScript script;
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
  SafetyScript script(dead_man_limits());
  script.ticks(12);
  script.press_arm();
  script.ticks(3);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);
  script.fault = [](SafetyScript& s) { s.events.held_ns = s.now_ns; };
  script.press_arm();
  script.ticks(20);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kActive);
  script.fault = nullptr;
  EXPECT_EQ(script.stops_within(4), StopReason::kNone);
  EXPECT_EQ(script.stops_within(3), StopReason::kDeadManReleased);
}

// ---------------------------------------------------------------------------------------------
// Before arming

TEST(SafetyObstacles, TellWhatIsMissing) {
  SafetyScript old;
  old.robot.state.old_shapes_only = true;
  EXPECT_EQ(old.tick().finding.reason, StopReason::kOldShapes);

  SafetyScript stream;
  stream.fault = [](SafetyScript& s) { s.robot.state.local_measured_cp.seen = false; };
  const Judgement judged = stream.tick();
  EXPECT_EQ(judged.finding.reason, StopReason::kStreamMissing);
  EXPECT_THAT(describe(judged.finding), HasSubstr("local/measured_cp"));

  SafetyScript unregistered;
  unregistered.setup.registered = false;
  EXPECT_EQ(unregistered.tick().finding.reason, StopReason::kNoRegistration);

  // A tool that stands outside the box, or too near to a joint limit, is not driven in.
  SafetyScript outside;
  outside.setup.mount.workspace_max.z() = 0.1;
  EXPECT_EQ(outside.tick().finding.reason, StopReason::kOutsideBox);
  SafetyScript limit;
  limit.setup.joint_max[2] = 0.1;
  EXPECT_EQ(limit.tick().finding.reason, StopReason::kJointLimit);
}

TEST(SafetyObstacles, AWrongInstrumentIsNeverReady) {
  SafetyScript script({}, test::paper_mount(find_instrument("prograsp")));
  script.setup.mount.instrument = &large_needle_driver();
  script.ticks(30);
  EXPECT_EQ(script.tick().finding.reason, StopReason::kWrongInstrument);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting);
}

/// Every second period, or every one: joints of another moment than the poses.
std::function<void(SafetyScript&)> other_moment(int every) {
  return [every, k = 0](SafetyScript& s) mutable {
    if (++k % every != 0) return;
    s.robot.state.measured_js.payload.timestamp_s += 0.0007;
    s.robot.state.measured_js.payload.position[0] += 0.001;
  };
}

TEST(SafetyObstacles, PayloadsOfTwoMomentsAreNotComparedAndDoNotCount) {
  SafetyScript script;
  script.fault = other_moment(2);
  script.ticks(12);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting);
  script.ticks(8);
  EXPECT_EQ(script.memory.phase, SafetyPhase::kReady);

  SafetyScript never;
  never.fault = other_moment(1);
  never.ticks(100);
  EXPECT_EQ(never.tick().finding.reason, StopReason::kNotChecked);
  EXPECT_EQ(never.memory.phase, SafetyPhase::kWaiting);
}

TEST(SafetyObstacles, AWrongInstrumentIsOneSteadyLine) {
  SafetyScript script({}, test::paper_mount(find_instrument("prograsp")));
  script.setup.mount.instrument = &large_needle_driver();
  script.tick();
  script.fault = other_moment(2);
  for (int k = 0; k < 20; ++k)
    EXPECT_EQ(script.tick().finding.reason, StopReason::kWrongInstrument) << k;
}

TEST(SafetyObstacles, ASetpointWithAVelocityAtRestIsNeverArmed) {
  SafetyScript script;
  script.fault = [](SafetyScript& s) { s.robot.state.setpoint_js.payload.velocity[4] = 1e-9; };
  script.ticks(20);
  script.press_arm();
  const Judgement judged = script.tick();
  EXPECT_EQ(judged.finding.reason, StopReason::kSetpointVelocity);
  EXPECT_THAT(describe(judged.finding), HasSubstr("wrist_pitch"));
  EXPECT_EQ(script.memory.phase, SafetyPhase::kWaiting);

  SafetyScript untold;
  untold.fault = [](SafetyScript& s) { s.robot.state.setpoint_js.seen = false; };
  EXPECT_THAT(describe(untold.tick().finding), HasSubstr("setpoint_js was never received"));
}

TEST(SafetyObstacles, ABaseFrameThatDriftsByMicrometresIsNoise) {
  for (const auto& [drift_m, reason] :
       {std::pair{2e-5, StopReason::kNone}, {1e-4, StopReason::kBaseFrame}}) {
    SafetyScript script;
    script.go();
    script.fault = [by_m = drift_m](SafetyScript& s) {
      s.robot.state.measured_cp.payload.translation.x() += by_m;
    };
    EXPECT_EQ(script.stops_within(20), reason) << drift_m;
  }
}

TEST(SafetyObstacles, SayWhatToDoAndWhoIsHeard) {
  const auto paused = static_cast<double>(OperatingState::State::kPaused);
  EXPECT_THAT(describe({StopReason::kNotEnabled, paused, 0, -1}), HasSubstr("resume"));
  EXPECT_THAT(describe({StopReason::kNotEnabled, 1, 0, -1}), HasSubstr("power"));
  RobotState robot;
  robot.foreign = 3;
  robot.foreign_source = {0x0a000007, 9};
  EXPECT_THAT(describe({StopReason::kNothingReceived, 0, 0, -1}, robot), HasSubstr("10.0.0.7:9"));
}

}  // namespace
}  // namespace omentum
