#include "dvrk_gateway/bus/robot_account.h"

#include <algorithm>
#include <string>

#include "dvrk_gateway/safety/tool_point.h"

namespace omentum {
namespace {

constexpr std::int64_t kSecondNs = 1'000'000'000;

static_assert(static_cast<int>(RobotPhase::kListening) ==
                  static_cast<int>(SafetyPhase::kListening) &&
              static_cast<int>(RobotPhase::kWaiting) == static_cast<int>(SafetyPhase::kWaiting) &&
              static_cast<int>(RobotPhase::kReady) == static_cast<int>(SafetyPhase::kReady) &&
              static_cast<int>(RobotPhase::kActive) == static_cast<int>(SafetyPhase::kActive) &&
              static_cast<int>(RobotPhase::kStopped) == static_cast<int>(SafetyPhase::kStopped));

std::array<double, 3> array_of(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

std::vector<double> positions_of(const Stream<JointState>& stream) {
  if (!stream.seen || !stream.payload.valid) return {};
  const auto& position = stream.payload.position;
  return {position.begin(), position.begin() + stream.payload.count};
}

double jaw_of(const Stream<JointState>& stream) {
  const bool known = stream.seen && stream.payload.valid && stream.payload.count > 0;
  return known ? stream.payload.position[0] : kNotKnown;
}

/// Median and largest [ms]; kNotKnown without values.
void summarise(std::vector<double>& values, double& median, double& largest) {
  median = largest = kNotKnown;
  if (values.empty()) return;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  median = *middle;
  largest = *std::max_element(values.begin(), values.end());
  values.clear();
}

}  // namespace

RobotAccount::RobotAccount(const SafetySetup& setup)
    : setup_(setup), X_WA_(setup.mount.X_WR * setup.X_AR.inverse()) {
  status_.registered = setup.registered;
  status_.refusals.assign(kStopReasons + 1, 0);
  for (int reason = 0; reason <= kStopReasons; ++reason)
    status_.refusal_names.emplace_back(stop_reason_name(static_cast<StopReason>(reason)));
  status_.reason_name = stop_reason_name(StopReason::kNone);
  status_.operating_state = operating_state_word(OperatingState::State::kUndefined);
}

void RobotAccount::add(const Period& period) {
  tell_state(period);
  tell_places(period);
  count(period);
  measure(period);
}

void RobotAccount::tell_state(const Period& period) {
  const SafetyMemory& memory = period.judgement.memory;
  status_.phase = static_cast<RobotPhase>(memory.phase);
  status_.armed = memory.phase == SafetyPhase::kActive;
  const Finding& why =
      memory.phase == SafetyPhase::kStopped ? memory.stop : period.judgement.finding;
  status_.reason = static_cast<std::uint32_t>(why.reason);
  status_.reason_name = stop_reason_name(why.reason);
  status_.reason_text = why ? describe(why) : "";
  const Stream<OperatingState>& state = period.robot.operating_state;
  if (!state.seen) return;
  status_.operating_state = operating_state_word(state.payload.state);
  status_.is_homed = state.payload.is_homed;
  status_.is_busy = state.payload.is_busy;
}

void RobotAccount::tell_places(const Period& period) {
  const RobotState& robot = period.robot;
  const SafetyMemory& memory = period.judgement.memory;
  const std::array<double, 3> nowhere{kNotKnown, kNotKnown, kNotKnown};
  const auto place = [&](const Stream<CartesianPose>& stream, bool of_tip) {
    const CartesianPose& pose = stream.payload;
    if (!stream.seen || !pose.valid) return nowhere;
    return array_of(X_WA_ * (of_tip ? tip_of(setup_.mount, pose.rotation, pose.translation)
                                    : pose.translation));
  };
  status_.measured_cp_in_world_m = place(robot.measured_cp, false);
  status_.measured_tip_in_world_m = place(robot.measured_cp, true);
  status_.setpoint_cp_in_world_m = place(robot.setpoint_cp, false);
  status_.measured_jp = positions_of(robot.measured_js);
  status_.setpoint_jp = positions_of(robot.setpoint_js);
  status_.measured_jaw_rad = jaw_of(robot.jaw_measured_js);
  status_.setpoint_jaw_rad = jaw_of(robot.jaw_setpoint_js);
  const bool in_force = memory.phase == SafetyPhase::kActive && !memory.holding;
  status_.goal_cp_in_world_m = in_force ? array_of(setup_.mount.X_WR * memory.goal_RC.p) : nowhere;
  status_.goal_jp.clear();
  if (in_force) status_.goal_jp.assign(memory.goal_joints.begin(), memory.goal_joints.end());
  status_.goal_jaw_rad = in_force ? memory.jaw : kNotKnown;
}

void RobotAccount::count(const Period& period) {
  const RobotState& robot = period.robot;
  status_.datagrams = robot.datagrams;
  status_.malformed = robot.malformed;
  status_.foreign = robot.foreign;
  status_.unknown_keys = robot.unknown_keys;
  status_.not_finite = robot.not_finite;
  status_.reordered = robot.reordered;
  status_.restarts = robot.restarts;
  status_.cut = period.cut;
  status_.unsent = period.unsent;
  if (period.sent_ns != 0) ++status_.sent;
  if (period.judgement.stopped_now) {
    ++status_.stops;
    ++status_.refusals[static_cast<std::size_t>(period.judgement.finding.reason)];
  }
  status_.periods = period.number;
  status_.late = period.late;
  status_.missed = period.missed;
  status_.unwatched = period.unwatched;
}

void RobotAccount::measure(const Period& period) {
  const auto ms = [](std::int64_t duration_ns) { return 1e-6 * static_cast<double>(duration_ns); };
  if (second_began_ns_ == 0) second_began_ns_ = period.began_ns;
  if (period.began_ns - second_began_ns_ >= kSecondNs) {
    second_began_ns_ = period.began_ns;
    summarise(second_.latency, status_.latency_p50_ms, status_.latency_max_ms);
    summarise(second_.jitter, status_.jitter_p50_ms, status_.jitter_max_ms);
    summarise(second_.state_age, status_.state_age_p50_ms, status_.state_age_max_ms);
  }
  second_.jitter.push_back(ms(period.late_ns));
  if (period.sent_ns == 0) return;
  second_.latency.push_back(ms(period.sent_ns - period.began_ns));
  second_.state_age.push_back(ms(period.sent_ns - period.state_ns));
}

}  // namespace omentum
