#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <functional>
#include <optional>

#include "dvrk_gateway/safety/safety.h"
#include "tests/dvrk_gateway/ideal_robot.h"

namespace omentum::test {

inline constexpr std::int64_t kPeriod = 20'000'000;
inline const Eigen::Vector3d kStart(-0.0216, 0.058, 0.1076);  // p_WT

inline bool is_goal(const Judgement& judged) {
  return judged.send && judged.command.kind != RobotCommand::Kind::kHold;
}

/// The loop of the gateway in simulated time: an ideal robot, a policy that moves the tip in W, an
/// operator. `fault` may change what judge() is about to be given.
class SafetyScript {
 public:
  explicit SafetyScript(const pb::SafetyLimits& limits = {}, const ToolMount& mount = paper_mount(),
                        const Eigen::Isometry3d& X_AR = Eigen::Isometry3d::Identity())
      : setup(make_safety_setup(limits, mount, X_AR, true)),
        robot(*mount.instrument, X_AR, joints_for_tip(mount, kStart).value()),
        tip(kStart) {}

  SafetySetup setup;
  IdealRobot robot;
  SafetyMemory memory;
  GatewayEvents events;
  PolicyRequest request;
  std::int64_t now_ns = 1'000'000'000;
  double robot_s = 100;
  Eigen::Vector3d tip;                                        ///< goal of the policy, p_WT
  Eigen::Vector3d increment = Eigen::Vector3d(0.0003, 0, 0);  ///< of each action
  bool acts = true, reports = true;
  std::function<void(SafetyScript&)> fault;
  std::optional<PsmJoints> held_joints;  ///< for a fault to remember

  RobotCommand goal_of(const Eigen::Vector3d& p_WT) const {
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

inline pb::SafetyLimits dead_man_limits() {
  pb::SafetyLimits limits;
  limits.set_dead_man(true);
  return limits;
}

/// Changes the command that the policy asks for.
inline std::function<void(SafetyScript&)> asks(const std::function<void(RobotCommand&)>& change) {
  return [change](SafetyScript& s) { change(s.request.command); };
}

}  // namespace omentum::test
