// What the robot tells of itself: docs/dvrk.md 5.2.
#include <utility>

#include "dvrk_gateway/dvrk_double/robot_arm.h"

namespace omentum {
namespace {

using State = OperatingState::State;

/// Damping of the servo: yaw, pitch [N m s], insertion [N s/m], discs (docs/mismatch.md 2.2).
constexpr std::array<double, 3> kDamping = {6, 5, 200};
constexpr double kDiscDamping = 0.09;

}  // namespace

bool RobotArm::effects_active() const {
  return engaged() && (chain_.active() || effects_.transport_delay_s() > 0);
}

JointState RobotArm::measured_js() const {
  JointState joints;
  if (stage_ == Stage::kStart) return joints;
  joints.count = engaged() ? 6 : 7;  // three joints and four discs while homing
  joints.velocity_count = joints.effort_count = joints.count;
  for (std::size_t j = 0; j < 6; ++j) {
    joints.position[j] = measured_[j];
    joints.velocity[j] = velocity_[j];
    if (effects_active()) joints.effort[j] = effort_[j];
  }
  joints.valid = true;
  joints.timestamp_s = time_s();
  return joints;
}

JointState RobotArm::setpoint_js() const {
  JointState joints = measured_js();
  if (joints.count == 0) return joints;
  joints.automatic_timestamp = true;
  const bool off = state_.state == State::kFault || state_.state == State::kDisabled;
  Eigen::Vector4d wrist;
  for (int j = 0; j < 3; ++j) wrist[j] = velocity_[3 + static_cast<std::size_t>(j)];
  wrist[3] = velocity_[6];
  const Eigen::Matrix4d from_discs = mount_.instrument->disc_coupling().inverse();
  const Eigen::Vector4d damping = from_discs.transpose() * (kDiscDamping * (from_discs * wrist));
  for (std::size_t j = 0; j < 6; ++j) {
    joints.position[j] = setpoint_[j];
    joints.velocity[j] = move_.active ? setpoint_velocity_[j] : off ? 0 : feed_forward_[j];
    // Output of the servo: of an ideal arm the damping alone (docs/mismatch.md 2.2).
    const double d = j < 3 ? kDamping[j] * velocity_[j] : damping[static_cast<int>(j) - 3];
    if (!effects_active()) joints.effort[j] = off || d == 0 ? 0 : -d;
  }
  return joints;
}

JointState RobotArm::jaw_measured_js() const {
  JointState jaw;
  if (!engaged()) return jaw;
  jaw.count = jaw.velocity_count = jaw.effort_count = 1;
  jaw.position[0] = measured_[6];
  jaw.velocity[0] = velocity_[6];
  jaw.valid = true;
  jaw.timestamp_s = time_s();
  return jaw;
}

JointState RobotArm::jaw_setpoint_js() const {
  JointState jaw = jaw_measured_js();
  jaw.position[0] = engaged() ? setpoint_[6] : 0;
  jaw.velocity_count = 0;
  jaw.velocity[0] = 0;
  return jaw;
}

CartesianPose RobotArm::pose_of(const Joints& q) const {
  CartesianPose pose;
  if (!engaged()) return pose;
  const PsmPose forward = psm_forward(psm_joints(q), *mount_.instrument);
  pose.rotation = forward.R;
  pose.translation = forward.p;
  pose.valid = true;
  pose.timestamp_s = time_s();
  return pose;
}

Eigen::Vector3d RobotArm::true_tip() const {
  if (!effects_active())
    return chain_.true_tip(psm_joints(measured_), psm_joints(measured_), load_W_);
  return chain_.true_tip(tip_joints_, psm_joints(setpoint_), load_W_);
}

std::vector<OperatingState> RobotArm::take_events() { return std::exchange(events_, {}); }

}  // namespace omentum
