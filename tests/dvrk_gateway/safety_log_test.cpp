// The recorded session of a real robot's software (set dvrk_wire) against the safety function.
#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "dvrk_gateway/protocol/codec.h"
#include "dvrk_gateway/safety/safety.h"
#include "tests/support/wire_log.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::WireLine;

constexpr UdpAddress kLoggedRobot{0x7f000001, 40000};

/// A box that holds whatever the session does.
SafetySetup wide_setup() {
  const ToolMount mount = make_tool_mount(Eigen::Isometry3d::Identity(), 0, 0.0102,
                                          Vector3d::Constant(-0.5), Vector3d::Constant(0.5));
  pb::SafetyLimits limits;
  limits.set_joint_margin(0);
  return make_safety_setup(limits, mount, Eigen::Isometry3d::Identity(), true);
}

struct Happened {
  double ready_s = -1, stopped_s = -1;  ///< first times, of the log
  StopReason stop = StopReason::kNone;
  std::map<StopReason, double> obstacles;  ///< first time of each, not armed
  int sent = 0;
};

/// The gateway at 50 Hz over the log, without a policy. `gaps`: left in; else a gap of the excerpt
/// is one period of the robot.
Happened replay(const std::vector<WireLine>& lines, bool gaps, bool arms) {
  const SafetySetup setup = wide_setup();
  SafetyMemory memory;
  RobotState robot;
  GatewayEvents events;
  Happened happened;
  double shift_s = 0, last_s = 0, next_s = 0.02;
  const auto ns = [](double s) { return 1'000'000'000 + std::llround(1e9 * s); };
  for (const WireLine& line : lines) {
    if (line.sent) continue;
    if (!gaps && line.time_s - last_s > 0.02) shift_s += line.time_s - last_s - 0.01;
    for (; next_s < line.time_s - shift_s; next_s += 0.02) {
      const double log_s = gaps ? next_s : last_s;
      if (arms && memory.phase == SafetyPhase::kReady) events.arm_ns = ns(next_s);
      const Judgement judged = judge(setup, memory, robot, {}, events, ns(next_s));
      memory = judged.memory;
      if (memory.phase == SafetyPhase::kReady && happened.ready_s < 0) happened.ready_s = log_s;
      if (judged.stopped_now) {
        happened.stopped_s = log_s;
        happened.stop = judged.finding.reason;
      } else if (judged.finding) {
        happened.obstacles.emplace(judged.finding.reason, log_s);
      }
      happened.sent += judged.send ? 1 : 0;
    }
    last_s = line.time_s;
    take_datagram(robot, line.datagram, ns(line.time_s - shift_s), kLoggedRobot);
  }
  return happened;
}

class SafetyOfTheLog : public testing::Test {
 protected:
  void SetUp() override {
    lines_ = test::read_wire_log();
    if (lines_.empty()) GTEST_SKIP() << "no dvrk_wire in OMENTUM_REAL_DATA";
  }
  std::vector<WireLine> lines_;
};

TEST_F(SafetyOfTheLog, NotReadyBeforeTenGoodPeriodsBehindHoming) {
  const Happened happened = replay(lines_, false, false);
  EXPECT_GE(happened.ready_s, 2.355 + 0.1);  // docs/dvrk.md 4.4: homed, with six joints
  EXPECT_EQ(happened.obstacles.count(StopReason::kNotHomed), 1U);
  EXPECT_EQ(happened.sent, 0);
}

TEST_F(SafetyOfTheLog, TellsTheFaultOfTheRobotInTheNextPeriod) {
  const Happened happened = replay(lines_, false, false);
  ASSERT_EQ(happened.obstacles.count(StopReason::kFault), 1U);
  EXPECT_GE(happened.obstacles.at(StopReason::kFault), 15.687);
  EXPECT_LE(happened.obstacles.at(StopReason::kFault), 15.687 + 0.03);
  // Moves of the session's own client come before.
  EXPECT_LT(happened.obstacles.at(StopReason::kBusy), 15.687);
}

TEST_F(SafetyOfTheLog, ArmedItStopsWhenAnotherClientMovesTheArm) {
  const Happened happened = replay(lines_, false, true);
  EXPECT_EQ(happened.stop, StopReason::kSetpointApart);
  EXPECT_EQ(happened.sent, 3);
}

TEST_F(SafetyOfTheLog, AGapOfTheExcerptIsStale) {
  const Happened happened = replay(lines_, true, false);
  EXPECT_EQ(happened.obstacles.count(StopReason::kStale), 1U);
}

}  // namespace
}  // namespace omentum
