#include "dvrk_gateway/backend/arm_guide.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace omentum {

using Eigen::AngleAxisd;
using Eigen::Matrix3d;
using Eigen::Vector3d;

ArmGuide::ArmGuide(ControlPort& port, const SafetySetup& setup, const ArmGuideOptions& options,
                   std::function<void(const Period&)> waits)
    : port_(port),
      setup_(setup),
      options_(options),
      waits_(std::move(waits)),
      X_WA_(setup.mount.X_WR * setup.X_AR.inverse()) {}

ArmGuide::Goal ArmGuide::in_world(const CartesianPose& pose) const {
  // The jaw points along R_WC as the mount says of its own orientation.
  const Matrix3d R_WC = X_WA_.linear() * pose.rotation;
  const Vector3d p_WC = X_WA_ * pose.translation;
  const Vector3d p_CT =
      setup_.mount.R_WC.transpose() * (setup_.mount.tip_offset * setup_.mount.jaw_direction());
  return {R_WC, p_WC + R_WC * p_CT};
}

RobotCommand ArmGuide::command_of(const Goal& goal) const {
  const Vector3d p_CT =
      setup_.mount.R_WC.transpose() * (setup_.mount.tip_offset * setup_.mount.jaw_direction());
  const Eigen::Isometry3d X_AW = X_WA_.inverse();
  RobotCommand command;
  command.kind = RobotCommand::Kind::kServoCp;
  command.rotation = X_AW.linear() * goal.R_WC;
  command.translation = X_AW * (goal.p_WT - goal.R_WC * p_CT);
  command.jaw = jaw_closed_ ? options_.jaw_closed_rad : options_.jaw_open_rad;
  return command;
}

Vector3d ArmGuide::measured_tip() const {
  return in_world(port_.period().robot.measured_cp.payload).p_WT;
}

Result<void> ArmGuide::request(const PolicyRequest& request) {
  const Period& period = port_.exchange(request);
  if (port_.ended()) return Failure{"the program ends"};
  if (period.judgement.memory.phase == SafetyPhase::kActive) return {};
  return Failure{describe(period.judgement.memory.stop)};
}

Result<void> ArmGuide::hold() {
  PolicyRequest hold;
  hold.fresh = true;
  return request(hold);
}

Result<void> ArmGuide::follow(const Vector3d& p_WT, bool jaw_closed) {
  goal_ = {setup_.mount.R_WC, p_WT};
  jaw_closed_ = jaw_closed;
  return request({.fresh = true, .command = command_of(goal_)});
}

Result<void> ArmGuide::wait_until_armed() {
  while (port_.period().judgement.memory.phase != SafetyPhase::kActive) {
    const Period& period = port_.exchange({});
    if (port_.ended()) return Failure{"the program ends"};
    if (period.judgement.memory.phase != SafetyPhase::kActive && waits_) waits_(period);
  }
  return {};
}

Result<void> ArmGuide::line_to(const Vector3d& p_WT) {
  // A hair under the cap: the robot's frame turns the rounding of its numbers.
  const double step = 0.999 * setup_.limits.step_m();
  while ((p_WT - goal_.p_WT).cwiseAbs().maxCoeff() > 0) {
    const Vector3d way = p_WT - goal_.p_WT;
    const double share = step / std::max(step, way.cwiseAbs().maxCoeff());
    goal_.p_WT = share < 1 ? Vector3d(goal_.p_WT + share * way) : p_WT;
    if (const Result<void> went = request({.fresh = true, .command = command_of(goal_)}); !went)
      return went;
  }
  return {};
}

Result<void> ArmGuide::turn() {
  const Matrix3d from = goal_.R_WC;
  const AngleAxisd way(from.transpose() * setup_.mount.R_WC);
  const int steps = static_cast<int>(std::ceil(std::abs(way.angle()) / options_.turn_step_rad));
  for (int k = 1; k <= steps; ++k) {
    // The last one exactly: products of rotations are off by a rounding.
    goal_.R_WC = k == steps ? setup_.mount.R_WC
                            : Matrix3d(from * AngleAxisd(way.angle() * k / steps, way.axis()));
    if (const Result<void> went = request({.fresh = true, .command = command_of(goal_)}); !went)
      return went;
  }
  return {};
}

Result<void> ArmGuide::go_to(const Vector3d& p_WT) {
  if (const Result<void> armed = wait_until_armed(); !armed) return armed;
  goal_ = in_world(port_.period().robot.setpoint_cp.payload);
  jaw_closed_ = false;
  const double top = std::min(std::max(p_WT.z(), goal_.p_WT.z()) + options_.clearance_m,
                              setup_.mount.workspace_max.z());
  const Vector3d above(goal_.p_WT.x(), goal_.p_WT.y(), std::max(top, goal_.p_WT.z()));
  for (const auto& leg :
       {std::function<Result<void>()>([&] { return line_to(above); }),
        std::function<Result<void>()>([&] { return turn(); }), std::function<Result<void>()>([&] {
          return line_to({p_WT.x(), p_WT.y(), above.z()});
        }),
        std::function<Result<void>()>([&] { return line_to(p_WT); })}) {
    if (const Result<void> went = leg(); !went) return went;
  }
  return {};
}

}  // namespace omentum
