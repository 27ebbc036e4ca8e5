#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <string>

#include "core/psm.h"
#include "dvrk_gateway/protocol/robot_state.h"
#include "dvrk_gateway/safety/stop_reason.h"
#include "proto/safety.pb.h"

namespace omentum {

/// The safety function of the gateway (docs/dvrk.md 7): a pure function of what was received, what
/// the policy and the operator ask, and the time. Every goal passes through it and is sent as it is
/// or not at all, but for the jaw, which is clipped. It allocates nothing, throws nothing and reads
/// no clock. Frames: W, R, C, T of docs/conventions.md; A is the arm's reference frame on the
/// robot's console, in which measured_cp, setpoint_cp and goals are.

/// What does not change while the gateway runs. Only make_safety_setup() checks it.
struct SafetySetup {
  pb::SafetyLimits limits;
  ToolMount mount;  ///< X_WR, tip offset, workspace box in W, instrument
  Eigen::Isometry3d X_AR = Eigen::Isometry3d::Identity();  ///< base frame, as on the console
  bool registered = false;                                 ///< X_WR is of a registration

  // Limits in the units they are compared in.
  std::int64_t period_ns = 0, state_age_ns = 0, silence_ns = 0, tick_gap_ns = 0, arm_age_ns = 0,
               dead_man_ns = 0;
  std::int64_t tracking_error_ns = 0, effort_ns = 0;
  std::array<double, 6> joint_steps{};
  std::array<double, 6> joint_min{}, joint_max{};  ///< limits of the instrument less the margin
  double jaw_min = 0, jaw_max = 0;
};

/// Throws Error, one line with the knob, for limits out of range or that contradict each other.
SafetySetup make_safety_setup(const pb::SafetyLimits& limits, const ToolMount& mount,
                              const Eigen::Isometry3d& X_AR, bool registered);

/// What happens on the gateway's machine. Moments by the clock of judge(), 0 = never; the newest of
/// each.
struct GatewayEvents {
  std::int64_t arm_ns = 0;          ///< asks to arm
  std::int64_t stop_ns = 0;         ///< asks to stop
  std::int64_t acknowledge_ns = 0;  ///< has seen why it stopped
  std::int64_t held_ns = 0;         ///< when key or pedal was last seen held, with limits.dead_man
  bool fault = false;               ///< the gateway cannot go on: socket, recording
};

/// What the policy asks of this period.
struct PolicyRequest {
  bool fresh = false;  ///< an action arrived since the last period
  /// kServoCp or kServoJp: where to go. kHold: the episode is over; the arm holds and stays armed.
  RobotCommand command = {};
  /// A way to the start was searched for: `obstacle` holds what came of it.
  bool looked = false;
  /// Reason why no way to the start exists; while it is set, nothing is armed, and what is armed
  /// stops.
  Finding obstacle = {};
};

enum class SafetyPhase : int {
  kListening = 0,  ///< nothing received yet
  kWaiting = 1,    ///< the robot is not ready: Judgement::finding says why
  kReady = 2,      ///< waits for the operator
  kActive = 3,     ///< armed
  kStopped = 4,    ///< latched until the operator acknowledges
};
const char* safety_phase_name(SafetyPhase phase);

/// What judge() keeps from one period to the next. Begin with {}.
struct SafetyMemory {
  static constexpr int kGoals = 8;

  SafetyPhase phase = SafetyPhase::kListening;
  Finding stop;  ///< of the last stop
  bool called = false;
  std::int64_t now_ns = 0;      ///< of the last call
  std::int64_t ready_ns = 0;    ///< when the robot became ready
  std::int64_t stopped_ns = 0;  ///< of the last stop
  // GatewayEvents of the last call: an event counts in the call in which it is new.
  std::int64_t arm_event_ns = 0, stop_event_ns = 0, acknowledge_event_ns = 0;
  bool acknowledged = false;  ///< since the last stop
  std::uint32_t ready_count = 0;
  int holds_left = 0;  ///< hold is sent three times: datagrams get lost

  // Of the robot, for what must not change.
  UdpAddress source;
  std::uint64_t foreign = 0, restarts = 0;
  std::array<double, kStreams> timestamp_s{};  ///< newest, by stream
  double counted_s = 0;                        ///< Timestamp at the last of ready_count
  // What the last payloads of one Timestamp said: payloads of different Timestamps are not
  // compared.
  Finding instrument, base_frame;
  bool checked = false;  ///< there were such payloads since the last obstacle to arming
  Finding obstacle;      ///< PolicyRequest::obstacle, the newest
  std::int64_t tracking_since_ns = -1, effort_since_ns = -1;  ///< -1: within the limit

  // While armed.
  bool holding = false;      ///< no goal is in force
  std::uint32_t missed = 0;  ///< periods since the last action
  RobotCommand command;      ///< of the goal in force, jaw as asked
  PsmPose goal_RC;           ///< goal in force
  PsmJoints goal_joints{};
  double jaw = 0;              ///< last goal of the jaw that was sent
  std::int64_t credit_ns = 0;  ///< each goal takes a period of it, and time gives it back
  /// Last goals in R, newest first, which setpoint_cp must follow.
  std::array<PsmPose, kGoals> goals{};
  int goal_count = 0;
  PsmPose answered_RC;               ///< the newest of all goals at which setpoint_cp was seen
  int unanswered = 0;                ///< goals since that one; kGoals stands for more
  std::uint32_t setpoint_apart = 0;  ///< consecutive periods
};

struct Judgement {
  SafetyMemory memory;   ///< for the next call
  bool send = false;     ///< `command` goes out now
  RobotCommand command;  ///< a goal, only in kActive; or hold
  bool jaw_clipped = false;
  /// A stop of this very call, or why the robot is not ready; kNone where all is well.
  Finding finding;
  bool stopped_now = false;  ///< finding stopped the arm
};

/// Whether the tip may be at p_WT with this orientation of the control point: box, reach, joint
/// limits and cannula, as of every goal. `joints` are those of the pose, roll nearest to
/// `roll_near`.
Finding check_goal_pose(const SafetySetup& setup, const Eigen::Matrix3d& R_WC,
                        const Eigen::Vector3d& p_WT, double roll_near, PsmJoints& joints) noexcept;

/// describe() with the addresses that the reason is about.
std::string describe(const Finding& finding, const RobotState& robot);

/// What an armed arm is held for whatever the policy asks: operator, gateway, robot; nothing where
/// the arm is not armed. judge() stops for it with the same finding, so that a loop can look
/// between its periods.
Finding must_hold(const SafetySetup& setup, const SafetyMemory& memory, const RobotState& robot,
                  const GatewayEvents& events, std::int64_t now_ns) noexcept;

/// One period of the control loop. `now_ns` must be of one clock that never goes back, that of the
/// events and of the arrivals in `robot`; `memory` is that of the last call.
Judgement judge(const SafetySetup& setup, const SafetyMemory& memory, const RobotState& robot,
                const PolicyRequest& request, const GatewayEvents& events,
                std::int64_t now_ns) noexcept;

}  // namespace omentum
