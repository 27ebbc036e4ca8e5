#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "dvrk_gateway/protocol/robot_state.h"

namespace omentum {

/// The client's side of the protocol (docs/dvrk.md 4): states in, commands out. Nothing here
/// allocates, throws or keeps memory; any thread.

/// What one datagram of a robot says, older shapes (docs/dvrk.md 4.6) under today's names.
struct RobotDatagram {
  std::optional<JointState> measured_js, setpoint_js, jaw_measured_js, jaw_setpoint_js;
  std::optional<CartesianPose> measured_cp, setpoint_cp, local_measured_cp;
  std::optional<OperatingState> operating_state;
  std::array<char, kMaxFrameName + 1> reference_frame{};  ///< of measured_cp
  int known_keys = 0;
  int unknown_keys = 0;
  int not_finite = 0;  ///< payloads with a number that is null, infinite or absent: made invalid
  int old_keys = 0;    ///< of known_keys, those of older robots
};

/// Total over any bytes: a datagram, or nothing where the text as a whole is not JSON of the
/// protocol. Numbers of the result are finite; a payload that had another one has `valid` false,
/// and one without a Timestamp a negative one.
std::optional<RobotDatagram> decode_robot(std::string_view text) noexcept;

/// Takes one datagram into the state of the robot and counts what becomes of it. Payloads older
/// than the one held are dropped; those of another address than the first are not looked at.
/// `arrival_ns` is of any clock of the caller's that never goes back.
void take_datagram(RobotState& state, std::string_view text, std::int64_t arrival_ns,
                   const UdpAddress& source) noexcept;

/// The receiver's memory ends at 1024 bytes, and of what is cut the first part is still executed
/// (docs/dvrk.md 4.3).
inline constexpr std::size_t kMaxCommandBytes = 1000;

/// Writes a command as one datagram; its size, or 0 for a command that must not be sent: a number
/// that is not finite, or more than `memory` or kMaxCommandBytes.
std::size_t encode_command(const RobotCommand& command, std::span<char> memory) noexcept;

}  // namespace omentum
