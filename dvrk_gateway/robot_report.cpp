#include "dvrk_gateway/robot_report.h"

#include <fmt/core.h>

#include <algorithm>

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

}  // namespace

void StreamRates::add(const Period& period) {
  for_each_stream(period.robot, [this](std::size_t index, const char*, const auto& stream) {
    Row& row = rows_[index];
    if (!stream.seen || stream.arrival_ns == row.last_ns) return;
    if (row.renewals++ == 0) {
      row.first_ns = stream.arrival_ns;
    } else {
      row.longest_gap_ns = std::max(row.longest_gap_ns, stream.arrival_ns - row.last_ns);
    }
    row.last_ns = stream.arrival_ns;
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
    text += fmt::format("{:<18} {:5.1f} Hz seen at the control period, longest gap {:.1f} ms, {}\n",
                        name, hz, 1e-6 * static_cast<double>(row.longest_gap_ns),
                        stream.payload.valid ? "valid" : "not valid");
  });
  return text;
}

std::string describe_robot(const Period& period, const StreamRates& rates,
                           const SafetySetup& setup) {
  const RobotState& robot = period.robot;
  std::string text;
  if (!robot.has_source) return "nothing was received\n";
  text += fmt::format(
      "source             {}; {} datagrams, {} malformed, {} foreign, {} unknown keys\n",
      to_string(robot.source), robot.datagrams, robot.malformed, robot.foreign, robot.unknown_keys);
  text += rates.table(robot);
  text += fmt::format("state              {}{}{}\n", robot.operating_state.payload.sub_state.data(),
                      robot.operating_state.payload.is_homed ? ", homed" : ", not homed",
                      robot.operating_state.payload.is_busy ? ", busy" : "");
  const JointState& joints = robot.measured_js.payload;
  if (joints.valid && joints.count == 6 && robot.local_measured_cp.payload.valid) {
    PsmJoints q{};
    std::copy_n(joints.position.begin(), q.size(), q.begin());
    const CartesianPose& pose = robot.local_measured_cp.payload;
    const Result<void> fits =
        check_instrument(q, {pose.rotation, pose.translation}, *setup.mount.instrument);
    text += fmt::format(
        "instrument         {}\n",
        fits ? std::string(setup.mount.instrument->name) + ", kinematics agree" : fits.error());
  }
  text += fmt::format("registration       {}\n", setup.registered ? "loaded" : "none");
  return text;
}

}  // namespace omentum
