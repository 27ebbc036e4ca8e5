#pragma once

#include <functional>
#include <memory>
#include <string>

#include "dvrk_gateway/dvrk_double/disturbed_link.h"
#include "tests/dvrk_gateway/double_session.h"

namespace omentum::test {

inline const UdpAddress kStranger{0x0a000007, 9};

/// Robot and gateway on one clock, a network between them: while the gateway sleeps the robot's
/// periods pass. What goes to another address than kClient's the gateway does not get.
class TwoSides final : public Clock {
 public:
  static constexpr std::int64_t kMs = 1'000'000, kS = 1000 * kMs;

  TwoSides(const DoubleOptions& options, const pb::ArmEffects& effects, const ToolMount& mount,
           const Disturbance& network = {}, std::uint64_t seed = 1)
      : options_(options),
        effects_(effects),
        mount_(mount),
        network_(robot_link_, time_, network, network, seed) {
    robot_.emplace(options_, effects_, mount_, kClient);
  }

  std::int64_t now_ns() noexcept override { return time_.time_ns; }
  void sleep_until(std::int64_t until_ns) noexcept override {
    for (; next_ns_ <= until_ns; next_ns_ += kMs) {
      time_.time_ns = next_ns_;
      for (; said_ < gateway_link.sent.size(); ++said_) {
        const ScriptLink::Datagram& datagram = gateway_link.sent[said_];
        if (!deaf) robot_link_.deliver(datagram.time_ns, datagram.text, kClient);
      }
      network_.flush();
      if (next_ns_ % DvrkDouble::kPeriod_ns == 0) {
        robot_->period(next_ns_ - started_ns_, network_);
        if (after_period) after_period(*robot_);
      }
      for (; heard_ < robot_link_.sent.size(); ++heard_) carry(robot_link_.sent[heard_]);
    }
    time_.time_ns = std::max(time_.time_ns, until_ns);
  }

  DvrkDouble& robot() { return *robot_; }
  /// To the robot, as if the gateway had sent it.
  void say(const std::string& text) { robot_link_.deliver(time_.time_ns, text, kClient); }
  /// To the gateway.
  void tell_gateway(const std::string& text, const UdpAddress& from) {
    gateway_link.deliver(time_.time_ns, text, from);
  }
  /// The process of the robot ends and another begins, at another port; Timestamps begin at 0.
  void restart() {
    robot_.emplace(options_, effects_, mount_, kClient);
    started_ns_ = next_ns_;
    ++source_.port;
  }

  /// Homed, with these joints: what the operator does at the console.
  void bring_to(const PsmJoints& goal) {
    sleep_until(now_ns() + 10 * kMs);
    robot_->arm().power();
    robot_->arm().home();
    sleep_until(now_ns() + 1600 * kMs);
    console_servo(goal);
  }
  /// A set-point of the console, which is no datagram: in steps below the tolerances of the servo.
  void console_servo(const PsmJoints& goal) {
    constexpr int kSteps = 16;
    const JointState at = robot_->arm().setpoint_js();
    for (int step = 1; step <= kSteps; ++step) {
      CommandDatagram command;
      command.known_keys = 1;
      command.servo_jp = JointGoal{};
      command.servo_jp->goal_count = 6;
      for (std::size_t j = 0; j < 6; ++j) {
        command.servo_jp->goal[j] = at.position[j] + (goal[j] - at.position[j]) * step / kSteps;
      }
      robot_->arm().command(command);
      sleep_until(now_ns() + 10 * kMs);
    }
  }

 private:
  void carry(const ScriptLink::Datagram& datagram) {
    if (datagram.address != kClient) return;
    std::string text = datagram.text;
    if (tamper) tamper(text);
    gateway_link.deliver(datagram.time_ns, text, source_);
  }

  ScriptClock time_;

 public:
  ScriptLink gateway_link{time_};
  bool deaf = false;  ///< nothing that the gateway sends arrives
  /// Called behind every period of the robot.
  std::function<void(DvrkDouble&)> after_period;
  /// Changes what the robot says on its way to the gateway.
  std::function<void(std::string&)> tamper;

 private:
  DoubleOptions options_;
  pb::ArmEffects effects_;
  ToolMount mount_;
  ScriptLink robot_link_{time_};
  DisturbedLink network_;
  std::optional<DvrkDouble> robot_;
  UdpAddress source_ = kRobot;
  std::int64_t next_ns_ = 0, started_ns_ = 0;
  std::size_t said_ = 0, heard_ = 0;
};

}  // namespace omentum::test
