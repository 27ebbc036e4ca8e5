#include "dvrk_gateway/robot_report.h"

#include <fmt/core.h>

#include <algorithm>

#include "core/clock.h"
#include "core/utc_time.h"
#include "dvrk_gateway/protocol/udp_socket.h"

namespace omentum {
namespace {

/// Calls fn(index, name, stream) for each stream.
template <typename Fn>
void for_each_stream(const RobotState& robot, Fn&& fn) {
  fn(0, "measured_js", robot.measured_js);
  fn(1, "setpoint_js", robot.setpoint_js);
  fn(2, "measured_cp", robot.measured_cp);
  fn(3, "setpoint_cp", robot.setpoint_cp);
  fn(4, "local/measured_cp", robot.local_measured_cp);
  fn(5, "jaw/measured_js", robot.jaw_measured_js);
  fn(6, "jaw/setpoint_js", robot.jaw_setpoint_js);
  fn(7, "operating_state", robot.operating_state);
}

constexpr std::size_t kOperatingState = 7;  // its stamp is of the last change

/// Who was late in a gap: by both clocks, where it is long.
std::string cause(double gap_s, double gap_stamp_s, bool stamp_says_nothing) {
  constexpr double kLong_s = 0.05;  // of streams that come every 20 ms or more often
  if (gap_s < kLong_s || stamp_says_nothing) return "";
  const bool robot = gap_stamp_s > 0.5 * gap_s;
  return fmt::format(
      " ({:.1f} ms on the robot's clock: {})", 1e3 * gap_stamp_s,
      robot ? "the robot's computer was busy" : "late on the network, or this computer was busy");
}

}  // namespace

void StreamRates::add(const Period& period) {
  for_each_stream(period.robot, [this](std::size_t index, const char*, const auto& stream) {
    Row& row = rows_[index];
    if (!stream.seen || stream.arrival_ns == row.last_ns) return;
    if (row.renewals++ == 0) {
      row.first_ns = stream.arrival_ns;
    } else if (stream.arrival_ns - row.last_ns > row.longest_gap_ns) {
      row.longest_gap_ns = stream.arrival_ns - row.last_ns;
      row.gap_stamp_s = stream.payload.timestamp_s - row.stamp_s;
    }
    row.last_ns = stream.arrival_ns;
    row.stamp_s = stream.payload.timestamp_s;
  });
}

std::string StreamRates::table(const RobotState& robot) const {
  std::string text;
  for_each_stream(robot, [&](std::size_t index, const char* name, const auto& stream) {
    const Row& row = rows_[index];
    if (!stream.seen) {
      text += fmt::format("{:<18} missing: add it to the streamer file (deploy/dvrk)\n", name);
      return;
    }
    const double span_s = 1e-9 * static_cast<double>(row.last_ns - row.first_ns);
    const double hz = span_s > 0 ? static_cast<double>(row.renewals - 1) / span_s : 0;
    text +=
        fmt::format("{:<18} {:5.1f} Hz seen at the control period, longest gap {:.1f} ms{}, {}\n",
                    name, hz, 1e-6 * static_cast<double>(row.longest_gap_ns),
                    cause(1e-9 * static_cast<double>(row.longest_gap_ns), row.gap_stamp_s,
                          index == kOperatingState),
                    stream.payload.valid ? "valid" : "not valid");
  });
  return text;
}

RobotReport::RobotReport(const SafetySetup& setup, const Registration* registration)
    : setup_(setup), registration_("registration       none\n") {
  if (registration == nullptr) return;
  const double age_h = 1e-9 * static_cast<double>(wall_now_ns() - registration->date_ns) / 3600;
  registration_ = fmt::format(
      "registration       of {}, {:.1f} h ago, {} points, residual {:.2f} mm, predicted error of "
      "the "
      "tip up to {:.2f} mm\n",
      utc_text(registration->date_ns), age_h, registration->points.size(),
      1e3 * registration->residual_rms,
      1e3 * worst_predicted_error(
                *registration,
                std::max(registration->touch_error, pb::RegistrationRules{}.touch_noise_m()),
                setup.mount.workspace_min, setup.mount.workspace_max));
}

/// Units show here: a robot that told mm or degrees would be far outside.
std::string RobotReport::frames() const {
  if (!is_together_) return {};
  const RobotState& robot = together_;
  const CartesianPose& pose = robot.measured_cp.payload;
  const CartesianPose& local = robot.local_measured_cp.payload;
  const Eigen::Isometry3d X_RA = setup_.X_AR.inverse();
  const double apart = (X_RA * pose.translation - local.translation).norm();
  const Eigen::Vector3d p_WC = setup_.mount.X_WR * local.translation;
  const Eigen::Quaterniond q_AR(Eigen::Matrix3d(pose.rotation * local.rotation.transpose()));
  const Eigen::Vector3d p_AR = pose.translation - q_AR * local.translation;
  return fmt::format(
      "frames             measured_cp in {}, {:.4f} mm from local/measured_cp in the base frame "
      "given; --base-frame {:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f} fits\n"
      "control point      at {:.1f}, {:.1f}, {:.1f} mm in W, {:.1f} mm from the remote centre\n",
      robot.reference_frame[0] != 0 ? robot.reference_frame.data() : "a frame without a name",
      1e3 * apart, p_AR.x(), p_AR.y(), p_AR.z(), q_AR.w(), q_AR.x(), q_AR.y(), q_AR.z(),
      1e3 * p_WC.x(), 1e3 * p_WC.y(), 1e3 * p_WC.z(), 1e3 * local.translation.norm());
}

std::string RobotReport::instrument() const {
  const JointState& joints = together_.measured_js.payload;
  const CartesianPose& pose = together_.local_measured_cp.payload;
  if (!is_together_ || !joints.valid || joints.count != 6) return {};
  PsmJoints q{};
  std::copy_n(joints.position.begin(), q.size(), q.begin());
  const Result<void> fits =
      check_instrument(q, {pose.rotation, pose.translation}, *setup_.mount.instrument);
  return fmt::format(
      "instrument         {}\n",
      fits ? std::string(setup_.mount.instrument->name) + ", kinematics agree" : fits.error());
}

void RobotReport::on_period(const Period& period) {
  rates_.add(period);
  last_ = period;
  const RobotState& robot = period.robot;
  const double timestamp_s = robot.local_measured_cp.payload.timestamp_s;
  if (!robot.local_measured_cp.payload.valid || !robot.measured_cp.payload.valid ||
      robot.measured_cp.payload.timestamp_s != timestamp_s ||
      robot.measured_js.payload.timestamp_s != timestamp_s)
    return;
  together_ = robot;
  is_together_ = true;
}

std::string RobotReport::text() const {
  const RobotState& robot = last_.robot;
  const std::string verdict =
      ready() ? "go\n" : "no go: " + describe(last_.judgement.finding, robot) + "\n";
  std::string text;
  if (!robot.has_source && robot.foreign == 0) return "nothing was received\n" + verdict;
  if (!robot.has_source) return "nothing was received of the robot\n" + verdict;
  text += fmt::format(
      "source             {}; {} datagrams, {} malformed, {} foreign, {} unknown keys\n",
      to_string(robot.source), robot.datagrams, robot.malformed, robot.foreign, robot.unknown_keys);
  text += rates_.table(robot);
  text += fmt::format("state              {}{}{}\n", robot.operating_state.payload.sub_state.data(),
                      robot.operating_state.payload.is_homed ? ", homed" : ", not homed",
                      robot.operating_state.payload.is_busy ? ", busy" : "");
  text += frames();
  text += instrument();
  return text + registration_ + verdict;
}

}  // namespace omentum
