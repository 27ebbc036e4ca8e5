#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

#include "dvrk_gateway/dvrk_double/robot_arm.h"
#include "dvrk_gateway/protocol/link.h"

namespace omentum {

/// Streams in the order in which they leave, alphabetical.
inline constexpr std::array<std::string_view, 8> kStreamNames = {
    "jaw/measured_js", "jaw/setpoint_js", "local/measured_cp", "measured_cp",
    "measured_js",     "operating_state", "setpoint_cp",       "setpoint_js"};

/// Errors of the robot that a client has to cope with; all off by default.
struct DoubleOptions {
  enum class Shape { kToday, kAllInOne, k2019 };

  double home_at_s = -1;        ///< the operator powers and homes then; negative: not by itself
  bool hardware_like = false;   ///< as RobotArm has it
  Shape shape = Shape::kToday;  ///< of the stream's datagrams (docs/dvrk.md 4)
  /// Base frame of the console: measured_cp, setpoint_cp and Cartesian goals are in A, local ones
  /// in R.
  Eigen::Isometry3d X_AR = Eigen::Isometry3d::Identity();
  std::string missing_stream;     ///< one of kStreamNames is not sent
  std::string invalid_stream;     ///< one of kStreamNames has Valid false
  std::string not_finite_stream;  ///< numbers of one of kStreamNames are null
};

/// A UDP robot: the streamer's periods of 10 ms around an arm. A pure object: time is given to it,
/// datagrams go through a Link, so that tests need neither clock nor socket (docs/dvrk.md 5). Not
/// thread-safe.
class DvrkDouble {
 public:
  static constexpr std::int64_t kPeriod_ns = 10'000'000;

  /// `destination`: where the stream goes until somebody else sends. Throws Error for a stream that
  /// does not exist and for effects that cannot be had.
  DvrkDouble(const DoubleOptions& options, const pb::ArmEffects& effects, const ToolMount& mount,
             const UdpAddress& destination);

  /// One period of the streamer at `now_ns` since the robot's start, not less than at the last
  /// call: the arm's ticks until then, then events and streams are sent, then all that waits is
  /// received.
  void period(std::int64_t now_ns, Link& link);

  /// What the operator does goes through it; valid as long as this.
  RobotArm& arm() { return arm_; }
  const RobotArm& arm() const { return arm_; }

  /// A silent robot sends nothing and counts nothing as sent; it receives all the same.
  void set_silent(bool silent) { silent_ = silent; }
  /// As if somebody at this address had sent: the stream goes there from now on.
  void steal(const UdpAddress& thief) { destination_ = thief; }
  /// Timestamps begin anew at zero, as those of another process.
  void restart_timestamps() { timestamp_origin_s_ = arm_.time_s(); }
  /// Where the stream goes: to whoever sent last.
  const UdpAddress& destination() const { return destination_; }
  /// May be changed between two periods; names of streams are not checked again.
  DoubleOptions& options() { return options_; }

  // Counts of datagrams since the construction.
  std::uint64_t sent() const { return sent_; }
  std::uint64_t not_sent() const { return not_sent_; }  ///< refused or failed on the link
  std::uint64_t received() const { return received_; }
  std::uint64_t cut() const { return cut_; }  ///< received with more than 1024 bytes

 private:
  template <typename Payload>
  void send_stream(std::string_view name, Payload payload, Link& link);
  CartesianPose in_A(CartesianPose pose_R) const;
  void send_all(Link& link);
  void send(std::string_view datagram, Link& link);
  void receive_all(Link& link);
  void fill_in(CommandDatagram& commands);

  /// The newest value of each field that a command may leave out, by command: whoever said it.
  struct KeptFields {
    JointGoal jaw_move_jp, jaw_servo_jp, move_jp, servo_jp;
    CartesianGoal move_cp, servo_cp;
  };

  DoubleOptions options_;
  KeptFields kept_fields_;
  bool has_base_frame_;  ///< X_AR is not the identity
  RobotArm arm_;
  UdpAddress destination_;
  std::int64_t ticks_ = 0;
  double timestamp_origin_s_ = 0;
  bool silent_ = false;
  bool homing_asked_ = false;
  std::string burst_;  ///< of shape kAllInOne
  std::uint64_t sent_ = 0, not_sent_ = 0, received_ = 0, cut_ = 0;
};

}  // namespace omentum
