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

/// So near that the step to it is no jump, nor a turn of more than two steps.
bool ArmGuide::is_near_setpoint(const Goal& goal) const {
  const Goal at = setpoint();
  const Vector3d way = control_point_of(setup_.mount, goal.R_WC, goal.p_WT) -
                       control_point_of(setup_.mount, at.R_WC, at.p_WT);
  const double turn = AngleAxisd(at.R_WC.transpose() * goal.R_WC).angle();
  constexpr double kRounding = 5e-10;  // half of what the safety function allows
  return way.cwiseAbs().maxCoeff() <= setup_.limits.jump_m() + kRounding &&
         std::abs(turn) <= 2.01 * options_.turn_step_rad;
}

/// A command that got lost leaves the robot where it is: the next goal waits for it.
Result<void> ArmGuide::lead_to(const Goal& goal) {
  // Of a set-point that stays away the safety function says why.
  constexpr int kMostRepeats = 25;
  for (int k = 0; k < kMostRepeats && !is_near_setpoint(goal); ++k) {
    if (Result<void> went = request({.fresh = true, .command = command_of(goal_)}); !went)
      return went;
  }
  goal_ = goal;
  return request({.fresh = true, .command = command_of(goal_)});
}

Result<void> ArmGuide::follow(const Vector3d& p_WT, double jaw_rad) {
  jaw_rad_ = jaw_rad;
  return lead_to({setup_.mount.R_WC, p_WT});
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

ArmGuide::Goal ArmGuide::setpoint() const {
  return in_world(port_.period().robot.setpoint_cp.payload);
}

Result<void> ArmGuide::wait_until_armed(const Vector3d& p_WT) {
  Goal looked_from;
  PolicyRequest request;
  while (port_.period().judgement.memory.phase != SafetyPhase::kActive) {
    const Goal at = setpoint();
    const bool moved = !request.looked || (at.p_WT - looked_from.p_WT).norm() > 1e-5 ||
                       (at.R_WC - looked_from.R_WC).cwiseAbs().maxCoeff() > 1e-4;
    if (port_.period().robot.setpoint_cp.payload.valid && moved) {
      Way way;
      request.looked = true;
      request.obstacle = find_way(at, p_WT, way);
      looked_from = at;
    }
    const Period& period = port_.exchange(request);
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
    const Vector3d next = share < 1 ? Vector3d(goal_.p_WT + share * way) : p_WT;
    if (Result<void> went = lead_to({goal_.R_WC, next}); !went) return went;
  }
  return {};
}

Result<void> ArmGuide::turn_to(const Matrix3d& R_WC) {
  const Matrix3d from = goal_.R_WC;
  const AngleAxisd way(from.transpose() * R_WC);
  const int steps = static_cast<int>(std::ceil(std::abs(way.angle()) / options_.turn_step_rad));
  for (int k = 1; k <= steps; ++k) {
    // The last one exactly: products of rotations are off by a rounding.
    const Matrix3d next =
        k == steps ? R_WC : Matrix3d(from * AngleAxisd(way.angle() * k / steps, way.axis()));
    if (Result<void> went = lead_to({next, goal_.p_WT}); !went) return went;
  }
  return {};
}

bool ArmGuide::is_open(const Goal& from, const Goal& to, PsmJoints& joints) const {
  constexpr double kStride_m = 0.002;  // of four steps
  const AngleAxisd turn(from.R_WC.transpose() * to.R_WC);
  const Vector3d way = to.p_WT - from.p_WT;
  const double line = way.cwiseAbs().maxCoeff();
  const int count = static_cast<int>(
      std::ceil(std::max(line / kStride_m, turn.angle() / options_.turn_step_rad)));
  const double steps = line > 0 ? kStride_m / setup_.limits.step_m() : 1;
  for (int k = 1; k <= count; ++k) {
    const double share = static_cast<double>(k) / count;
    const Matrix3d R_WC(from.R_WC * AngleAxisd(share * turn.angle(), turn.axis()));
    PsmJoints next{};
    if (check_goal_pose(setup_, R_WC, from.p_WT + share * way, joints[3], next)) return false;
    for (std::size_t j = 0; j < next.size(); ++j) {
      if (std::abs(next[j] - joints[j]) > steps * setup_.joint_steps[j]) return false;
    }
    joints = next;
  }
  return true;
}

/// The joint of the tool that the mount's orientation, here, wants most elsewhere.
Finding ArmGuide::obstacle_at(const Goal& from, const PsmJoints& joints) const {
  PsmJoints wanted{};
  // A roll that is at its limit is turned back, not on.
  (void)check_goal_pose(setup_, setup_.mount.R_WC, from.p_WT, 0, wanted);
  std::size_t farthest = 3;
  for (std::size_t j = 3; j < wanted.size(); ++j) {
    wanted[j] = std::clamp(wanted[j], setup_.joint_min[j], setup_.joint_max[j]);
    if (std::abs(wanted[j] - joints[j]) > std::abs(wanted[farthest] - joints[farthest]))
      farthest = j;
  }
  return {StopReason::kNoWay, joints[farthest], wanted[farthest], static_cast<int>(farthest)};
}

Finding ArmGuide::find_way(const Goal& from, const Vector3d& p_WT, Way& way) const {
  PsmJoints at{};
  const double roll = port_.period().robot.measured_js.payload.position[3];
  // The safety function says where the set-point itself is in the way.
  if (check_goal_pose(setup_, from.R_WC, from.p_WT, roll, at)) return {};
  const Matrix3d& R_WC = setup_.mount.R_WC;
  PsmJoints there{};
  if (const Finding beyond = check_goal_pose(setup_, R_WC, p_WT, 0, there)) return beyond;
  const double least = std::max(p_WT.z(), from.p_WT.z());
  const double most = std::min(least + options_.clearance_m, setup_.mount.workspace_max.z());
  // Far from the base the wrist reaches its limit a little above a start (docs/task.md 3).
  constexpr double kLower_m = 0.001;
  for (double z = std::max(least, most); true; z = std::max(least, z - kLower_m)) {
    const Vector3d above(from.p_WT.x(), from.p_WT.y(), z);
    const Vector3d across(p_WT.x(), p_WT.y(), z);
    const Goal end{R_WC, p_WT};
    for (const Way& tried : {Way{{from.R_WC, above}, {R_WC, above}, {R_WC, across}, end},
                             Way{{R_WC, from.p_WT}, {R_WC, above}, {R_WC, across}, end},
                             Way{{from.R_WC, above}, {from.R_WC, across}, {R_WC, across}, end}}) {
      PsmJoints joints = at;
      const Goal* last = &from;
      bool open = true;
      for (const Goal& next : tried) {
        open = open && is_open(*last, next, joints);
        last = &next;
      }
      if (!open) continue;
      way = tried;
      return {};
    }
    if (z <= least) break;
  }
  return obstacle_at(from, at);
}

Result<void> ArmGuide::go_to(const Vector3d& p_WT) {
  if (const Result<void> armed = wait_until_armed(p_WT); !armed) return armed;
  // Behind a hold the set-point is where the arm stays; else the last goal is in force.
  if (port_.period().judgement.memory.holding) goal_ = setpoint();
  jaw_rad_ = port_.period().judgement.memory.jaw;
  Way way;
  // An arm that stayed armed behind an episode is stopped for it.
  if (const Finding obstacle = find_way(goal_, p_WT, way))
    return request({.looked = true, .obstacle = obstacle});
  Result<void> went = turn_jaw(false);
  for (const Goal& next : way) {
    if (went) went = line_to(next.p_WT);
    if (went) went = turn_to(next.R_WC);
  }
  return went;
}

}  // namespace omentum
