#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

/// What a da Vinci Research Kit tells over UDP and what it can be told, in CRTK words (docs/dvrk.md
/// 4). Plain values, no allocation; units m, rad, N, N m, s. Poses are those of the control point C
/// in the arm's reference frame; the `local` one is always in R.
namespace omentum {

/// Six joints, seven entries while the robot homes (three joints, four discs); more are refused.
inline constexpr int kMaxJoints = 8;
/// Longest sub-state the robot has is CALIBRATING_ENCODERS_FROM_POTS.
inline constexpr int kMaxSubState = 63;
inline constexpr int kMaxFrameName = 63;  ///< PSM1_base

/// A payload with `valid` false may hold anything. So has a payload with a number that is not
/// finite been marked, and that number is 0 here.
struct JointState {
  int count = 0;           ///< entries of position; 0 before homing
  int velocity_count = 0;  ///< `count` or 0: the set-point of the jaw never has one
  int effort_count = 0;    ///< `count` or 0
  std::array<double, kMaxJoints> position{};  ///< yaw, pitch [rad], insertion [m], roll ... [rad]
  std::array<double, kMaxJoints> velocity{};  ///< per second
  std::array<double, kMaxJoints> effort{};    ///< N m, insertion N
  bool valid = false;
  double timestamp_s = 0;            ///< since the robot process started
  bool automatic_timestamp = false;  ///< stamped when sent, not when measured

  bool operator==(const JointState&) const = default;
};

struct CartesianPose {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  ///< [m]
  bool valid = false;
  double timestamp_s = 0;  ///< since the robot process started

  bool operator==(const CartesianPose&) const = default;
};

struct OperatingState {
  /// kUnknown is a word this program does not know.
  enum class State { kUndefined, kDisabled, kEnabled, kPaused, kFault, kUnknown };
  State state = State::kUndefined;
  std::array<char, kMaxSubState + 1> sub_state{};  ///< ends with 0; cut when longer
  bool is_homed = false;
  bool is_busy = false;
  bool valid = false;
  double timestamp_s = 0;  ///< of the last change, so no measure of age

  bool operator==(const OperatingState&) const = default;
};

/// CRTK's word for a state, as on the wire; UNKNOWN for kUnknown.
const char* operating_state_word(OperatingState::State state);

/// The newest payload of one stream.
template <typename Payload>
struct Stream {
  Payload payload{};
  bool seen = false;            ///< ever
  std::int64_t arrival_ns = 0;  ///< of the newest payload, clock of the caller
  std::int64_t advanced_ns =
      0;  ///< when payload.timestamp_s last grew: what staleness is judged by
};

struct UdpAddress {
  std::uint32_t ipv4 = 0;  ///< host byte order
  std::uint16_t port = 0;

  bool operator==(const UdpAddress&) const = default;
};

/// What has been received so far; each count only grows.
struct RobotState {
  Stream<JointState> measured_js, setpoint_js, jaw_measured_js, jaw_setpoint_js;
  Stream<CartesianPose> measured_cp, setpoint_cp, local_measured_cp;
  Stream<OperatingState> operating_state;

  /// Name of the frame of measured_cp, as PSM1_base; ends with 0, empty where none was told.
  std::array<char, kMaxFrameName + 1> reference_frame{};

  bool has_source = false;
  UdpAddress source;          ///< of the first datagram that was understood; others are not taken
  UdpAddress foreign_source;  ///< of the newest datagram from elsewhere, if foreign > 0
  std::int64_t source_ns = 0, foreign_ns = 0;  ///< when the newest of each arrived
  bool old_shapes_only = false;  ///< everything so far came from GetState*: show, never arm

  double newest_s = 0;  ///< Timestamp of the robot, of whatever stream
  /// Widest step of newest_s since the caller set this to 0. One datagram of many that get lost
  /// leaves no gap: a stream that went elsewhere does.
  double gap_s = 0;

  std::uint64_t datagrams = 0;  ///< from `source`, whole and understood
  std::uint64_t malformed = 0;  ///< not JSON of the protocol, from anybody: nothing of it is taken
  std::uint64_t foreign = 0;    ///< from another address
  std::uint64_t unknown_keys = 0;
  std::uint64_t not_finite = 0;  ///< payloads marked invalid for null, infinite or absent numbers
  std::uint64_t reordered = 0;   ///< payloads dropped, older than the one held by up to 0.1 s
  std::uint64_t restarts = 0;    ///< Timestamp fell by more than 0.1 s: another robot process
};

/// The robot fell silent and another port of its machine speaks: its process was started anew, or a
/// stranger sits on that machine, which only the operator can tell.
inline bool moved_to_another_port(const RobotState& robot) {
  constexpr std::int64_t kSilent_ns = 500'000'000;
  return robot.has_source && robot.foreign_source.ipv4 == robot.source.ipv4 &&
         robot.foreign_source.port != robot.source.port &&
         robot.foreign_ns - robot.source_ns >= kSilent_ns;
}

/// One command. Goals are absolute, so a command that is lost, repeated or run twice does no harm.
struct RobotCommand {
  enum class Kind { kHold, kServoCp, kServoJp };
  Kind kind = Kind::kHold;
  /// kServoCp: goal of C in the reference frame, orthonormal to 1e-9.
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  ///< [m]
  std::array<double, 6> joints{};                         ///< kServoJp [rad, insertion m]
  double jaw = 0;                                         ///< both servo kinds [rad]
  /// Feed-forward, stated in every goal: the robot keeps what a goal leaves out, whoever said it.
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();          ///< kServoCp [m/s]
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  ///< kServoCp [rad/s]
  std::array<double, 6> joint_velocity{};                      ///< kServoJp [rad/s, m/s]
};

}  // namespace omentum
