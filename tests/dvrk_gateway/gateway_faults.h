#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "tests/dvrk_gateway/two_sides.h"

namespace omentum::test {

enum class Fault : int {
  // The robot and what it says.
  kSilence,
  kTheft,
  kThiefMoves,
  kRestart,
  kRobotFault,
  kDisabled,
  kPaused,
  kUnhomed,
  kMissing,
  kInvalid,
  kNotFinite,
  kTimestamps,
  kMove,
  kConsoleServo,
  kCannula,
  kLoad,
  kDeaf,
  kLeftVelocity,
  kNoWay,
  kForeign,
  kGarbage,
  kOtherInstrument,
  kOtherBase,
  kSkewed,
  kJointCount,
  kEffort,
  kLag,
  kSetpointJumps,
  kSetpointDrifts,
  kStreamStamp,
  // The gateway's machine and its operator.
  kClockBack,
  kTickLate,
  kTickBurst,
  kOperatorStops,
  kKeyReleased,
  kGatewayFault,
  kArmAtRandom,
  // The policy.
  kPolicyStalls,
  kPolicyNotFinite,
  kPolicyLeaps,
  kPolicyTurns,
  kPolicyRolls,
  kPolicyScales,
  kPolicyVelocity,
  kPolicyToCentre,
  kPolicyFar,
  kPolicyOutside,
  kPolicyHolds,
  // From the first moment.
  kNotRegistered,
  kOldShapes,
  kStartsInCannula,
  kCount
};
inline constexpr int kFaults = static_cast<int>(Fault::kCount);

struct Event {
  Fault fault = Fault::kCount;
  int from = 0, until = 0;
  double size = 0;  ///< in [0, 1)
  std::size_t part = 0;
};

/// The gateway's clock, which may go back; the robot's does not.
class GatewayClock final : public Clock {
 public:
  explicit GatewayClock(TwoSides& sides) : sides_(sides) {}
  std::int64_t now_ns() noexcept override { return sides_.now_ns() + offset_ns; }
  void sleep_until(std::int64_t time_ns) noexcept override {
    sides_.sleep_until(time_ns - offset_ns);
  }
  std::int64_t offset_ns = 7'000'000'000;

 private:
  TwoSides& sides_;
};

/// What went out, read from the datagram; nothing for one that no robot would take whole.
inline std::optional<RobotCommand> command_of(const std::string& text) {
  const CommandDatagram said = decode_commands(text);
  if (!said.whole || !said.finite || said.unknown_keys > 0 || text.size() > kMaxCommandBytes)
    return {};
  RobotCommand command;
  if (said.hold) return said.known_keys == 1 ? std::optional(command) : std::nullopt;
  if (said.known_keys != 2 || !said.jaw_servo_jp || said.jaw_servo_jp->goal_count != 1) return {};
  command.jaw = said.jaw_servo_jp->goal[0];
  if (said.servo_cp && said.servo_cp->has_rotation && said.servo_cp->has_translation) {
    command.kind = RobotCommand::Kind::kServoCp;
    command.rotation = said.servo_cp->rotation;
    command.translation = said.servo_cp->translation;
    if (!said.servo_cp->has_velocity || !said.servo_cp->has_angular_velocity) return {};
    command.velocity = said.servo_cp->velocity;
    command.angular_velocity = said.servo_cp->angular_velocity;
    return command;
  }
  if (!said.servo_jp || said.servo_jp->goal_count != 6 || said.servo_jp->velocity_count != 6)
    return {};
  command.kind = RobotCommand::Kind::kServoJp;
  std::copy_n(said.servo_jp->goal.begin(), 6, command.joints.begin());
  std::copy_n(said.servo_jp->velocity.begin(), 6, command.joint_velocity.begin());
  return command;
}

/// Changes of one stream on its way, by a JSON library that the gateway does not have.
inline std::function<void(std::string&)> tampering(const Event& event) {
  if (event.fault < Fault::kOtherInstrument || event.fault > Fault::kStreamStamp) return nullptr;
  return [event, drift = 0.0](std::string& text) mutable {
    nlohmann::json datagram = nlohmann::json::parse(text);
    const std::string name = datagram.begin().key();
    nlohmann::json& payload = datagram.begin().value();
    const std::array<const char*, 3> poses = {"measured_cp", "setpoint_cp", "local/measured_cp"};
    const auto shift = [&](const char* stream, double by) {
      if (name != stream) return;
      nlohmann::json& at = payload["Position"]["Translation"][event.part % 3];
      at = at.get<double>() + by;
    };
    switch (event.fault) {
      case Fault::kOtherInstrument:
        shift("local/measured_cp", 0.05 * event.size + 1e-4);
        break;
      case Fault::kOtherBase:
        shift("measured_cp", 0.02 * event.size + 1e-4);
        break;
      case Fault::kLag:
        if (name == "measured_cp") payload["Timestamp"] = payload["Timestamp"].get<double>() + 1e-4;
        shift("measured_cp", 0.006 + 0.01 * event.size);
        break;
      case Fault::kSetpointJumps:
        shift("setpoint_cp", 0.004 + 0.01 * event.size);
        break;
      case Fault::kSetpointDrifts:
        if (name == "setpoint_cp") drift += 0.0002 * event.size;
        shift("setpoint_cp", drift);
        break;
      case Fault::kSkewed:
        if (name == poses[event.part % 3]) {
          nlohmann::json& number = payload["Position"]["Rotation"][0][event.part % 3];
          number = number.get<double>() + 2e-3;
        }
        break;
      case Fault::kJointCount:
        if (name == (event.part % 2 == 0 ? "measured_js" : "jaw/measured_js"))
          payload["Position"] = payload["Velocity"] = payload["Effort"] = {0.0, 0.0};
        break;
      case Fault::kEffort:
        if (name == "measured_js") payload["Effort"] = std::vector<double>(6, 20);
        break;
      case Fault::kStreamStamp:
        if (name == poses[event.part % 3])
          payload["Timestamp"] = payload["Timestamp"].get<double>() - 0.5 - event.size;
        break;
      default:
        break;
    }
    text = datagram.dump() + "\n";
  };
}

}  // namespace omentum::test
