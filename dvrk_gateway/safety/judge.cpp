#include <algorithm>
#include <cmath>

#include "dvrk_gateway/protocol/udp_socket.h"
#include "dvrk_gateway/safety/guards.h"
#include "dvrk_gateway/safety/safety.h"

namespace omentum {
namespace {

using safety::Goal;

constexpr int kHolds = 3;  // datagrams get lost

/// What must not change from here on.
void remember(const RobotState& robot, const GatewayEvents& events, std::int64_t now_ns,
              SafetyMemory& memory) {
  memory.called = true;
  memory.now_ns = now_ns;
  memory.arm_event_ns = events.arm_ns;
  memory.stop_event_ns = events.stop_ns;
  memory.acknowledge_event_ns = events.acknowledge_ns;
  memory.foreign = robot.foreign;
  memory.restarts = robot.restarts;
  if (robot.has_source) memory.source = robot.source;
  const auto keep = [&](std::size_t part, const auto& stream) {
    if (stream.seen && stream.payload.valid) memory.timestamp_s[part] = stream.payload.timestamp_s;
  };
  keep(0, robot.measured_js);
  keep(1, robot.measured_cp);
  keep(2, robot.setpoint_cp);
  keep(3, robot.local_measured_cp);
  keep(4, robot.jaw_measured_js);
  keep(5, robot.operating_state);
}

RobotCommand hold() {
  RobotCommand command;
  command.kind = RobotCommand::Kind::kHold;
  return command;
}

void stop(const Finding& finding, std::int64_t now_ns, Judgement& result) {
  SafetyMemory& memory = result.memory;
  memory.phase = SafetyPhase::kStopped;
  memory.stop = finding;
  memory.stopped_ns = now_ns;
  memory.acknowledged = false;
  memory.ready_count = 0;
  memory.holds_left = kHolds - 1;
  result.finding = finding;
  result.stopped_now = true;
  result.send = true;
  result.command = hold();
}

/// The set-point as a goal to start from.
Finding goal_at_setpoint(const SafetySetup& setup, const RobotState& robot, Goal& goal) {
  const CartesianPose& setpoint = robot.setpoint_cp.payload;
  goal.pose_RC = safety::pose_in_R(setup, setpoint.rotation, setpoint.translation);
  const InverseSolution solution =
      psm_solve(goal.pose_RC, robot.measured_js.payload.position[3], *setup.mount.instrument);
  goal.joints = solution.q;
  if (solution.fault == InverseFault::kNone) return {};
  return {StopReason::kUnreachable, goal.pose_RC.p.norm(), 1e-3, -1};
}

void put_in_force(const Goal& goal, SafetyMemory& memory) {
  memory.goal_RC = goal.pose_RC;
  memory.goal_joints = goal.joints;
  std::copy_backward(memory.goals.begin(), memory.goals.end() - 1, memory.goals.end());
  memory.goals[0] = goal.pose_RC;
  memory.goal_count = std::min(memory.goal_count + 1, SafetyMemory::kGoals);
}

bool is_held(const SafetySetup& setup, const GatewayEvents& events, std::int64_t now_ns) {
  if (!setup.limits.dead_man()) return true;
  const std::int64_t age = now_ns - events.held_ns;
  return events.held_ns > 0 && age >= 0 && age <= setup.dead_man_ns;
}

/// The operator stops.
Finding check_operator(const SafetySetup& setup, const SafetyMemory& memory,
                       const GatewayEvents& events, std::int64_t now_ns) {
  if (events.stop_ns != memory.stop_event_ns) return {StopReason::kOperatorStop, 0, 0, -1};
  if (is_held(setup, events, now_ns)) return {};
  return {StopReason::kDeadManReleased, 1e-9 * static_cast<double>(now_ns - events.held_ns),
          setup.limits.dead_man_s(), -1};
}

/// The gateway itself is at fault.
Finding check_gateway(const SafetySetup& setup, const SafetyMemory& memory,
                      const GatewayEvents& events, std::int64_t now_ns) {
  if (events.fault) return {StopReason::kGatewayFault, 0, 0, -1};
  if (!memory.called) return {};
  const std::int64_t gap = now_ns - memory.now_ns;
  if (gap < 0) return {StopReason::kClockBackward, -1e-9 * static_cast<double>(gap), 0, -1};
  if (gap > setup.tick_gap_ns) {
    return {StopReason::kTickLate, 1e-9 * static_cast<double>(gap), setup.limits.tick_gap_s(), -1};
  }
  return {};
}

/// The operator asks in this very call, by an event of after the robot became ready. A moment alone
/// would not do: one of before can come round again when the clock goes back.
bool is_asked_to_arm(const SafetySetup& setup, const SafetyMemory& memory,
                     const GatewayEvents& events, std::int64_t now_ns) {
  const std::int64_t age = now_ns - events.arm_ns;
  return events.arm_ns != memory.arm_event_ns && events.arm_ns >= memory.ready_ns && age >= 0 &&
         age <= setup.arm_age_ns && events.stop_ns == memory.stop_event_ns &&
         is_held(setup, events, now_ns);
}

void arm(const RobotState& robot, const Goal& start, const SafetySetup& setup,
         SafetyMemory& memory) {
  memory.phase = SafetyPhase::kActive;
  memory.holding = true;
  memory.holds_left = 0;
  memory.missed = 0;
  memory.setpoint_apart = 0;
  memory.goal_count = 0;
  memory.unanswered = 0;
  put_in_force(start, memory);
  memory.answered_RC = start.pose_RC;
  const JointState& setpoint = robot.jaw_setpoint_js.payload;
  const bool has_setpoint = robot.jaw_setpoint_js.seen && setpoint.valid && setpoint.count == 1 &&
                            std::isfinite(setpoint.position[0]);
  memory.jaw = has_setpoint ? setpoint.position[0] : robot.jaw_measured_js.payload.position[0];
  memory.credit_ns = 2 * setup.period_ns;
}

/// Before arming: ready after so many periods in which the robot reported anew.
void get_ready(const SafetySetup& setup, const RobotState& robot, const PolicyRequest& request,
               const GatewayEvents& events, std::int64_t now_ns, Judgement& result) {
  SafetyMemory& memory = result.memory;
  if (request.looked) memory.obstacle = request.obstacle;
  const bool checkable = safety::note_kinematics(setup, memory, robot);
  memory.checked |= checkable;
  Goal start;
  Finding found = check_gateway(setup, memory, events, now_ns);
  if (!found) found = safety::check_robot(setup, memory, robot, now_ns);
  if (!found) found = safety::check_load(setup, memory, robot, now_ns);
  if (!found && !memory.checked) found = {StopReason::kNotChecked, 0, 0, -1};
  if (!found) found = safety::check_rest(robot);
  if (!found && !setup.registered) found = {StopReason::kNoRegistration, 0, 0, -1};
  if (!found) found = goal_at_setpoint(setup, robot, start);
  if (!found) found = safety::check_place(setup, start);
  if (!found) found = memory.obstacle;
  result.finding = found;
  if (found) {
    memory.checked = false;
    memory.phase = found.reason == StopReason::kNothingReceived ? SafetyPhase::kListening
                                                                : SafetyPhase::kWaiting;
    memory.ready_count = 0;
    return;
  }
  if (memory.phase == SafetyPhase::kReady) {
    if (is_asked_to_arm(setup, memory, events, now_ns)) arm(robot, start, setup, memory);
    return;
  }
  memory.phase = SafetyPhase::kWaiting;
  const double timestamp_s = robot.measured_js.payload.timestamp_s;
  if (checkable && (memory.ready_count == 0 || timestamp_s > memory.counted_s)) {
    ++memory.ready_count;
    memory.counted_s = timestamp_s;
  }
  if (memory.ready_count >= setup.limits.ready_periods()) {
    memory.phase = SafetyPhase::kReady;
    memory.ready_ns = now_ns;
  }
}

/// The jaw follows what is asked at its rate and inside its range.
void send_goal(const SafetySetup& setup, Judgement& result) {
  SafetyMemory& memory = result.memory;
  const double asked = memory.command.jaw;
  const double inside = std::clamp(asked, setup.jaw_min, setup.jaw_max);
  const double most = setup.limits.jaw_rate_rad_s() * setup.limits.period_s();
  memory.jaw += std::clamp(inside - memory.jaw, -most, most);
  result.jaw_clipped = memory.jaw != asked;
  result.send = true;
  result.command = memory.command;
  result.command.jaw = memory.jaw;
}

/// A goal that may be sent is in force afterwards.
Finding take_goal(const SafetySetup& setup, const RobotState& robot, const RobotCommand& command,
                  SafetyMemory& memory) {
  if (memory.holding) {
    // hold made the set-point of that moment the goal.
    Goal start;
    if (const Finding found = goal_at_setpoint(setup, robot, start)) return found;
    memory.goal_RC = start.pose_RC;
    memory.goal_joints = start.joints;
  }
  Goal goal;
  if (const Finding found = safety::read_goal(setup, memory, command, goal)) return found;
  if (const Finding found = safety::check_place(setup, goal)) return found;
  if (const Finding found = safety::check_steps(setup, memory, goal)) return found;
  put_in_force(goal, memory);
  memory.command = command;
  memory.holding = false;
  memory.holds_left = 0;
  return {};
}

Finding follow_policy(const SafetySetup& setup, const RobotState& robot,
                      const PolicyRequest& request, std::int64_t elapsed_ns, Judgement& result) {
  SafetyMemory& memory = result.memory;
  if (request.looked && request.obstacle) return request.obstacle;
  memory.credit_ns = std::min(memory.credit_ns + elapsed_ns, 2 * setup.period_ns);
  if (request.fresh) {
    memory.missed = 0;
    if (request.command.kind == RobotCommand::Kind::kHold) {
      memory.holding = true;
      memory.holds_left = kHolds;
    } else if (const Finding found = take_goal(setup, robot, request.command, memory)) {
      return found;
    }
  } else if (!memory.holding && ++memory.missed >= setup.limits.missed_actions()) {
    return {StopReason::kPolicyLate, static_cast<double>(memory.missed),
            static_cast<double>(setup.limits.missed_actions()), -1};
  }
  if (memory.holding) {
    if (memory.holds_left == 0) return {};
    --memory.holds_left;
    result.send = true;
    result.command = hold();
    return {};
  }
  if (const Finding found = safety::check_jump(setup, memory, robot)) return found;
  if (memory.credit_ns < setup.period_ns) {
    return {StopReason::kTooFast, 1e-9 * static_cast<double>(elapsed_ns), setup.limits.period_s(),
            -1};
  }
  memory.credit_ns -= setup.period_ns;
  send_goal(setup, result);
  return {};
}

void stay_armed(const SafetySetup& setup, const RobotState& robot, const PolicyRequest& request,
                const GatewayEvents& events, std::int64_t now_ns, Judgement& result) {
  SafetyMemory& memory = result.memory;
  Finding found = must_hold(setup, memory, robot, events, now_ns);
  safety::note_kinematics(setup, memory, robot);
  if (!found) found = safety::check_load(setup, memory, robot, now_ns);
  if (!found) found = safety::check_setpoint(setup, memory, robot);
  if (!found) found = follow_policy(setup, robot, request, now_ns - memory.now_ns, result);
  if (found) stop(found, now_ns, result);
}

void stay_stopped(const GatewayEvents& events, Judgement& result) {
  SafetyMemory& memory = result.memory;
  if (events.acknowledge_ns != memory.acknowledge_event_ns) memory.acknowledged = true;
  if (memory.holds_left > 0) {
    --memory.holds_left;
    result.send = true;
    result.command = hold();
  } else if (memory.acknowledged) {
    memory.phase = SafetyPhase::kWaiting;
    memory.tracking_since_ns = memory.effort_since_ns = -1;
  }
}

}  // namespace

const char* safety_phase_name(SafetyPhase phase) {
  switch (phase) {
    case SafetyPhase::kListening:
      return "listening";
    case SafetyPhase::kWaiting:
      return "waiting";
    case SafetyPhase::kReady:
      return "ready";
    case SafetyPhase::kActive:
      return "active";
    case SafetyPhase::kStopped:
      break;
  }
  return "stopped";
}

std::string describe(const Finding& finding, const RobotState& robot) {
  switch (finding.reason) {
    case StopReason::kNothingReceived:
      if (robot.foreign == 0) return describe(finding);
      return "no datagram of the robot that --robot names, but " + to_string(robot.foreign_source) +
             " sends to this port: is that the robot?";
    case StopReason::kForeignSource:
      if (moved_to_another_port(robot)) {
        return "the robot " + to_string(robot.source) + " fell silent and " +
               to_string(robot.foreign_source) +
               " speaks: if its process was started anew press k to follow it";
      }
      return describe(finding) + ", the last one " + to_string(robot.foreign_source) +
             ", the robot is " + to_string(robot.source);
    case StopReason::kTimestampBackward:
    case StopReason::kStale:
      return describe(finding) + "; the robot is " + to_string(robot.source);
    default:
      return describe(finding);
  }
}

Finding must_hold(const SafetySetup& setup, const SafetyMemory& memory, const RobotState& robot,
                  const GatewayEvents& events, std::int64_t now_ns) noexcept {
  if (memory.phase != SafetyPhase::kActive) return {};
  if (const Finding found = check_gateway(setup, memory, events, now_ns)) return found;
  if (const Finding found = check_operator(setup, memory, events, now_ns)) return found;
  return safety::check_robot(setup, memory, robot, now_ns);
}

Judgement judge(const SafetySetup& setup, const SafetyMemory& memory, const RobotState& robot,
                const PolicyRequest& request, const GatewayEvents& events,
                std::int64_t now_ns) noexcept {
  Judgement result;
  result.memory = memory;
  switch (memory.phase) {
    case SafetyPhase::kActive:
      stay_armed(setup, robot, request, events, now_ns, result);
      break;
    case SafetyPhase::kStopped:
      stay_stopped(events, result);
      break;
    default:
      get_ready(setup, robot, request, events, now_ns, result);
  }
  remember(robot, events, now_ns, result.memory);
  return result;
}

}  // namespace omentum
