#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string_view>

#include "dvrk_gateway/protocol/codec.h"
#include "dvrk_gateway/protocol/robot_codec.h"

// Any bytes are a datagram of the robot, whose numbers are finite and which reads the same after
// it was written again, or nothing; and commands, or nothing. Taken as numbers they are a command
// of ours, which is refused or fits into a datagram that the robot reads as it was meant.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace)

void require(bool condition) {
  if (!condition) __builtin_trap();
}

bool all_finite(const JointState& joints) {
  for (std::size_t j = 0; j < kMaxJoints; ++j) {
    if (!std::isfinite(joints.position[j]) || !std::isfinite(joints.velocity[j]) ||
        !std::isfinite(joints.effort[j]))
      return false;
  }
  return true;
}
bool all_finite(const CartesianPose& pose) {
  return pose.rotation.allFinite() && pose.translation.allFinite();
}
bool all_finite(const OperatingState& state) { return state.sub_state[kMaxSubState] == 0; }

template <typename Payload>
void check_stream(const char* name, const std::optional<Payload>& said,
                  std::optional<Payload> RobotDatagram::*member) {
  if (!said) return;
  require(std::isfinite(said->timestamp_s) && all_finite(*said));
  std::array<char, 1200> memory{};
  const std::size_t written = encode_stream(name, *said, memory);
  require(written > 0);
  const auto again = decode_robot({memory.data(), written});
  require(again && (*again).*member && *((*again).*member) == *said);
}

RobotCommand command_of(const std::uint8_t* data, std::size_t size) {
  std::array<double, 32> numbers{};
  std::memcpy(numbers.data(), data, std::min(size, sizeof numbers));
  RobotCommand command;
  const double kind = numbers[31];
  command.kind = kind < 0   ? RobotCommand::Kind::kServoJp
                 : kind > 0 ? RobotCommand::Kind::kHold
                            : RobotCommand::Kind::kServoCp;
  command.rotation = Eigen::Map<const Eigen::Matrix3d>(numbers.data());
  command.translation = Eigen::Map<const Eigen::Vector3d>(numbers.data() + 9);
  std::copy_n(numbers.begin() + 12, 6, command.joints.begin());
  command.jaw = numbers[18];
  command.velocity = Eigen::Map<const Eigen::Vector3d>(numbers.data() + 19);
  command.angular_velocity = Eigen::Map<const Eigen::Vector3d>(numbers.data() + 22);
  std::copy_n(numbers.begin() + 24, 6, command.joint_velocity.begin());
  return command;
}

void check_command(const RobotCommand& command) {
  std::array<char, 2000> memory{};
  const std::size_t written = encode_command(command, memory);
  require(written <= kMaxCommandBytes);
  if (written == 0) return;
  const CommandDatagram read = decode_commands({memory.data(), written});
  require(read.whole && read.finite && read.unknown_keys == 0);
  if (command.kind == RobotCommand::Kind::kHold) return require(read.hold && read.known_keys == 1);
  require(read.known_keys == 2 && read.jaw_servo_jp && read.jaw_servo_jp->goal[0] == command.jaw);
  if (command.kind == RobotCommand::Kind::kServoCp) {
    require(read.servo_cp && read.servo_cp->rotation == command.rotation &&
            read.servo_cp->translation == command.translation);
  } else {
    require(read.servo_jp &&
            std::equal(command.joints.begin(), command.joints.end(), read.servo_jp->goal.begin()));
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  check_command(command_of(data, size));
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  if (auto said = decode_robot(text)) {
    // A word that is not known is written as UNDEFINED.
    if (said->operating_state && said->operating_state->state == OperatingState::State::kUnknown)
      said->operating_state->state = OperatingState::State::kUndefined;
    check_stream("measured_js", said->measured_js, &RobotDatagram::measured_js);
    check_stream("setpoint_js", said->setpoint_js, &RobotDatagram::setpoint_js);
    check_stream("jaw/measured_js", said->jaw_measured_js, &RobotDatagram::jaw_measured_js);
    check_stream("jaw/setpoint_js", said->jaw_setpoint_js, &RobotDatagram::jaw_setpoint_js);
    check_stream("measured_cp", said->measured_cp, &RobotDatagram::measured_cp);
    check_stream("setpoint_cp", said->setpoint_cp, &RobotDatagram::setpoint_cp);
    check_stream("local/measured_cp", said->local_measured_cp, &RobotDatagram::local_measured_cp);
    check_stream("operating_state", said->operating_state, &RobotDatagram::operating_state);
  }
  RobotState state;
  take_datagram(state, text, 1, UdpAddress{1, 1});
  require(state.datagrams + state.malformed <= 1);

  const CommandDatagram commands = decode_commands(text);
  require(commands.known_keys >= 0 && commands.unknown_keys >= 0);
  for (const auto* joints :
       {&commands.jaw_move_jp, &commands.jaw_servo_jp, &commands.move_jp, &commands.servo_jp}) {
    if (!*joints) continue;
    require((*joints)->goal_count <= kMaxJoints && (*joints)->velocity_count <= kMaxJoints);
    for (const double value : (*joints)->goal) require(std::isfinite(value));
  }
  for (const auto* pose : {&commands.move_cp, &commands.servo_cp}) {
    if (*pose) require((*pose)->rotation.allFinite() && (*pose)->translation.allFinite());
  }
  return 0;
}
