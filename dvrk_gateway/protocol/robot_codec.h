#pragma once

#include <optional>
#include <span>
#include <string_view>

#include "dvrk_gateway/protocol/robot_state.h"

namespace omentum {

/// The robot's side of the protocol (docs/dvrk.md 4), for the double and for tests: states out,
/// commands in. Nothing here allocates, throws or keeps memory; any thread.

/// prmPositionJointSet as received. Fields that were absent have count 0.
struct JointGoal {
  int goal_count = 0;
  int velocity_count = 0;
  std::array<double, kMaxJoints> goal{};      ///< [rad, insertion m]
  std::array<double, kMaxJoints> velocity{};  ///< [rad/s, m/s]
};

/// prmPositionCartesianSet as received, in the reference frame.
struct CartesianGoal {
  bool has_rotation = false, has_translation = false, has_velocity = false;
  bool has_angular_velocity = false;
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();       ///< [m]
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();          ///< [m/s]
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  ///< [rad/s]
};

/// Commands of one datagram, in the order in which the robot runs them.
struct CommandDatagram {
  bool hold = false;
  std::optional<JointGoal> jaw_move_jp, jaw_servo_jp;
  std::optional<CartesianGoal> move_cp;
  std::optional<JointGoal> move_jp;
  std::optional<CartesianGoal> servo_cp;
  std::optional<JointGoal> servo_jp;
  int known_keys = 0;
  int unknown_keys = 0;
  bool whole = false;  ///< all of the text was JSON of the protocol
  bool finite = true;  ///< no number was null or beyond the range of a double
};

/// Total over any bytes. Of a text that is not whole, what stands before the fault is in the
/// result: so the robot has it.
CommandDatagram decode_commands(std::string_view text) noexcept;

/// `name` of a stream as in docs/dvrk.md 4.2. The size, or 0 when the memory is too small. With
/// `line_end` as robots send it.
std::size_t encode_stream(std::string_view name, const JointState& joints, std::span<char> memory);
std::size_t encode_stream(std::string_view name, const CartesianPose& pose, std::span<char> memory);
std::size_t encode_stream(std::string_view name, const OperatingState& state,
                          std::span<char> memory);

/// The shape of 2019 (docs/dvrk.md 4.6): jaw and joints in one datagram, nothing else.
std::size_t encode_old_shape(const JointState& jaw, const JointState& joints,
                             std::span<char> memory);

}  // namespace omentum
