#include "dvrk_gateway/backend/arm_guide.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dvrk_gateway/safety/tool_point.h"

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
  const Matrix3d R_WC = X_WA_.linear() * pose.rotation;
  return {R_WC, tip_of(setup_.mount, R_WC, X_WA_ * pose.translation)};
}

RobotCommand ArmGuide::command_of(const Goal& goal) const {
  const Eigen::Isometry3d X_AW = X_WA_.inverse();
  RobotCommand command;
  command.kind = RobotCommand::Kind::kServoCp;
  command.rotation = X_AW.linear() * goal.R_WC;
  command.translation = X_AW * control_point_of(setup_.mount, goal.R_WC, goal.p_WT);
  command.jaw = jaw_rad_;
  return command;
}

Vector3d ArmGuide::measured_tip() const {
  return in_world(port_.period().robot.measured_cp.payload).p_WT;
}

double ArmGuide::measured_jaw_rad() const {
  return port_.period().robot.jaw_measured_js.payload.position[0];
}

bool ArmGuide::measures() const {
  const RobotState& robot = port_.period().robot;
  return robot.measured_cp.payload.valid && robot.jaw_measured_js.payload.valid;
}

Result<void> ArmGuide::request(const PolicyRequest& request) {
  const Period& period = port_.exchange(request);
  if (port_.ended()) return Failure{"the program ends"};
  if (period.judgement.memory.phase == SafetyPhase::kActive) return {};
  return Failure{describe(period.judgement.memory.stop, period.robot)};
}

Result<void> ArmGuide::hold() {
  PolicyRequest hold;
  hold.fresh = true;
  return request(hold);
}

Result<void> ArmGuide::watch() {
  port_.exchange({});
  if (port_.ended()) return Failure{"the program ends"};
  return {};
}

Result<void> ArmGuide::follow(const Vector3d& p_WT) { return follow(p_WT, jaw_rad_); }

Result<void> ArmGuide::follow(const Vector3d& p_WT, double jaw_rad) {
  goal_ = {setup_.mount.R_WC, p_WT};
  jaw_rad_ = jaw_rad;
  return request({.fresh = true, .command = command_of(goal_)});
}

Result<void> ArmGuide::turn_jaw(bool closed) {
  const double wanted = closed ? options_.jaw_closed_rad : options_.jaw_open_rad;
  if (jaw_rad_ == wanted) return {};
  jaw_rad_ = wanted;
  const double clipped = std::clamp(wanted, setup_.jaw_min, setup_.jaw_max);
  for (int there = 0; there < options_.jaw_settle_periods;) {
    const Result<void> went = request({.fresh = true, .command = command_of(goal_)});
    if (!went) return went;
    if (std::abs(port_.period().judgement.memory.jaw - clipped) < 1e-9) ++there;
  }
  return {};
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

bool ArmGuide::reaches(const Vector3d& p_WT) const {
  const Eigen::Isometry3d X_RW = setup_.mount.X_WR.inverse();
  const InverseSolution solution =
      psm_solve({X_RW.linear() * setup_.mount.R_WC, X_RW * setup_.mount.control_point(p_WT)},
                port_.period().robot.measured_js.payload.position[3], *setup_.mount.instrument);
  bool inside = solution.fault == InverseFault::kNone;
  for (std::size_t k = 0; k < solution.q.size(); ++k) {
    inside &= solution.q[k] >= setup_.joint_min[k] && solution.q[k] <= setup_.joint_max[k];
  }
  return inside;
}

double ArmGuide::crossing_height(const Vector3d& p_WT) const {
  // Far from the base the wrist reaches its limit a little above a start (docs/task.md 3).
  const Vector3d& from = goal_.p_WT;
  const double least = std::max(p_WT.z(), from.z());
  const double most = std::min(least + options_.clearance_m, setup_.mount.workspace_max.z());
  constexpr double kStep_m = 0.001;
  for (double z = most; z > least; z -= kStep_m) {
    if (reaches({p_WT.x(), p_WT.y(), z}) && reaches({from.x(), from.y(), z})) return z;
  }
  return least;
}

Result<void> ArmGuide::go_to(const Vector3d& p_WT) {
  if (const Result<void> armed = wait_until_armed(); !armed) return armed;
  goal_ = in_world(port_.period().robot.setpoint_cp.payload);
  jaw_rad_ = port_.period().judgement.memory.jaw;
  const Vector3d above(goal_.p_WT.x(), goal_.p_WT.y(), crossing_height(p_WT));
  Result<void> went = turn_jaw(false);
  if (went) went = line_to(above);
  if (went) went = turn();
  if (went) went = line_to({p_WT.x(), p_WT.y(), above.z()});
  if (went) went = line_to(p_WT);
  return went;
}

}  // namespace omentum
