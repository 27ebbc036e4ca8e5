#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "dvrk_gateway/backend/arm_guide.h"
#include "tests/dvrk_gateway/ideal_robot.h"
#include "tests/dvrk_gateway/two_sides.h"

namespace omentum::test {

inline const Eigen::Vector3d kStartTip(-0.02, 0.055, 0.09);  // p_WT

/// A gateway whose arm is armed and follows goals.
struct Session {
  explicit Session(const Disturbance& network = {},
                   const Eigen::Isometry3d& X_AR = Eigen::Isometry3d::Identity(),
                   std::uint64_t seed = 1, bool dry_run = false)
      : setup(make_safety_setup({}, paper_mount(), X_AR, true)),
        sides(robot_options(X_AR), {}, setup.mount, network, seed) {
    sides.bring_to(joints_for_tip(setup.mount, kStartTip).value());
    loop = std::make_unique<ControlLoop>(sides.gateway_link, sides, setup, 0, dry_run);
    port = std::make_unique<SteppedPort>(*loop, sides, events);
    guide = std::make_unique<ArmGuide>(*port, setup, ArmGuideOptions{}, [this](const Period& now) {
      if (now.judgement.memory.phase == SafetyPhase::kReady) events.arm_ns = sides.now_ns();
      if (sides.now_ns() > patience_ns) throw_error("{}", describe(now.judgement.finding));
    });
  }
  static DoubleOptions robot_options(const Eigen::Isometry3d& X_AR) {
    DoubleOptions options;
    options.X_AR = X_AR;
    return options;
  }

  /// A circle of 10 mm radius in half a minute at most; why it ended before, where it did.
  Result<void> follow_circle(int steps, const std::function<void()>& each = {}) {
    for (int k = 0; k < steps; ++k) {
      const double angle = 0.04 * ++step;
      const Eigen::Vector3d aside(0.01 * (1 - std::cos(angle)), 0.01 * std::sin(angle), 0);
      if (const Result<void> went = guide->follow(kStartTip + aside); !went) return went;
      if (each) each();
    }
    return {};
  }
  /// True tip of the robot [m].
  Eigen::Vector3d tip() const { return setup.mount.X_WR * local_tip(); }
  Eigen::Vector3d local_tip() const {
    const JointState q = sides.robot().arm().measured_js();
    PsmJoints joints{};
    std::copy_n(q.position.begin(), 6, joints.begin());
    const PsmPose pose = psm_forward(joints);
    return pose.p + setup.mount.tip_offset * pose.R.col(2);
  }
  std::vector<std::int64_t> hold_times() const {
    std::vector<std::int64_t> times;
    for (const auto& datagram : sides.gateway_link.sent) {
      if (datagram.text.find("hold") != std::string::npos) times.push_back(datagram.time_ns);
    }
    return times;
  }

  int step = 0;                                  ///< of the circle
  std::int64_t patience_ns = 30 * TwoSides::kS;  ///< Error of who is not armed by then
  SafetySetup setup;
  mutable TwoSides sides;
  GatewayEvents events;
  std::unique_ptr<ControlLoop> loop;
  std::unique_ptr<SteppedPort> port;
  std::unique_ptr<ArmGuide> guide;
};

}  // namespace omentum::test
