// What the robot answers, one test per row of docs/dvrk.md 5.2.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/dvrk_gateway/double_session.h"

namespace omentum {
namespace {

using test::cartesian;
using test::DoubleSession;
using test::jaw_servo_jp;
using test::servo_jp;
using State = OperatingState::State;

const std::vector<double> kPose = {0.1, 0.1, 0.15, 0.1, 0.1, 0.1};
const std::vector<double> kStraight = {0, 0, 0.12, 0, 0, 0};

struct DoubleRows : testing::Test {
  DoubleRows() { session.home(); }
  void say_and_wait(const std::string& text) {
    session.say(text);
    session.run_for(0.02);
  }
  /// A longer way than the servo's tolerance allows in one step.
  void go_to(const Eigen::Vector3d& p) {
    session.say(cartesian("move_cp", p));
    session.run_for(2);
  }
  DoubleSession session;
};

TEST_F(DoubleRows, Row1StepOfJointsIsTakenInOneTickAndSeenIn20Ms) {
  session.say(servo_jp(kPose));
  session.run_for(0.01);
  EXPECT_EQ(session.joints(), kStraight);
  session.run_for(0.01);
  EXPECT_EQ(session.joints(), kPose);
  EXPECT_EQ(session.state.measured_js.payload.position[0], 0.1);
}

TEST_F(DoubleRows, Row2CartesianGoalIsMetExactlyAndTheJawBesideIt) {
  const Eigen::Vector3d p(0.005, -0.004, -0.12);
  say_and_wait(cartesian("servo_cp", p));
  EXPECT_LT((session.state.setpoint_cp.payload.translation - p).norm(), 1e-12);
  const Eigen::Vector3d next(0.005, -0.003, -0.12);
  std::string both = cartesian("servo_cp", next);
  both.back() = ',';
  both += R"("jaw/servo_jp":{"Goal":[0.5]}})";
  say_and_wait(both);
  EXPECT_LT((session.state.setpoint_cp.payload.translation - next).norm(), 1e-12);
  EXPECT_EQ(session.jaw(), 0.5);
}

TEST_F(DoubleRows, Row3JointGoalsAreClippedInSilence) {
  std::vector<double> goal = kStraight;
  for (int k = 1; k <= 25; ++k) {
    goal[0] = 0.1 * k;
    say_and_wait(servo_jp(goal));
    EXPECT_EQ(session.joints()[0], std::min(goal[0], 1.588));
  }
  for (int k = 25; k >= 0; --k) {
    goal[0] = 0.1 * k;
    say_and_wait(servo_jp(goal));
    EXPECT_EQ(session.joints()[0], std::min(goal[0], 1.588));
  }
  EXPECT_EQ(session.operating().state, State::kEnabled);
}

TEST_F(DoubleRows, Row4WhatIsNoCommandIsIgnoredWithoutAnAnswer) {
  const std::size_t before = session.link.sent.size();
  say_and_wait(R"({"servo_cp":{"Goal":{"Translation":[0,0,-0.1]}}})");
  say_and_wait(R"({"servo_cp":{}})");
  say_and_wait("not json");
  say_and_wait(R"({"unknown_cmd":{"Goal":[1]}})");
  EXPECT_EQ(session.joints(), kStraight);
  EXPECT_EQ(session.link.sent.size() - before, 8 * 8u);
  EXPECT_EQ(session.refusals(Refusal::kGoal), 2u);
  EXPECT_EQ(session.refusals(Refusal::kNotJson), 1u);
  EXPECT_EQ(session.refusals(Refusal::kUnknownKey), 1u);
}

TEST_F(DoubleRows, Row5HoldAtRestShowsNothingAndGoesToJointControl) {
  say_and_wait(cartesian("servo_cp", {0, 0, -0.12}));
  const std::vector<double> before = session.joints();
  say_and_wait(R"({"hold":""})");
  EXPECT_EQ(session.joints(), before);
  for (int k = 1; k <= 10; ++k) say_and_wait(jaw_servo_jp(0.25 * k));
  EXPECT_EQ(session.jaw(), 1.396);  // joint control clips
}

TEST_F(DoubleRows, Row6TooFewJointsLoseTheCommand) {
  say_and_wait(servo_jp({0.1, 0.1, 0.15}));
  EXPECT_EQ(session.joints(), kStraight);
  EXPECT_EQ(session.refusals(Refusal::kGoal), 1u);
}

TEST_F(DoubleRows, Row6MoreJointsThanSixAreIgnored) {
  say_and_wait(servo_jp({0.1, 0.1, 0.15, 0.1, 0.1, 0.1, 9}));
  EXPECT_EQ(session.joints(), kPose);
}

TEST_F(DoubleRows, Row7MoveOfJointsIsBusyAndTakesTheJawToZero) {
  say_and_wait(servo_jp({0.188, 0.1, 0.15, 0.1, 0.1, 0.1}));
  say_and_wait(jaw_servo_jp(0.5));
  session.say(R"({"move_jp":{"Goal":[0,0,0.12,0,0,0]}})");
  session.run_for(0.01);
  EXPECT_FALSE(session.operating().is_busy);
  session.run_for(0.01);
  EXPECT_TRUE(session.operating().is_busy);
  const double begin_s = session.operating().timestamp_s;
  session.run_for(0.4);
  EXPECT_GT(session.jaw(), 0);
  EXPECT_LT(session.jaw(), 0.5);
  session.run_for(0.5);
  EXPECT_FALSE(session.operating().is_busy);
  // 30 mm of insertion at 0.2 m/s^2 take 2 sqrt(d / a), to a tick.
  EXPECT_NEAR(session.operating().timestamp_s - begin_s, 2 * std::sqrt(0.03 / 0.2), 1.0 / 1500);
  EXPECT_EQ(session.joints(), kStraight);
  EXPECT_EQ(session.jaw(), 0);
}

TEST_F(DoubleRows, Row8MoveOfThePoseIsPlannedInJoints) {
  const Eigen::Vector3d from = session.state.setpoint_cp.payload.translation;
  const Eigen::Vector3d to = from + Eigen::Vector3d(0.03, 0, 0);
  say_and_wait(cartesian("move_cp", to));
  EXPECT_TRUE(session.operating().is_busy);
  double off_the_line = 0;
  for (int k = 0; k < 100; ++k) {
    session.run_for(0.01);
    off_the_line = std::max(
        off_the_line, std::fabs(session.state.setpoint_cp.payload.translation.z() - from.z()));
  }
  EXPECT_FALSE(session.operating().is_busy);
  EXPECT_LT((session.state.setpoint_cp.payload.translation - to).norm(), 1e-9);
  EXPECT_GT(off_the_line, 1e-5);
}

TEST_F(DoubleRows, Row9MoveOutOfReachIsNotRefused) {
  say_and_wait(cartesian("move_cp", {0.5, 0, -0.1}));
  EXPECT_TRUE(session.operating().is_busy);
  session.run_for(3);
  EXPECT_FALSE(session.operating().is_busy);
  EXPECT_EQ(session.joints()[2], 0.24);
  EXPECT_EQ(session.operating().state, State::kEnabled);
}

TEST_F(DoubleRows, Row10ServoGoalEndsAMove) {
  say_and_wait(cartesian("move_cp", {0.03, 0, -0.1135}));
  session.run_for(0.2);
  ASSERT_TRUE(session.operating().is_busy);
  const Eigen::Vector3d here = session.state.setpoint_cp.payload.translation;
  say_and_wait(cartesian("servo_cp", here));
  EXPECT_FALSE(session.operating().is_busy);
  session.run_for(0.5);
  EXPECT_LT((session.state.setpoint_cp.payload.translation - here).norm(), 1e-12);
}

TEST_F(DoubleRows, Row11WristStays45MmFromTheRemoteCentre) {
  go_to({0, 0, -0.06});
  say_and_wait(cartesian("servo_cp", {0, 0, -0.02}));
  EXPECT_NEAR(session.joints()[2], 0.0606, 1e-12);
  EXPECT_NEAR(session.state.setpoint_cp.payload.translation.z(), -0.0541, 1e-9);
}

TEST_F(DoubleRows, Row12JumpBeyondTheToleranceIsAFaultInThatTick) {
  say_and_wait(jaw_servo_jp(0.5));
  session.say(servo_jp({0.6, 0, 0.12, 0, 0, 0}));
  session.run_for(0.02);
  EXPECT_EQ(session.operating().state, State::kFault);
  EXPECT_STREQ(session.operating().sub_state.data(), "FAULT");
  EXPECT_TRUE(session.operating().is_homed);
  EXPECT_EQ(session.setpoint().position, session.state.measured_js.payload.position);
  for (const double effort : session.setpoint().effort) EXPECT_EQ(effort, 0);
}

TEST_F(DoubleRows, Row12ToleranceHoldsPerActuator) {
  const auto faults = [](const std::vector<double>& goal) {
    DoubleSession other;
    other.home();
    other.say(servo_jp(goal));
    other.run_for(0.02);
    return other.operating().state == State::kFault;
  };
  EXPECT_FALSE(faults({0.49, -0.49, 0.12, 0, 0, 0}));
  EXPECT_TRUE(faults({0, -0.51, 0.12, 0, 0, 0}));
  EXPECT_FALSE(faults({0, 0, 0.169, 0, 0, 0}));
  EXPECT_TRUE(faults({0, 0, 0.171, 0, 0, 0}));
  // Of discs: roll turns -1.5632 as far as its disc, wrist pitch 1.0186 of its own.
  EXPECT_FALSE(faults({0, 0, 0.12, 1.5632 * 0.59, 0, 0}));
  EXPECT_TRUE(faults({0, 0, 0.12, 1.5632 * 0.61, 0, 0}));
  // A set-point at the limit of its joint is not judged.
  EXPECT_FALSE(faults({1.588, 0, 0.12, 0, 0, 0}));
}

TEST_F(DoubleRows, Row13InAFaultCommandsAreIgnoredAndStreamsGoOn) {
  session.robot.arm().fault();
  session.run_for(0.01);
  ASSERT_EQ(session.operating().state, State::kFault);
  const std::vector<double> before = session.joints();
  const std::size_t sent = session.link.sent.size();
  say_and_wait(R"({"move_jp":{"Goal":[0,0,0.12,0,0,0]}})");
  say_and_wait(R"({"jaw/move_jp":{"Goal":[0.6]}})");
  say_and_wait(cartesian("servo_cp", {0, 0, -0.1135}, Eigen::Vector3d(1, 1, -1.1).asDiagonal()));
  say_and_wait(jaw_servo_jp(2.5));
  EXPECT_EQ(session.joints(), before);
  EXPECT_EQ(session.jaw(), 0);
  EXPECT_EQ(session.refusals(Refusal::kNotReady), 4u);
  EXPECT_EQ(session.link.sent.size() - sent, 8 * 8u);
}

TEST(DoubleRowsInCannula, Row14CartesianControlBeginsBeyondTheCannulaOnly) {
  DoubleOptions options;
  options.hardware_like = true;
  DoubleSession session(options);
  session.home();
  EXPECT_EQ(session.joints()[2], 0.02);
  for (const char* name : {"servo_cp", "move_cp"}) {
    session.say(cartesian(name, {0, 0, -0.1}));
    session.run_for(0.02);
    EXPECT_EQ(session.joints()[2], 0.02) << name;
  }
  EXPECT_EQ(session.refusals(Refusal::kInCannula), 2u);
  for (int k = 1; k <= 2; ++k) {
    session.say(servo_jp({0, 0, 0.02 + 0.04 * k, 0, 0, 0}));
    session.run_for(0.02);
  }
  session.say(cartesian("servo_cp", {0, 0, -0.1}));
  session.run_for(0.02);
  EXPECT_NEAR(session.state.setpoint_cp.payload.translation.z(), -0.1, 1e-9);
}

TEST_F(DoubleRows, Row15JawIsNotClippedInCartesianControl) {
  say_and_wait(cartesian("servo_cp", {0, 0, -0.1135}));
  for (int k = 1; k <= 10; ++k) say_and_wait(jaw_servo_jp(0.25 * k));
  EXPECT_EQ(session.jaw(), 2.5);
  EXPECT_EQ(session.operating().state, State::kEnabled);
}

TEST_F(DoubleRows, Row16JumpOfTheJawIsAFault) {
  say_and_wait(cartesian("servo_cp", {0, 0, -0.1135}));
  say_and_wait(jaw_servo_jp(0.5));
  ASSERT_EQ(session.operating().state, State::kEnabled);
  say_and_wait(jaw_servo_jp(2.5));
  EXPECT_EQ(session.operating().state, State::kFault);
}

TEST_F(DoubleRows, Row17GoalWithoutJointsKeepsTheSetpoint) {
  const std::vector<double> before = session.joints();
  say_and_wait(cartesian("servo_cp", {0, 0, -0.0005}));
  say_and_wait(cartesian("servo_cp", {0, 0, -0.1}, Eigen::Matrix3d::Zero()));
  EXPECT_EQ(session.joints(), before);
  EXPECT_EQ(session.refusals(Refusal::kNoInverse), 2u);
  EXPECT_EQ(session.operating().state, State::kEnabled);
}

TEST_F(DoubleRows, Row18SilentClientChangesNothing) {
  say_and_wait(servo_jp(kPose));
  session.run_for(30);
  EXPECT_EQ(session.joints(), kPose);
  EXPECT_EQ(session.operating().state, State::kEnabled);
  EXPECT_LT(session.state.measured_js.advanced_ns, session.next_ns);
  EXPECT_EQ(session.state.reordered + session.state.restarts + session.state.malformed, 0u);
}

}  // namespace
}  // namespace omentum
