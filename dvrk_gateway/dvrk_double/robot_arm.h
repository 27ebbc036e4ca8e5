#pragma once

#include <array>
#include <cstdint>
#include <string_view>
#include <vector>

#include "core/psm.h"
#include "dvrk_gateway/protocol/robot_codec.h"
#include "proto/effects.pb.h"
#include "sim_worker/instrument/arm.h"

namespace omentum {

/// Why the robot passes over a command: it says nothing on the wire, so each is counted.
enum class Refusal {
  kNotJson,     ///< the text as a whole; what stood before the fault is run all the same
  kUnknownKey,  ///< not configured as a command
  kGoal,        ///< absent, too short, or a number that is not finite
  kNotReady,    ///< not enabled, not homed or no tool: in a fault, too
  kInCannula,   ///< Cartesian control begins 43 mm from the remote centre (docs/dvrk.md 5.2 row 14)
  kNoInverse,   ///< no joints for this pose
  kCount,
};
/// "not_json"; empty for kCount.
std::string_view name_of(Refusal refusal);

/// The arm of the double: one PSM with its controller, stepped by ticks of 1/1500 s, without wire
/// and clock. What it does with each command: docs/dvrk.md 5.2. Not thread-safe.
class RobotArm {
 public:
  static constexpr int kTicksPerSecond = 1500;
  /// yaw, pitch, insertion, roll, wrist pitch, wrist yaw, jaw [rad, insertion m].
  using Joints = std::array<double, 7>;

  /// The instrument is that of `mount`. `hardware_like`: starts DISABLED and homes where it stands,
  /// at an insertion of 0.02 m. With zero effects every bit is that of an ideal arm. Throws Error
  /// for effects that Arm refuses.
  RobotArm(const pb::ArmEffects& effects, const ToolMount& mount, bool hardware_like);

  // What only the operator can do; each is a request for the next tick. A wrong one is passed over.
  void power();    ///< DISABLED -> ENABLED
  void disable();  ///< ENABLED, PAUSED or FAULT -> DISABLED
  void pause();    ///< ENABLED -> PAUSED
  void home();     ///< ENABLED, not homed: 1.45 s of motion, then adapter and tool
  void unhome();
  void fault();    ///< any -> FAULT
  void recover();  ///< FAULT or PAUSED -> ENABLED, set-points as measured

  /// Commands of one datagram, run in the next tick.
  void command(const CommandDatagram& commands);
  void refuse(Refusal refusal) { ++refusals_[static_cast<std::size_t>(refusal)]; }

  /// Force on the tip in W [N] from the next tick on; zero at first.
  void set_load(const Eigen::Vector3d& load_W) { load_W_ = load_W; }

  /// Something between the jaw's faces keeps them so far open from the next tick on [rad].
  void set_jaw_stop(double jaw_rad) { jaw_stop_ = jaw_rad; }

  /// 1/1500 s goes by: what was asked of the operator's buttons and commands since the last one is
  /// done.
  void tick();
  /// Ticks as a time [s], 0 at the construction.
  double time_s() const { return static_cast<double>(ticks_) / kTicksPerSecond; }

  // As the streams tell it, as of the last tick: joints [rad, insertion m] and poses of the control
  // point in R [m]. Before homing there are no joints, while it lasts seven (three joints, four
  // discs), then six; jaw and poses are valid with the tool engaged alone.
  JointState measured_js() const;
  JointState setpoint_js() const;
  JointState jaw_measured_js() const;
  JointState jaw_setpoint_js() const;
  CartesianPose measured_cp() const { return pose_of(measured_); }
  CartesianPose setpoint_cp() const { return pose_of(setpoint_); }
  const OperatingState& operating_state() const { return state_; }
  /// Homed, tool engaged: six joints and valid poses, whatever the state.
  bool engaged() const { return stage_ == Stage::kEngaged; }
  /// True tip p_WT [m], which no encoder sees.
  Eigen::Vector3d true_tip() const;
  /// Measured angle of the jaw [rad].
  double jaw() const { return measured_[6]; }

  /// Changes of the operating state since the last call, in order.
  std::vector<OperatingState> take_events();
  /// How many commands were passed over for this reason. Precondition: not kCount.
  std::uint64_t refusals(Refusal refusal) const {
    return refusals_[static_cast<std::size_t>(refusal)];
  }

 private:
  enum class Stage { kStart, kHoming, kEngaged };
  enum class Space { kJoint, kCartesian };
  /// Trajectory in joint space: all joints follow the slowest one's profile.
  struct Move {
    bool active = false;
    bool with_arm = false, with_jaw = false;
    Joints from{}, to{};
    double duration_s = 0, acceleration_s = 0;
    std::int64_t begin = 0;  ///< tick
  };
  struct HomingStep {
    std::int64_t at = 0;  ///< tick
    std::string_view sub_state;
    bool busy = false, homed = false;
  };

  void change(OperatingState::State state, std::string_view sub_state, bool busy, bool homed,
              int events);
  void set_busy(bool busy);
  void advance_homing();
  void begin_homing();
  bool ready() const;
  void run(const CommandDatagram& commands);
  void servo_jp(const JointGoal& goal);
  void servo_cp(const CartesianGoal& goal);
  void servo_jaw(const JointGoal& goal);
  void move_jp(const JointGoal& goal);
  void move_cp(const CartesianGoal& goal);
  void move_jaw(const JointGoal& goal);
  void hold();
  bool enter_cartesian();
  bool inverse(const CartesianGoal& goal, Joints& q);
  void feed_forward(const CartesianGoal& goal);
  void begin_move(const Joints& to, bool with_arm, bool with_jaw);
  void end_move();
  void advance_move();
  bool beyond_tolerance() const;
  void advance_servo();
  Joints delayed_target();
  void rest_at(const Joints& q);
  CartesianPose pose_of(const Joints& q) const;
  const JointRange& limits(std::size_t joint) const;
  double clip(double q, std::size_t joint) const;
  bool at_limit(std::size_t joint) const;
  void note_change(const Joints& before);
  bool effects_active() const;

  pb::ArmEffects effects_;
  ToolMount mount_;
  Arm chain_;
  bool hardware_like_;
  ArmState chain_state_{};
  std::vector<Joints> history_;  ///< targets of the last ticks, a ring
  std::size_t newest_ = 0;
  PsmJoints tip_joints_{};
  double jaw_stop_ = -10;          ///< no jaw closes so far
  std::array<double, 6> droop_{};  ///< D/P [s]

  std::int64_t ticks_ = 0;
  OperatingState state_;
  Stage stage_ = Stage::kStart;
  Space space_ = Space::kJoint;
  std::vector<HomingStep> homing_;  ///< what is still to come
  std::int64_t homing_begin_ = 0;
  std::vector<CommandDatagram> pending_;
  Move move_;
  Joints setpoint_{}, setpoint_velocity_{}, measured_{}, velocity_{};
  std::array<double, 6> effort_{};
  /// Velocities of the goal in force [rad/s, m/s]: the set-point has them while it stands still.
  std::array<double, 6> feed_forward_{};
  std::int64_t changed_ = 0;  ///< tick of the last change of measured_
  Eigen::Vector3d load_W_ = Eigen::Vector3d::Zero();
  std::vector<OperatingState> events_;
  std::array<std::uint64_t, static_cast<std::size_t>(Refusal::kCount)> refusals_{};
};

/// Without the jaw.
inline PsmJoints psm_joints(const RobotArm::Joints& q) {
  return {q[0], q[1], q[2], q[3], q[4], q[5]};
}

}  // namespace omentum
