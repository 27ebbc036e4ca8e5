#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "core/psm.h"
#include "dvrk_gateway/protocol/robot_state.h"

namespace omentum::test {

/// A robot that does at once what it is told and reports it without error: what the safety function
/// sees of it, a RobotState, period by period. Its A is the frame X_AR.
class IdealRobot {
 public:
  IdealRobot(const PsmInstrument& instrument, const Eigen::Isometry3d& X_AR, const PsmJoints& q)
      : instrument_(&instrument), X_AR_(X_AR), q_(q) {
    state.has_source = true;
    state.source = {0x7f000001, 40000};
    state.operating_state.payload.state = OperatingState::State::kEnabled;
    state.operating_state.payload.is_homed = true;
  }

  RobotState state;

  /// Every stream reports, at `now_ns` of the gateway's clock and `robot_s` of its own.
  void report(std::int64_t now_ns, double robot_s) {
    const PsmPose local = psm_forward(q_, *instrument_);
    write(state.measured_js, now_ns, robot_s, [&](JointState& to) { set(to, q_.data(), 6); });
    write(state.setpoint_js, now_ns, robot_s, [&](JointState& to) { set(to, q_.data(), 6); });
    write(state.jaw_measured_js, now_ns, robot_s, [&](JointState& to) { set(to, &jaw_, 1); });
    write(state.jaw_setpoint_js, now_ns, robot_s, [&](JointState& to) { set(to, &jaw_, 1); });
    const auto in_A = [&](CartesianPose& to) {
      to.rotation = X_AR_.linear() * local.R;
      to.translation = X_AR_ * local.p;
    };
    write(state.measured_cp, now_ns, robot_s, in_A);
    write(state.setpoint_cp, now_ns, robot_s, in_A);
    write(state.local_measured_cp, now_ns, robot_s, [&](CartesianPose& to) {
      to.rotation = local.R;
      to.translation = local.p;
    });
    write(state.operating_state, now_ns, 1.0, [](OperatingState&) {});
    state.datagrams += 8;
  }

  void obey(const RobotCommand& command) {
    if (command.kind == RobotCommand::Kind::kHold) return;
    jaw_ = command.jaw;
    if (command.kind == RobotCommand::Kind::kServoJp) {
      q_ = command.joints;
      return;
    }
    const Eigen::Isometry3d X_RA = X_AR_.inverse();
    const InverseSolution solution = psm_solve(
        {X_RA.linear() * command.rotation, X_RA * command.translation}, q_[3], *instrument_);
    if (solution.fault == InverseFault::kNone) q_ = solution.q;
  }

  const PsmJoints& joints() const { return q_; }
  void place(const PsmJoints& q) { q_ = q; }
  void set_jaw(double jaw) { jaw_ = jaw; }

 private:
  template <typename Payload, typename Write>
  static void write(Stream<Payload>& stream, std::int64_t now_ns, double robot_s, Write fill) {
    stream.seen = true;
    stream.arrival_ns = now_ns;
    if (robot_s > stream.payload.timestamp_s) stream.advanced_ns = now_ns;
    stream.payload.timestamp_s = robot_s;
    stream.payload.valid = true;
    fill(stream.payload);
  }
  static void set(JointState& to, const double* position, int count) {
    to.count = to.velocity_count = to.effort_count = count;
    to.position = {};
    to.velocity = {};
    to.effort = {};
    std::copy_n(position, count, to.position.begin());
  }

  const PsmInstrument* instrument_;
  Eigen::Isometry3d X_AR_;
  PsmJoints q_;
  double jaw_ = 0.5;
};

/// The scene of the paper: R above W, the tool straight down.
inline ToolMount paper_mount(const PsmInstrument& instrument = large_needle_driver()) {
  Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
  X_WR.translation() = Eigen::Vector3d(0.1427, 0, 0.1584);
  ToolMount mount = make_tool_mount(X_WR, 0.5, 0.0102, Eigen::Vector3d(-0.0916, -0.0825, 0.001),
                                    Eigen::Vector3d(0.0691, 0.1155, 0.119));
  mount.instrument = &instrument;
  return mount;
}

}  // namespace omentum::test
