#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "dvrk_gateway/safety/safety.h"

namespace omentum::test {

/// Says of every command whether it was safe to send, by rules and formulas of its own: nothing of
/// dvrk_gateway/safety and core/psm judges here. Inverse by angles of the wrist centre and of
/// vectors, with pi/2 for the robot's 1.5708: 4e-6 rad from it.
class Witness {
 public:
  explicit Witness(const SafetySetup& setup) : setup_(setup) {}

  /// Of one period. `robot`, `events`, `now_ns` as judge() was given them, `sent` what goes out,
  /// null without, `stopped`: judge() says that it stopped. Returns what is wrong, null if nothing
  /// is.
  const char* judge(const RobotState& robot, const GatewayEvents& events, std::int64_t now_ns,
                    const RobotCommand* sent, bool stopped) {
    const bool bad = is_bad(robot, events, now_ns);
    const bool released = events.stop_ns != last_stop_ns_ ||
                          (setup_.limits.dead_man() &&
                           (now_ns - events.held_ns > 100'000'000 || now_ns < events.held_ns));
    // Armed by a request behind ten good periods, until a bad one or a stop.
    if (bad || released || stopped) armed_ = false;
    good_ = bad ? 0 : good_ + 1;
    const char* wrong = nullptr;
    if (sent != nullptr && sent->kind != RobotCommand::Kind::kHold) {
      wrong = armed_ ? judge_goal(robot, *sent, now_ns) : "goal while not armed";
    }
    if (sent != nullptr && sent->kind == RobotCommand::Kind::kHold) sent_.clear();
    const std::int64_t age = now_ns - events.arm_ns;
    const bool asked = events.arm_ns != last_arm_ns_ && age >= 0 && age <= 500'000'000;
    // Asked again before the first goal: armed then at the latest.
    const JointState& rest = robot.setpoint_js.payload;
    const bool still = std::all_of(rest.velocity.begin(), rest.velocity.begin() + 6,
                                   [](double v) { return v == 0; });
    if (good_ > 10 && still && !released && asked && (!armed_ || !moved_)) {
      armed_ = true;
      moved_ = false;
      sent_.clear();
      jaw_ = robot.jaw_setpoint_js.payload.position[0];
      if (!std::isfinite(jaw_)) jaw_ = robot.jaw_measured_js.payload.position[0];
    }
    last_arm_ns_ = events.arm_ns;
    last_stop_ns_ = events.stop_ns;
    last_ns_ = now_ns;
    foreign_ = robot.foreign;
    restarts_ = robot.restarts;
    if (robot.has_source) port_ = robot.source.port;
    return wrong;
  }

 private:
  struct Sent {
    std::int64_t at_ns;
    Eigen::Vector3d tip, control;  ///< in W
    std::array<double, 6> q;
  };

  bool is_bad(const RobotState& robot, const GatewayEvents& events, std::int64_t now_ns) const {
    const auto old = [&](const auto& stream, bool advances) {
      const std::int64_t arrived = now_ns - stream.arrival_ns;
      const std::int64_t advanced = now_ns - stream.advanced_ns;
      return !stream.seen || !stream.payload.valid || arrived > 50'000'000 || arrived < 0 ||
             (advances && (advanced > 50'000'000 || advanced < 0));
    };
    const OperatingState& state = robot.operating_state.payload;
    return !robot.has_source || robot.old_shapes_only || robot.foreign != foreign_ ||
           robot.restarts != restarts_ || (robot.gap_s > 0.017 && robot.gap_s <= 0.1) ||
           (port_ != 0 && robot.source.port != port_) ||
           state.state != OperatingState::State::kEnabled || !state.is_homed || state.is_busy ||
           old(robot.operating_state, false) || old(robot.measured_js, true) ||
           old(robot.measured_cp, true) || old(robot.setpoint_cp, true) ||
           old(robot.local_measured_cp, true) || old(robot.jaw_measured_js, true) ||
           robot.measured_js.payload.count != 6 || robot.jaw_measured_js.payload.count != 1 ||
           !robot.measured_cp.payload.translation.allFinite() ||
           !robot.setpoint_cp.payload.translation.allFinite() || !setup_.registered ||
           (last_ns_ != 0 && (now_ns < last_ns_ || now_ns - last_ns_ > 60'000'000)) || events.fault;
  }

  static double bend(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                     const Eigen::Vector3d& about) {
    return std::atan2(about.dot(from.cross(to)), from.dot(to));
  }

  /// Joints of a pose of C in R: shaft along the wrist centre, then angles between the shaft, the
  /// wrist-pitch axis and the jaw.
  std::array<double, 6> joints_of(const Eigen::Matrix3d& R, const Eigen::Vector3d& p,
                                  double roll_near) const {
    const PsmInstrument& instrument = *setup_.mount.instrument;
    const Eigen::Vector3d yaw_axis = -R.col(0);
    const Eigen::Vector3d link = (p - p.dot(yaw_axis) * yaw_axis).normalized();
    const Eigen::Vector3d centre = p - instrument.pitch_to_yaw * link;
    const Eigen::Vector3d shaft = centre.normalized();
    std::array<double, 6> q{};
    q[0] = std::atan2(centre.x(), -centre.z());
    q[1] = -std::asin(shaft.y());
    q[2] = centre.norm() + 0.4318 - instrument.tool_length;
    // Axis of the wrist pitch, across link and yaw axis. With roll 0 it is -x_R turned with
    // the shaft.
    const Eigen::Vector3d pitch_axis = link.cross(yaw_axis).normalized();
    const Eigen::Vector3d side(-std::cos(q[0]), 0, -std::sin(q[0]));
    q[3] = bend(side, pitch_axis, shaft);
    q[4] = bend(shaft, link, pitch_axis);
    q[5] = bend(link, R.col(2), yaw_axis);
    q[3] += 2 * std::acos(-1.0) * std::nearbyint((roll_near - q[3]) / (2 * std::acos(-1.0)));
    return q;
  }

  /// Pose of C in R that joints give: built outwards, axis by axis.
  void pose_of(const std::array<double, 6>& q, Eigen::Matrix3d& R, Eigen::Vector3d& p) const {
    using Eigen::AngleAxisd;
    using Eigen::Vector3d;
    const PsmInstrument& instrument = *setup_.mount.instrument;
    const Vector3d shaft(std::cos(q[1]) * std::sin(q[0]), -std::sin(q[1]),
                         -std::cos(q[1]) * std::cos(q[0]));
    const Vector3d side(-std::cos(q[0]), 0, -std::sin(q[0]));
    const Vector3d pitch_axis = AngleAxisd(q[3], shaft) * side;
    const Vector3d link = AngleAxisd(q[4], pitch_axis) * shaft;
    const Vector3d yaw_axis = pitch_axis.cross(link);
    const Vector3d jaw = AngleAxisd(q[5], yaw_axis) * link;
    p = (q[2] - 0.4318 + instrument.tool_length) * shaft + instrument.pitch_to_yaw * link;
    R.col(0) = -yaw_axis;
    R.col(2) = jaw;
    R.col(1) = R.col(2).cross(R.col(0));
  }

  const char* judge_goal(const RobotState& robot, const RobotCommand& sent, std::int64_t now_ns) {
    constexpr double kSlack = 1e-5;  // rad and m: the other theta offsets, which are 4e-6 apart
    if (!sent.translation.allFinite() || !sent.rotation.allFinite() || !std::isfinite(sent.jaw))
      return "not finite";
    const Eigen::Isometry3d X_RA = setup_.X_AR.inverse();
    Eigen::Matrix3d R = X_RA.linear() * sent.rotation;
    Eigen::Vector3d p = X_RA * sent.translation;
    Sent now{now_ns, {}, {}, {}};
    const double roll_near =
        sent_.empty() ? robot.measured_js.payload.position[3] : sent_.back().q[3];
    if (sent.kind == RobotCommand::Kind::kServoJp) {
      now.q = sent.joints;
      for (const double q : sent.joints) {
        if (!std::isfinite(q)) return "not finite";
      }
      pose_of(sent.joints, R, p);
    } else {
      if (!((R.transpose() * R - Eigen::Matrix3d::Identity()).norm() < 1e-8)) return "rotation";
      now.q = joints_of(R, p, roll_near);
    }
    now.control = setup_.mount.X_WR * p;
    now.tip = setup_.mount.X_WR * (p + setup_.mount.tip_offset * R.col(2));

    if (((now.tip - setup_.mount.workspace_max).array() > kSlack).any() ||
        ((setup_.mount.workspace_min - now.tip).array() > kSlack).any())
      return "outside the box";
    const PsmInstrument& instrument = *setup_.mount.instrument;
    for (std::size_t k = 0; k < 6; ++k) {
      const JointRange& range = instrument.limits[k];
      const double margin = 0.01 * (range.max - range.min);
      if (now.q[k] < range.min + margin - kSlack || now.q[k] > range.max - margin + kSlack)
        return "joint limit";
    }
    if (now.q[2] - 0.4318 + instrument.tool_length < 0.045 - kSlack) return "cannula";
    return judge_motion(robot, sent, now);
  }

  const char* judge_motion(const RobotState& robot, const RobotCommand& sent, const Sent& now) {
    constexpr double kSlack = 2e-5;
    const Eigen::Isometry3d X_WA = setup_.mount.X_WR * setup_.X_AR.inverse();
    const CartesianPose& setpoint = robot.setpoint_cp.payload;
    const Eigen::Vector3d setpoint_W = X_WA * setpoint.translation;
    if (!((now.control - setpoint_W).cwiseAbs().maxCoeff() <= 0.001 + kSlack))
      return "jump from setpoint_cp";
    if (sent_.empty()) {
      const Eigen::Isometry3d X_RA = setup_.X_AR.inverse();
      const Eigen::Matrix3d R = X_RA.linear() * setpoint.rotation;
      const Eigen::Vector3d p = X_RA * setpoint.translation;
      sent_.push_back({now.at_ns, setup_.mount.X_WR * (p + setup_.mount.tip_offset * R.col(2)),
                       setpoint_W, joints_of(R, p, robot.measured_js.payload.position[3])});
    }
    const Sent& before = sent_.back();
    if ((now.control - before.control).cwiseAbs().maxCoeff() > 0.0005 + 1e-6 ||
        (now.tip - before.tip).cwiseAbs().maxCoeff() > 0.0005 + 1e-6)
      return "step";
    constexpr std::array<double, 6> kJointSteps = {0.02, 0.02, 0.001, 0.05, 0.05, 0.05};
    for (std::size_t k = 0; k < 6; ++k) {
      if (std::abs(now.q[k] - before.q[k]) > kJointSteps[k] + kSlack) return "joint step";
    }
    // Speed: any stretch of time, with two periods of jitter.
    for (const Sent& earlier : sent_) {
      const double periods = static_cast<double>(now.at_ns - earlier.at_ns) / 20e6 + 2;
      if ((now.tip - earlier.tip).cwiseAbs().maxCoeff() > 0.0005 * periods + 1e-6) return "speed";
    }
    // Outside its range, as after a FAULT, the jaw comes back.
    const double low = std::min(jaw_, std::max(-0.35, setup_.mount.instrument->jaw.min));
    const double high = std::max(jaw_, 1.396);
    if (std::abs(sent.jaw - jaw_) > 0.04 + 1e-12) return "jaw rate";
    if (sent.jaw < low || sent.jaw > high) return "jaw range";
    jaw_ = sent.jaw;
    if (!sent.velocity.isZero(0) || !sent.angular_velocity.isZero(0) ||
        std::any_of(sent.joint_velocity.begin(), sent.joint_velocity.end(),
                    [](double v) { return v != 0; }))
      return "velocity";
    sent_.push_back(now);
    moved_ = true;
    return nullptr;
  }

  const SafetySetup& setup_;
  bool armed_ = false;
  bool moved_ = false;  ///< a goal since armed
  int good_ = 0;        ///< consecutive periods
  std::int64_t last_arm_ns_ = 0, last_stop_ns_ = 0, last_ns_ = 0;
  std::uint64_t foreign_ = 0, restarts_ = 0;
  std::uint16_t port_ = 0;
  double jaw_ = 0;
  std::vector<Sent> sent_;  ///< since hold or arming
};

}  // namespace omentum::test
