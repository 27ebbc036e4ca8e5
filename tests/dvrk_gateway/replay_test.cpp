// Motions made into goals, and the jaw that says whether it holds something.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "dvrk_gateway/backend/motion_replay.h"
#include "dvrk_gateway/loop/jaw_watch.h"
#include "tests/dvrk_gateway/ideal_robot.h"

namespace omentum {
namespace {

constexpr double kPeriod_s = 0.02, kStep_m = 0.0005;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

/// A straight line at 10 mm/s, sampled unevenly.
std::vector<MotionSample> line() {
  std::vector<MotionSample> motion;
  for (const double t_s : {5.0, 5.013, 5.1, 5.104, 5.31, 5.5})
    motion.push_back({t_s, {0.01 * (t_s - 5), 0.02, 0.05}, 0.5 - 0.2 * (t_s - 5)});
  return motion;
}

TEST(GoalsOf, UnevenSamplesOfALineBecomeEvenGoalsOnIt) {
  const auto goals = goals_of(line(), kPeriod_s, 1, kStep_m);
  ASSERT_TRUE(goals) << goals.error();
  ASSERT_EQ(goals.value().size(), 26U);
  for (std::size_t k = 0; k < 26; ++k) {
    const MotionSample& goal = goals.value()[k];
    EXPECT_NEAR(goal.p_WT.x(), 0.0002 * static_cast<double>(k), 1e-12);
    EXPECT_NEAR(goal.jaw_rad, 0.5 - 0.004 * static_cast<double>(k), 1e-12);
  }
}

TEST(GoalsOf, TwiceAsSlowHasTwiceTheGoalsAndTheSameEnds) {
  const auto goals = goals_of(line(), kPeriod_s, 2, kStep_m);
  ASSERT_TRUE(goals) << goals.error();
  EXPECT_EQ(goals.value().size(), 51U);
  EXPECT_EQ(goals.value().front().p_WT, line().front().p_WT);
  EXPECT_NEAR((goals.value().back().p_WT - line().back().p_WT).norm(), 0, 1e-12);
}

TEST(GoalsOf, AFastMotionIsRefusedWithItsMomentAndTheFactorThatWillDo) {
  std::vector<MotionSample> motion = line();
  for (MotionSample& sample : motion) sample.p_WT.x() *= 6;  // 60 mm/s: 1.2 mm a period
  motion[0].p_WT.x() = 0;
  const auto refused = goals_of(motion, kPeriod_s, 1, kStep_m);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().find("1.200 mm"), std::string::npos) << refused.error();
  EXPECT_NE(refused.error().find("--slow 2.4"), std::string::npos) << refused.error();
  EXPECT_TRUE(goals_of(motion, kPeriod_s, 2.5, kStep_m));
}

TEST(GoalsOf, AJawThatWasNotRecordedStaysUnknown) {
  std::vector<MotionSample> motion = line();
  for (MotionSample& sample : motion) sample.jaw_rad = kNone;
  const auto goals = goals_of(motion, kPeriod_s, 1, kStep_m);
  ASSERT_TRUE(goals) << goals.error();
  for (const MotionSample& goal : goals.value()) EXPECT_TRUE(std::isnan(goal.jaw_rad));
}

TEST(CheckGoals, WhatWillLeaveTheBoxOrALimitIsRefusedWithItsMomentBeforeAnythingMoves) {
  const SafetySetup setup =
      make_safety_setup({}, test::paper_mount(), Eigen::Isometry3d::Identity(), true);
  const auto checked = [&](const Eigen::Vector3d& from, const Eigen::Vector3d& step) {
    std::vector<MotionSample> goals;
    for (int k = 0; k < 100; ++k) goals.push_back({0.02 * k, from + k * step, 0.5});
    const Result<void> can = check_goals(setup, goals);
    return can ? std::string("fine") : can.error();
  };
  EXPECT_EQ(checked({-0.02, 0.05, 0.09}, {0.0003, 0, 0}), "fine");
  const std::string up = checked({-0.02, 0.05, 0.11}, {0, 0, 0.0003});
  EXPECT_NE(up.find("the motion at 0.620 s: tip at z_W"), std::string::npos) << up;
  const std::string far = checked({-0.07, 0.10, 0.01}, {-0.0002, 0.0001, 0});
  EXPECT_NE(far.find("joint"), std::string::npos) << far;
}

Period jaw_period(double goal_rad, double measured_rad) {
  Period period;
  period.judgement.memory.jaw = goal_rad;
  period.robot.jaw_measured_js.payload.valid = true;
  period.robot.jaw_measured_js.payload.count = 1;
  period.robot.jaw_measured_js.payload.position[0] = measured_rad;
  return period;
}

TEST(JawWatch, AJawThatStopsShortOfItsGoalHoldsAndOneThatArrivesDoesNot) {
  for (const double stop : {0.22, -0.2}) {
    JawWatch watch(0.05, 0.1);
    for (int k = 0; k < 15; ++k) watch.on_period(jaw_period(0.4, 0.4));
    for (double goal = 0.4; goal > -0.2; goal -= 0.04)
      watch.on_period(jaw_period(goal, std::max(goal + 0.04, stop)));
    EXPECT_FALSE(watch.held_ever()) << "while it moves nothing is known";
    for (int k = 0; k < 12; ++k) watch.on_period(jaw_period(-0.2, std::max(-0.2, stop)));
    EXPECT_EQ(watch.holds(), stop > 0);
    EXPECT_EQ(watch.held_ever(), stop > 0);
  }
}

TEST(JawWatch, AJawThatStandsAtTheRobotsOwnSetPointHoldsNothing) {
  // Software that stops the jaw above its goal tells so in its set-point.
  for (const double measured : {-0.08, 0.15}) {
    JawWatch watch(0.05, 0.1);
    for (int k = 0; k < 12; ++k) {
      Period period = jaw_period(-0.3, measured);
      period.robot.jaw_setpoint_js.payload.valid = true;
      period.robot.jaw_setpoint_js.payload.count = 1;
      period.robot.jaw_setpoint_js.payload.position[0] = -0.08;
      watch.on_period(period);
    }
    EXPECT_EQ(watch.held_ever(), measured > 0) << measured;
  }
}

TEST(JawWatch, TissueThatSlipsOutWasHeldAndIsNoLonger) {
  JawWatch watch(0.05, 0.1);
  for (int k = 0; k < 12; ++k) watch.on_period(jaw_period(-0.2, 0.22));
  EXPECT_TRUE(watch.holds());
  for (int k = 0; k < 12; ++k) watch.on_period(jaw_period(-0.2, -0.2));
  EXPECT_FALSE(watch.holds());
  EXPECT_TRUE(watch.held_ever());
  watch.forget();
  EXPECT_FALSE(watch.held_ever());
}

}  // namespace
}  // namespace omentum
