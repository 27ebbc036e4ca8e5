// Every reason to stop: it fires, holds and latches, has a name, and judging it allocates nothing.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <set>
#include <string>
#include <vector>

#include "tests/dvrk_gateway/safety_script.h"
#include "tests/support/allocation_count.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::asks;
using test::dead_man_limits;
using test::kPeriod;
using test::kStart;
using test::SafetyScript;
using testing::HasSubstr;
using testing::Not;

struct Row {
  StopReason reason;
  int within;  ///< periods
  std::function<void(SafetyScript&)> fault;
  pb::SafetyLimits limits = {};
};

void invalidate(RobotState& state) { state.measured_cp.payload.valid = false; }

/// Goals through a point that the tip cannot reach, if nothing else were in the way.
std::function<void(SafetyScript&)> asks_for_tip(const Vector3d& p_WT) {
  return [p_WT](SafetyScript& s) { s.request = {true, s.goal_of(p_WT)}; };
}

/// Reported instead of the pose that goes with the goals.
std::function<void(SafetyScript&)> stands_at(double insertion) {
  return [insertion](SafetyScript& s) {
    PsmJoints q = s.robot.joints();
    q[2] = insertion;
    s.robot.place(q);
    s.robot.report(s.now_ns, s.robot_s);
  };
}

/// Joints of the robot when the fault began.
PsmJoints stands_still_at(SafetyScript& s) {
  if (!s.held_joints) s.held_joints = s.robot.joints();
  return *s.held_joints;
}

std::vector<Row> rows() {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  using State = OperatingState::State;
  std::vector<Row> rows = {
      {StopReason::kOperatorStop, 1, [](SafetyScript& s) { s.events.stop_ns = s.now_ns; }},
      {StopReason::kGatewayFault, 1, [](SafetyScript& s) { s.events.fault = true; }},
      {StopReason::kClockBackward, 1, [](SafetyScript& s) { s.now_ns -= 5 * kPeriod; }},
      {StopReason::kTickLate, 1,
       [](SafetyScript& s) {
         s.now_ns += 5 * kPeriod;
         s.robot.report(s.now_ns, s.robot_s);
       }},
      {StopReason::kForeignSource, 1, [](SafetyScript& s) { ++s.robot.state.foreign; }},
      {StopReason::kForeignSource, 1, [](SafetyScript& s) { s.robot.state.source.port = 7; }},
      {StopReason::kTimestampBackward, 1, [](SafetyScript& s) { ++s.robot.state.restarts; }},
      {StopReason::kTimestampBackward, 1,
       [](SafetyScript& s) { s.robot.state.setpoint_cp.payload.timestamp_s = 1; }},
      {StopReason::kStale, 3, [](SafetyScript& s) { s.reports = false; }},
      {StopReason::kStale, 1, [](SafetyScript& s) { s.robot.state.gap_s = 0.02; }},
      {StopReason::kStale, 3,
       [](SafetyScript& s) { s.robot.state.measured_js.advanced_ns = 1'300'000'000; }},
      {StopReason::kStale, 3,
       [](SafetyScript& s) { s.robot.state.operating_state.arrival_ns = 1'300'000'000; }},
      {StopReason::kFault, 1,
       [](SafetyScript& s) { s.robot.state.operating_state.payload.state = State::kFault; }},
      {StopReason::kNotEnabled, 1,
       [](SafetyScript& s) { s.robot.state.operating_state.payload.state = State::kPaused; }},
      {StopReason::kNotEnabled, 1,
       [](SafetyScript& s) { s.robot.state.operating_state.payload.state = State::kUnknown; }},
      {StopReason::kNotHomed, 1,
       [](SafetyScript& s) { s.robot.state.operating_state.payload.is_homed = false; }},
      {StopReason::kBusy, 1,
       [](SafetyScript& s) { s.robot.state.operating_state.payload.is_busy = true; }},
      {StopReason::kInvalid, 1, [](SafetyScript& s) { invalidate(s.robot.state); }},
      {StopReason::kInvalid, 1,
       [](SafetyScript& s) { s.robot.state.operating_state.payload.valid = false; }},
      {StopReason::kInvalid, 1,
       [nan](SafetyScript& s) { s.robot.state.setpoint_cp.payload.translation.y() = nan; }},
      {StopReason::kJointCount, 1,
       [](SafetyScript& s) { s.robot.state.measured_js.payload.count = 7; }},
      {StopReason::kJointCount, 1,
       [](SafetyScript& s) { s.robot.state.jaw_measured_js.payload.count = 0; }},
      {StopReason::kNotOrthonormal, 1,
       [](SafetyScript& s) { s.robot.state.setpoint_cp.payload.rotation *= 1.00001; }},
      {StopReason::kNotOrthonormal, 1,
       [nan](SafetyScript& s) { s.robot.state.measured_cp.payload.rotation(1, 1) = nan; }},
      {StopReason::kWrongInstrument, 1,
       [](SafetyScript& s) { s.robot.state.local_measured_cp.payload.translation.z() -= 0.05; }},
      {StopReason::kBaseFrame, 1,
       [](SafetyScript& s) { s.robot.state.measured_cp.payload.translation.z() -= 0.0001; }},
      {StopReason::kInCannula, 1, stands_at(0.05)},
      {StopReason::kSetpointApart, 3,
       [](SafetyScript& s) {
         s.robot.state.setpoint_cp.payload.translation.y() -= 0.0007;
         s.robot.state.setpoint_cp.payload.timestamp_s += 1e-3;
       }},
      {StopReason::kTracking, 6,
       [](SafetyScript& s) {
         for (auto* pose : {&s.robot.state.measured_cp.payload}) pose->timestamp_s += 1e-3;
         s.robot.state.measured_cp.payload.translation.y() -= 0.006;
       }},
      {StopReason::kEffort, 6,
       [](SafetyScript& s) { s.robot.state.measured_js.payload.effort[2] = -8.0; }},
      {StopReason::kEffort, 6,
       [](SafetyScript& s) { s.robot.state.measured_js.payload.effort[5] = 0.17; }},
      {StopReason::kPolicyLate, 2, [](SafetyScript& s) { s.request = {}; }},
      {StopReason::kNotFinite, 1, asks([nan](RobotCommand& c) { c.translation.x() = nan; })},
      {StopReason::kNotFinite, 1, asks([nan](RobotCommand& c) { c.rotation(0, 2) = nan; })},
      {StopReason::kNotFinite, 1, asks([nan](RobotCommand& c) { c.jaw = nan; })},
      {StopReason::kRotation, 1, asks([](RobotCommand& c) { c.rotation *= 1 + 1e-8; })},
      {StopReason::kRotation, 1, asks([](RobotCommand& c) { c.rotation.col(0) *= -1; })},
      {StopReason::kFeedForward, 1, asks([](RobotCommand& c) { c.velocity.x() = 1e-6; })},
      {StopReason::kFeedForward, 1, asks([](RobotCommand& c) { c.angular_velocity.z() = 1e-6; })},
      {StopReason::kOutsideBox, 1, asks_for_tip(Vector3d(-0.0216, 0.058, 0.1195))},
      {StopReason::kJointLimit, 1, asks_for_tip(Vector3d(-0.0914, 0.11, 0.002))},
      {StopReason::kStep, 1,
       [](SafetyScript& s) {
         s.tip.y() += 0.00051;
         s.request.command = s.goal_of(s.tip);
       }},
      {StopReason::kJointStep, 1,
       [](SafetyScript& s) {
         const Eigen::AngleAxisd roll(0.08, Vector3d::UnitZ());
         s.request.command.rotation = s.request.command.rotation * roll;
       }},
      {StopReason::kTooFast, 8,
       [](SafetyScript& s) {
         s.now_ns -= kPeriod * 3 / 4;
         s.robot_s += 1e-4;
         s.robot.report(s.now_ns, s.robot_s);
       }},
  };
  rows.push_back({StopReason::kJump, 1, [](SafetyScript& s) {
                    s.robot.state.setpoint_cp.payload.translation.y() -= 0.0011;
                    s.robot.state.setpoint_cp.payload.timestamp_s += 1e-3;
                  }});
  // A robot that no longer takes what it is told: the goal runs away from it.
  rows.push_back({StopReason::kCommandsLost, 5, [](SafetyScript& s) {
                    s.robot.place(stands_still_at(s));
                    s.robot.report(s.now_ns, s.robot_s);
                  }});
  // The same where the goals stay near it.
  rows.push_back({StopReason::kCommandsLost, 12, [](SafetyScript& s) {
                    s.robot.place(stands_still_at(s));
                    s.robot.report(s.now_ns, s.robot_s);
                    s.tip = s.tip - 0.8 * s.increment;
                    s.request.command = s.goal_of(s.tip);
                  }});
  rows.push_back({StopReason::kDeadManReleased, 7, [](SafetyScript&) {}, dead_man_limits()});
  return rows;
}

TEST(SafetyStops, EachFiresOnceSendsHoldThreeTimesAndLatches) {
  for (const Row& row : rows()) {
    SCOPED_TRACE(stop_reason_name(row.reason));
    SafetyScript script(row.limits);
    if (row.limits.dead_man()) script.fault = [](SafetyScript& s) { s.events.held_ns = s.now_ns; };
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
    if (row.limits.dead_man()) script.fault = [](SafetyScript& s) { s.events.held_ns = s.now_ns; };
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
    SafetyScript script({}, mount);
    script.go();
    script.fault = asks_for_tip(mount.tip(p_WC));
    EXPECT_EQ(script.stops_within(1), reason);
  }
}

// ---------------------------------------------------------------------------------------------
// Memory

TEST(SafetyMemoryUse, JudgingAllocatesNothing) {
  for (const Row& row : rows()) {
    SafetyScript script(row.limits);
    if (row.limits.dead_man()) script.fault = [](SafetyScript& s) { s.events.held_ns = s.now_ns; };
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
