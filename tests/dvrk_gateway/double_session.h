#pragma once

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "dvrk_gateway/dvrk_double/dvrk_double.h"
#include "dvrk_gateway/protocol/codec.h"
#include "tests/support/script_link.h"

namespace omentum::test {

inline const UdpAddress kClient{0x7f000001, 48051};
inline const UdpAddress kRobot{0x7f000001, 40000};

inline ToolMount plain_mount() {
  return make_tool_mount(Eigen::Isometry3d::Identity(), 0, 0.0102, Eigen::Vector3d::Constant(-1),
                         Eigen::Vector3d::Constant(1));
}

/// A double in simulated time and the client that listens to it.
struct DoubleSession {
  explicit DoubleSession(const DoubleOptions& options = {}, const pb::ArmEffects& effects = {},
                         const ToolMount& mount = plain_mount())
      : robot(options, effects, mount, kClient) {}

  /// Whole periods until that time.
  void run_to(double time_s) {
    for (; static_cast<double>(next_ns) * 1e-9 <= time_s + 1e-9; next_ns += robot.kPeriod_ns) {
      clock.time_ns = next_ns;
      robot.period(next_ns, link);
      for (; heard < link.sent.size(); ++heard)
        take_datagram(state, link.sent[heard].text, link.sent[heard].time_ns, kRobot);
    }
  }
  void run_for(double seconds) { run_to(now_s() + seconds); }
  /// Of the last period.
  double now_s() const { return static_cast<double>(next_ns - robot.kPeriod_ns) * 1e-9; }

  /// Arrives just behind the last period, so the next one reads it and the one after shows it.
  void say(const std::string& text) { link.deliver(next_ns - robot.kPeriod_ns + 1, text, kClient); }
  void say(const RobotCommand& command) {
    std::array<char, 1000> memory{};
    say(std::string(memory.data(), encode_command(command, memory)));
  }

  /// Homed in 1.5 s, as in the recorded session.
  void home() {
    run_for(0.01);
    robot.arm().power();
    robot.arm().home();
    run_for(1.5);
  }

  const JointState& setpoint() const { return state.setpoint_js.payload; }
  double jaw() const { return state.jaw_setpoint_js.payload.position[0]; }
  const OperatingState& operating() const { return state.operating_state.payload; }
  std::uint64_t refusals(Refusal refusal) const { return robot.arm().refusals(refusal); }
  std::vector<double> joints() const {
    return {setpoint().position.begin(), setpoint().position.begin() + setpoint().count};
  }

  ScriptClock clock;
  ScriptLink link{clock};
  DvrkDouble robot;
  RobotState state;
  std::int64_t next_ns = 0;
  std::size_t heard = 0;
};

inline std::string text_of(const std::vector<double>& values) {
  return fmt::format("[{}]", fmt::join(values, ","));
}
inline std::string servo_jp(const std::vector<double>& goal) {
  return fmt::format(R"({{"servo_jp":{{"Goal":{}}}}})", text_of(goal));
}
inline std::string jaw_servo_jp(double goal) {
  return fmt::format(R"({{"jaw/servo_jp":{{"Goal":[{}]}}}})", goal);
}
/// "servo_cp" or "move_cp" with the rotation of q = 0 (docs/dvrk.md 1).
inline std::string cartesian(const std::string& name, const Eigen::Vector3d& p,
                             const Eigen::Matrix3d& R = psm_forward({0, 0, 0.12, 0, 0, 0}).R) {
  const auto row = [&](int k) { return text_of({R(k, 0), R(k, 1), R(k, 2)}); };
  return fmt::format(R"({{"{}":{{"Goal":{{"Rotation":[{},{},{}],"Translation":{}}}}}}})", name,
                     row(0), row(1), row(2), text_of({p.x(), p.y(), p.z()}));
}

}  // namespace omentum::test
