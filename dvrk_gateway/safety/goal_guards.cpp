#include <algorithm>
#include <cmath>

#include "dvrk_gateway/safety/guards.h"
#include "dvrk_gateway/safety/tool_point.h"

namespace omentum::safety {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Rounding of goals that were added up from steps: far below what a robot resolves.
constexpr double kRounding = 1e-9;

Vector3d tip_in_W(const SafetySetup& setup, const PsmPose& pose_RC) {
  return setup.mount.X_WR * tip_of(setup.mount, pose_RC.R, pose_RC.p);
}

bool is_finite(const RobotCommand& command) {
  const auto finite = [](double v) { return std::isfinite(v); };
  return command.rotation.allFinite() && command.translation.allFinite() &&
         std::all_of(command.joints.begin(), command.joints.end(), finite) && finite(command.jaw) &&
         command.velocity.allFinite() && command.angular_velocity.allFinite() &&
         std::all_of(command.joint_velocity.begin(), command.joint_velocity.end(), finite);
}

/// Goals follow each other in steps, from rest to rest: a velocity beside them, which the robot
/// keeps until another is stated, would run ahead of each.
Finding check_feed_forward(const RobotCommand& command) {
  for (int k = 0; k < 3; ++k) {
    if (command.velocity[k] != 0) return {StopReason::kFeedForward, command.velocity[k], 0, k};
    if (command.angular_velocity[k] != 0)
      return {StopReason::kFeedForward, command.angular_velocity[k], 0, k};
  }
  for (int k = 0; k < 6; ++k) {
    const double velocity = command.joint_velocity[static_cast<std::size_t>(k)];
    if (velocity != 0) return {StopReason::kFeedForward, velocity, 0, k};
  }
  return {};
}

}  // namespace

PsmPose pose_in_R(const SafetySetup& setup, const Matrix3d& rotation,
                  const Vector3d& translation) noexcept {
  const Matrix3d R_RA = setup.X_AR.linear().transpose();
  return {R_RA * rotation, R_RA * (translation - setup.X_AR.translation())};
}

Finding check_place(const SafetySetup& setup, const Goal& goal) noexcept {
  const Vector3d p_WT = tip_in_W(setup, goal.pose_RC);
  for (int k = 0; k < 3; ++k) {
    const double least = setup.mount.workspace_min[k];
    const double most = setup.mount.workspace_max[k];
    if (!(p_WT[k] >= least - kRounding && p_WT[k] <= most + kRounding))
      return {StopReason::kOutsideBox, p_WT[k], p_WT[k] < least ? least : most, k};
  }
  // The rule of the robot before our own limits: it says what to do.
  const double distance = psm_wrist_distance(goal.joints[2], *setup.mount.instrument);
  if (!(distance >= kPsmCannula)) return {StopReason::kCannula, distance, kPsmCannula, -1};
  for (int k = 0; k < 6; ++k) {
    const auto joint = static_cast<std::size_t>(k);
    const double q = goal.joints[joint];
    if (!(q >= setup.joint_min[joint] && q <= setup.joint_max[joint])) {
      return {StopReason::kJointLimit, q,
              q < setup.joint_min[joint] ? setup.joint_min[joint] : setup.joint_max[joint], k};
    }
  }
  return {};
}

Finding read_goal(const SafetySetup& setup, const SafetyMemory& memory, const RobotCommand& command,
                  Goal& goal) noexcept {
  if (!is_finite(command)) return {StopReason::kNotFinite, 0, 0, -1};
  if (const Finding found = check_feed_forward(command)) return found;
  if (command.kind == RobotCommand::Kind::kServoJp) {
    goal.joints = command.joints;
    goal.pose_RC = psm_forward(goal.joints, *setup.mount.instrument);
    return {};
  }
  constexpr double kOrthonormal = 1e-9;  // what the robot is promised (docs/dvrk.md 4)
  const Matrix3d& R = command.rotation;
  const double off = std::max((R.transpose() * R - Matrix3d::Identity()).cwiseAbs().maxCoeff(),
                              std::abs(R.determinant() - 1));
  if (!(off <= kOrthonormal)) return {StopReason::kRotation, off, kOrthonormal, -1};
  goal.pose_RC = pose_in_R(setup, R, command.translation);
  const InverseSolution solution =
      psm_solve(goal.pose_RC, memory.goal_joints[3], *setup.mount.instrument);
  if (solution.fault != InverseFault::kNone) {
    return {StopReason::kUnreachable, goal.pose_RC.p.norm(), 1e-3, -1};
  }
  goal.joints = solution.q;
  return {};
}

Finding check_steps(const SafetySetup& setup, const SafetyMemory& memory,
                    const Goal& goal) noexcept {
  const Vector3d moved_C = setup.mount.X_WR.linear() * (goal.pose_RC.p - memory.goal_RC.p);
  const Vector3d moved_T = tip_in_W(setup, goal.pose_RC) - tip_in_W(setup, memory.goal_RC);
  const double most = setup.limits.step_m();
  for (int k = 0; k < 3; ++k) {
    const double moved = std::max(std::abs(moved_C[k]), std::abs(moved_T[k]));
    if (!(moved <= most + kRounding)) return {StopReason::kStep, moved, most, k};
  }
  for (int k = 0; k < 6; ++k) {
    const auto joint = static_cast<std::size_t>(k);
    const double step = std::abs(goal.joints[joint] - memory.goal_joints[joint]);
    if (!(step <= setup.joint_steps[joint] + kRounding))
      return {StopReason::kJointStep, step, setup.joint_steps[joint], k};
  }
  return {};
}

Finding check_jump(const SafetySetup& setup, const SafetyMemory& memory,
                   const RobotState& robot) noexcept {
  const CartesianPose& setpoint = robot.setpoint_cp.payload;
  const Vector3d p_RC = pose_in_R(setup, setpoint.rotation, setpoint.translation).p;
  const Vector3d apart = setup.mount.X_WR.linear() * (memory.goal_RC.p - p_RC);
  const double most = setup.limits.jump_m();
  for (int k = 0; k < 3; ++k) {
    if (std::abs(apart[k]) <= most + kRounding) continue;
    // A set-point at one of our goals did not jump: those behind it have not arrived.
    if (memory.unanswered > 1)
      return {StopReason::kCommandsLost, static_cast<double>(memory.unanswered), 0, -1};
    return {StopReason::kJump, apart[k], most, k};
  }
  return {};
}

}  // namespace omentum::safety

namespace omentum {

Finding check_goal_pose(const SafetySetup& setup, const Eigen::Matrix3d& R_WC,
                        const Eigen::Vector3d& p_WT, double roll_near, PsmJoints& joints) noexcept {
  const Eigen::Isometry3d X_RW = setup.mount.X_WR.inverse();
  safety::Goal goal;
  goal.pose_RC = {X_RW.linear() * R_WC, X_RW * control_point_of(setup.mount, R_WC, p_WT)};
  const InverseSolution solution = psm_solve(goal.pose_RC, roll_near, *setup.mount.instrument);
  joints = goal.joints = solution.q;
  if (solution.fault != InverseFault::kNone)
    return {StopReason::kUnreachable, goal.pose_RC.p.norm(), 1e-3, -1};
  return safety::check_place(setup, goal);
}

}  // namespace omentum
