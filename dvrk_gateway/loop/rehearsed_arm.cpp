#include "dvrk_gateway/loop/rehearsed_arm.h"

#include <algorithm>

namespace omentum {

void RehearsedArm::begin(const RobotState& robot) noexcept {
  const JointState& joints = robot.setpoint_js.payload;
  std::copy_n(joints.position.begin(), q_.size(), q_.begin());
  const JointState& jaw = robot.jaw_setpoint_js.payload;
  jaw_ = jaw.valid && jaw.count == 1 ? jaw.position[0] : robot.jaw_measured_js.payload.position[0];
}

void RehearsedArm::obey(const RobotCommand& command) noexcept {
  if (command.kind == RobotCommand::Kind::kHold) return;
  jaw_ = command.jaw;
  if (command.kind == RobotCommand::Kind::kServoJp) {
    q_ = command.joints;
    return;
  }
  const Eigen::Isometry3d X_RA = setup_.X_AR.inverse();
  const InverseSolution solution =
      psm_solve({X_RA.linear() * command.rotation, X_RA * command.translation}, q_[3],
                *setup_.mount.instrument);
  if (solution.fault == InverseFault::kNone) q_ = solution.q;
}

void RehearsedArm::show(RobotState& robot) const noexcept {
  for (JointState* joints : {&robot.measured_js.payload, &robot.setpoint_js.payload}) {
    std::copy(q_.begin(), q_.end(), joints->position.begin());
    joints->velocity = {};
    joints->effort = {};
  }
  robot.jaw_measured_js.payload.position[0] = jaw_;
  robot.jaw_setpoint_js.payload.position[0] = jaw_;
  const PsmPose pose = psm_forward(q_, *setup_.mount.instrument);
  robot.local_measured_cp.payload.rotation = pose.R;
  robot.local_measured_cp.payload.translation = pose.p;
  for (CartesianPose* shown : {&robot.measured_cp.payload, &robot.setpoint_cp.payload}) {
    shown->rotation = setup_.X_AR.linear() * pose.R;
    shown->translation = setup_.X_AR * pose.p;
  }
}

}  // namespace omentum
