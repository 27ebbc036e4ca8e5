#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "dvrk_gateway/safety/guards.h"

namespace omentum::safety {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

struct StreamState {
  bool seen, valid;
  std::int64_t arrival_ns, advanced_ns;
  double timestamp_s;
  bool advances;  ///< has a Timestamp of each period
};

template <typename Payload>
StreamState state_of(const Stream<Payload>& stream, bool advances) {
  return {stream.seen,        stream.payload.valid,       stream.arrival_ns,
          stream.advanced_ns, stream.payload.timestamp_s, advances};
}

/// In the order of stream_name().
std::array<StreamState, kStreams> streams_of(const RobotState& robot) {
  return {state_of(robot.measured_js, true),     state_of(robot.measured_cp, true),
          state_of(robot.setpoint_cp, true),     state_of(robot.local_measured_cp, true),
          state_of(robot.jaw_measured_js, true), state_of(robot.operating_state, false)};
}

Finding check_source(const SafetyMemory& memory, const RobotState& robot) {
  const bool another = memory.source != UdpAddress{} && robot.source != memory.source;
  if (!another && robot.foreign == memory.foreign) return {};
  return {StopReason::kForeignSource, static_cast<double>(robot.foreign), 0, -1};
}

/// Of another robot process. What an invalid payload is stamped with says nothing.
Finding check_backward(const SafetyMemory& memory, const RobotState& robot,
                       const std::array<StreamState, kStreams>& streams) {
  if (robot.restarts != memory.restarts)
    return {StopReason::kTimestampBackward, static_cast<double>(robot.restarts), 0, -1};
  for (int k = 0; k < kStreams; ++k) {
    const StreamState& stream = streams[static_cast<std::size_t>(k)];
    const double before = memory.timestamp_s[static_cast<std::size_t>(k)];
    if (stream.valid && !(stream.timestamp_s >= before))
      return {StopReason::kTimestampBackward, stream.timestamp_s, before, k};
  }
  return {};
}

Finding check_age(const SafetySetup& setup, const StreamState& stream, int part,
                  std::int64_t now_ns) {
  const std::int64_t silence = now_ns - stream.arrival_ns;
  const std::int64_t age = stream.advances ? now_ns - stream.advanced_ns : silence;
  // What arrives in the future is of another time and has no age.
  const bool fresh = age >= 0 && silence >= 0 && std::max(age, silence) <= setup.state_age_ns;
  if (fresh) return {};
  return {StopReason::kStale, 1e-9 * static_cast<double>(std::max(age, silence)),
          setup.limits.state_age_s(), part};
}

/// Streams go stale one by one where datagrams get lost. All of them stop where the robot is gone,
/// and all of them leave a period out where another client had the stream until our next goal took
/// it back. Longer gaps than silence were judged when they were.
Finding check_silence(const SafetySetup& setup, const std::array<StreamState, kStreams>& streams,
                      double gap_s, std::int64_t now_ns) {
  std::int64_t newest_ns = streams[0].arrival_ns;
  for (const StreamState& stream : streams) newest_ns = std::max(newest_ns, stream.arrival_ns);
  const std::int64_t silence = now_ns - newest_ns;
  if (silence > setup.silence_ns)
    return {StopReason::kStale, 1e-9 * static_cast<double>(silence), setup.limits.silence_s(), -1};
  if (gap_s > setup.limits.gap_s() && gap_s <= 2 * setup.limits.state_age_s())
    return {StopReason::kStale, gap_s, setup.limits.gap_s(), -1};
  return {};
}

Finding check_operating_state(const OperatingState& state) {
  using State = OperatingState::State;
  if (state.state == State::kFault) return {StopReason::kFault, 0, 0, -1};
  if (state.state != State::kEnabled)
    return {StopReason::kNotEnabled, static_cast<double>(static_cast<int>(state.state)), 0, -1};
  if (!state.is_homed) return {StopReason::kNotHomed, 0, 0, -1};
  if (state.is_busy) return {StopReason::kBusy, 0, 0, -1};
  return {};
}

/// Largest difference from an orthonormal right-handed matrix; infinite if not finite.
double deviation(const Matrix3d& R) {
  if (!R.allFinite()) return std::numeric_limits<double>::infinity();
  const double skew = (R.transpose() * R - Matrix3d::Identity()).cwiseAbs().maxCoeff();
  return std::max(skew, std::abs(R.determinant() - 1));
}

PsmJoints joints_of(const JointState& state) {
  PsmJoints q{};
  std::copy_n(state.position.begin(), 6, q.begin());
  return q;
}

/// The pose of the joints is local/measured_cp, and measured_cp is that in the frame A. Payloads
/// are read by the robot one by one: only those of one Timestamp belong together.
bool is_checkable(const RobotState& robot) {
  const double timestamp_s = robot.local_measured_cp.payload.timestamp_s;
  return robot.measured_js.payload.timestamp_s == timestamp_s &&
         robot.measured_cp.payload.timestamp_s == timestamp_s;
}

Finding check_instrument(const SafetySetup& setup, const RobotState& robot) {
  const CartesianPose& local = robot.local_measured_cp.payload;
  const PsmMismatch mismatch =
      psm_mismatch(joints_of(robot.measured_js.payload), {local.rotation, local.translation},
                   *setup.mount.instrument);
  if (mismatch.agrees()) return {};
  return {StopReason::kWrongInstrument, mismatch.position, 2e-6, -1};
}

/// A base frame that the console computes from other arms drifts by micrometres while nothing
/// moves.
Finding check_base_frame(const SafetySetup& setup, const RobotState& robot) {
  constexpr double kNoise_m = 5e-5;
  constexpr double kTurn = 5e-4;  // of an entry of the rotation
  const CartesianPose& local = robot.local_measured_cp.payload;
  const CartesianPose& measured = robot.measured_cp.payload;
  const double apart = (setup.X_AR * local.translation - measured.translation).norm();
  const double turned =
      (setup.X_AR.linear() * local.rotation - measured.rotation).cwiseAbs().maxCoeff();
  if (apart <= kNoise_m && turned <= kTurn) return {};
  return {StopReason::kBaseFrame, apart, kNoise_m, -1};
}

Finding check_kinematics(const SafetySetup& setup, const SafetyMemory& memory,
                         const RobotState& robot) {
  const bool now = is_checkable(robot);
  if (const Finding found = now ? check_instrument(setup, robot) : memory.instrument) return found;
  return now ? check_base_frame(setup, robot) : memory.base_frame;
}

Finding check_poses(const SafetySetup& setup, const SafetyMemory& memory, const RobotState& robot) {
  constexpr double kOrthonormal = 1e-6;
  for (const auto& [part, pose] : {std::pair{1, &robot.measured_cp.payload},
                                   {2, &robot.setpoint_cp.payload},
                                   {3, &robot.local_measured_cp.payload}}) {
    const double off = deviation(pose->rotation);
    if (!(off <= kOrthonormal)) return {StopReason::kNotOrthonormal, off, kOrthonormal, part};
    if (!pose->translation.allFinite()) return {StopReason::kInvalid, 0, 0, part};
  }
  if (const Finding found = check_kinematics(setup, memory, robot)) return found;
  const double distance =
      psm_wrist_distance(robot.measured_js.payload.position[2], *setup.mount.instrument);
  if (!(distance >= kPsmCannula)) return {StopReason::kInCannula, distance, kPsmCannula, -1};
  return {};
}

/// Since when a condition has held without a break.
bool lasts(bool is, std::int64_t& since_ns, std::int64_t now_ns, std::int64_t limit_ns) {
  if (!is) {
    since_ns = -1;
    return false;
  }
  if (since_ns < 0) since_ns = now_ns;
  return now_ns - since_ns >= limit_ns;
}

}  // namespace

Finding check_robot(const SafetySetup& setup, const SafetyMemory& memory, const RobotState& robot,
                    std::int64_t now_ns) noexcept {
  if (!robot.has_source) return {StopReason::kNothingReceived, 0, 0, -1};
  if (const Finding found = check_source(memory, robot)) return found;
  if (robot.old_shapes_only) return {StopReason::kOldShapes, 0, 0, -1};
  const std::array<StreamState, kStreams> streams = streams_of(robot);
  for (int k = 0; k < kStreams; ++k) {
    if (!streams[static_cast<std::size_t>(k)].seen) return {StopReason::kStreamMissing, 0, 0, k};
  }
  if (const Finding found = check_backward(memory, robot, streams)) return found;
  if (const Finding found = check_silence(setup, streams, robot.gap_s, now_ns)) return found;
  // The state first: it says why the other streams are invalid or stand still.
  constexpr int kState = kStreams - 1;
  if (const Finding found = check_age(setup, streams[kState], kState, now_ns)) return found;
  if (!streams[kState].valid) return {StopReason::kInvalid, 0, 0, kState};
  if (const Finding found = check_operating_state(robot.operating_state.payload)) return found;
  for (int k = 0; k < kState; ++k) {
    const StreamState& stream = streams[static_cast<std::size_t>(k)];
    if (!stream.valid) return {StopReason::kInvalid, 0, 0, k};
    if (const Finding found = check_age(setup, stream, k, now_ns)) return found;
  }
  const int joints = robot.measured_js.payload.count;
  const int jaws = robot.jaw_measured_js.payload.count;
  if (joints != 6) return {StopReason::kJointCount, static_cast<double>(joints), 6, 0};
  if (jaws != 1) return {StopReason::kJointCount, static_cast<double>(jaws), 1, 4};
  const auto finite = [](double v) { return std::isfinite(v); };
  const auto& positions = robot.measured_js.payload.position;
  if (!std::all_of(positions.begin(), positions.begin() + 6, finite))
    return {StopReason::kInvalid, 0, 0, 0};
  if (!finite(robot.jaw_measured_js.payload.position[0])) return {StopReason::kInvalid, 0, 0, 4};
  return check_poses(setup, memory, robot);
}

bool note_kinematics(const SafetySetup& setup, SafetyMemory& memory,
                     const RobotState& robot) noexcept {
  const bool valid = robot.measured_js.payload.valid && robot.measured_js.payload.count == 6 &&
                     robot.measured_cp.payload.valid && robot.local_measured_cp.payload.valid;
  if (!valid || !is_checkable(robot)) return false;
  memory.instrument = check_instrument(setup, robot);
  memory.base_frame = check_base_frame(setup, robot);
  return true;
}

Finding check_rest(const RobotState& robot) noexcept {
  const JointState& setpoint = robot.setpoint_js.payload;
  if (!robot.setpoint_js.seen) return {StopReason::kStreamMissing, 0, 0, kSetpointStream};
  if (!setpoint.valid) return {StopReason::kInvalid, 0, 0, kSetpointStream};
  for (int k = 0; k < std::min(setpoint.velocity_count, 6); ++k) {
    const double velocity = setpoint.velocity[static_cast<std::size_t>(k)];
    if (velocity != 0) return {StopReason::kSetpointVelocity, velocity, 0, k};
  }
  return {};
}

Finding check_load(const SafetySetup& setup, SafetyMemory& memory, const RobotState& robot,
                   std::int64_t now_ns) noexcept {
  const pb::SafetyLimits& limits = setup.limits;
  const double error =
      (robot.measured_cp.payload.translation - robot.setpoint_cp.payload.translation).norm();
  if (lasts(!(error <= limits.tracking_error_m()), memory.tracking_since_ns, now_ns,
            setup.tracking_error_ns))
    return {StopReason::kTracking, error, limits.tracking_error_m(), -1};

  // The jaw is not judged: one that grips is at its limit because it is meant to be.
  const JointState& measured = robot.measured_js.payload;
  int strained = -1;
  for (int k = 0; k < std::min(measured.effort_count, 6) && strained < 0; ++k) {
    const auto joint = static_cast<std::size_t>(k);
    const double most = limits.effort_share() * setup.mount.instrument->effort_limits[joint];
    if (!(std::abs(measured.effort[joint]) <= most)) strained = k;
  }
  if (lasts(strained >= 0, memory.effort_since_ns, now_ns, setup.effort_ns)) {
    const auto joint = static_cast<std::size_t>(strained);
    return {StopReason::kEffort, measured.effort[joint],
            limits.effort_share() * setup.mount.instrument->effort_limits[joint], strained};
  }
  return {};
}

namespace {

/// Far below a step, far above what a robot rounds.
bool is_at(const PsmPose& setpoint_RC, const PsmPose& goal_RC) {
  return (setpoint_RC.p - goal_RC.p).norm() <= 1e-4 &&
         (setpoint_RC.R - goal_RC.R).cwiseAbs().maxCoeff() <= 5e-3;
}

/// The newest goal at which the set-point is. Beyond those that are remembered it may still be at
/// the one where it was seen last: then all since got lost.
void count_unanswered(SafetyMemory& memory, const PsmPose& setpoint_RC) {
  for (int k = 0; k < memory.goal_count; ++k) {
    if (!is_at(setpoint_RC, memory.goals[static_cast<std::size_t>(k)])) continue;
    memory.answered_RC = memory.goals[static_cast<std::size_t>(k)];
    memory.unanswered = k;
    return;
  }
  memory.unanswered = is_at(setpoint_RC, memory.answered_RC) ? SafetyMemory::kGoals : 0;
}

}  // namespace

Finding check_setpoint(const SafetySetup& setup, SafetyMemory& memory,
                       const RobotState& robot) noexcept {
  if (memory.goal_count == 0) return {};
  const CartesianPose& setpoint = robot.setpoint_cp.payload;
  const PsmPose setpoint_RC = pose_in_R(setup, setpoint.rotation, setpoint.translation);
  count_unanswered(memory, setpoint_RC);
  if (!memory.holding && memory.unanswered == SafetyMemory::kGoals)
    return {StopReason::kCommandsLost, static_cast<double>(memory.unanswered), 0, -1};
  double apart = std::numeric_limits<double>::infinity();
  for (int k = 0; k < memory.goal_count; ++k) {
    const PsmPose& goal_RC = memory.goals[static_cast<std::size_t>(k)];
    apart = std::min(apart, (goal_RC.p - setpoint_RC.p).norm());
  }
  const double most = setup.limits.setpoint_error_m();
  memory.setpoint_apart = apart <= most ? 0 : memory.setpoint_apart + 1;
  if (memory.setpoint_apart < setup.limits.setpoint_error_periods()) return {};
  return {StopReason::kSetpointApart, apart, most, -1};
}

}  // namespace omentum::safety
