#include "dvrk_gateway/dvrk_double/robot_arm.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"

// What the robot does: docs/dvrk.md 5.2, whose rows are named here.

namespace omentum {
namespace {

using State = OperatingState::State;

constexpr double kTick_s = 1.0 / RobotArm::kTicksPerSecond;
constexpr double kHomedInsertion_m = 0.12;
constexpr double kHardwareInsertion_m = 0.02;
constexpr std::int64_t kHomingTicks = 2175;  // 1.45 s, as recorded
constexpr double kCartesianEntry_m = 0.043;  // row 14
/// Row 12: what a set-point may be from the encoder, yaw, pitch [rad], insertion [m], disc [rad].
constexpr std::array<double, 3> kTolerance = {0.5, 0.5, 0.05};
constexpr double kDiscTolerance = 0.6;
/// Of moves, per joint [rad/s, m/s] and [rad/s^2, m/s^2].
constexpr RobotArm::Joints kMaxVelocity = {1.571, 1.571, 0.2, 18.85, 18.85, 18.85, 18.85};
constexpr RobotArm::Joints kMaxAcceleration = {1.571, 1.571, 0.2, 12.57, 12.57, 12.57, 12.57};
/// Reported velocities last two periods of the streamer.
constexpr std::int64_t kVelocityTicks = 2 * RobotArm::kTicksPerSecond / 100;

/// The robot takes the rotation that is meant; one within rounding stays as it is, one that is
/// none, too, and has no inverse.
Eigen::Matrix3d rotation_of(const Eigen::Matrix3d& received) {
  const double off =
      (received.transpose() * received - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (off < 1e-9 || !(received.determinant() > 0.5)) return received;
  return Eigen::Quaterniond(received).normalized().toRotationMatrix();
}

/// Fraction of the way after t of a profile of constant acceleration, cruise, deceleration.
double profile(double t, double duration, double acceleration) {
  if (t >= duration) return 1;
  const double cruise = 1 / (duration - acceleration);
  if (t < acceleration) return 0.5 * cruise * t * t / acceleration;
  const double left = duration - t;
  if (left < acceleration) return 1 - 0.5 * cruise * left * left / acceleration;
  return cruise * (t - 0.5 * acceleration);
}

}  // namespace

std::string_view name_of(Refusal refusal) {
  switch (refusal) {
    case Refusal::kNotJson:
      return "not_json";
    case Refusal::kUnknownKey:
      return "unknown_key";
    case Refusal::kGoal:
      return "goal";
    case Refusal::kNotReady:
      return "not_ready";
    case Refusal::kInCannula:
      return "in_cannula";
    case Refusal::kNoInverse:
      return "no_inverse";
    case Refusal::kCount:
      break;
  }
  return "";
}

RobotArm::RobotArm(const pb::ArmEffects& effects, const ToolMount& mount, bool hardware_like)
    : effects_(effects),
      mount_(mount),
      chain_(
          [&] {
            pb::ArmEffects rest = effects;
            rest.clear_transport_delay_s();  // the chain's own memory is of 15 steps: see history_
            return rest;
          }(),
          mount, kTick_s),
      hardware_like_(hardware_like) {
  const pb::JointValues& droop = effects_.droop_s();
  droop_ = {droop.yaw(),  droop.pitch(),       droop.insertion(),
            droop.roll(), droop.wrist_pitch(), droop.wrist_yaw()};
  const auto steps = static_cast<std::size_t>(effects_.transport_delay_s() / kTick_s);
  history_.resize(steps + 2);
  state_.valid = true;
  const State first = hardware_like ? State::kDisabled : State::kEnabled;
  change(first, hardware_like ? "DISABLED" : "ENABLED", false, false, 0);
}

const JointRange& RobotArm::limits(std::size_t joint) const {
  return joint < 6 ? mount_.instrument->limits[joint] : mount_.instrument->jaw;
}

double RobotArm::clip(double q, std::size_t joint) const {
  return std::clamp(q, limits(joint).min, limits(joint).max);
}

bool RobotArm::at_limit(std::size_t joint) const {
  return setpoint_[joint] == limits(joint).min || setpoint_[joint] == limits(joint).max;
}

// ---- operator --------------------------------------------------------------------------------

void RobotArm::change(State state, std::string_view sub_state, bool busy, bool homed, int events) {
  state_.state = state;
  state_.sub_state = {};
  sub_state.copy(state_.sub_state.data(), kMaxSubState);
  state_.is_busy = busy;
  state_.is_homed = homed;
  state_.timestamp_s = time_s();
  for (int k = 0; k < events; ++k) events_.push_back(state_);
}

void RobotArm::set_busy(bool busy) {
  if (state_.is_busy == busy) return;
  const std::string sub_state = state_.sub_state.data();
  change(state_.state, sub_state, busy, state_.is_homed, 1);
}

void RobotArm::power() {
  if (state_.state != State::kDisabled) return;
  rest_at(measured_);
  change(State::kEnabled, engaged() ? "HOMED" : "ENABLED", false, state_.is_homed, 2);
}

void RobotArm::disable() {
  if (state_.state == State::kDisabled) return;
  end_move();
  homing_.clear();
  if (stage_ == Stage::kHoming) stage_ = Stage::kStart;
  change(State::kDisabled, "DISABLED", false, state_.is_homed, 2);
}

void RobotArm::pause() {
  if (state_.state != State::kEnabled) return;
  end_move();
  change(State::kPaused, "PAUSED", false, state_.is_homed, 2);
}

void RobotArm::unhome() {
  if (state_.state == State::kFault) return;
  end_move();
  stage_ = Stage::kStart;
  homing_.clear();
  change(state_.state, "ENABLED", false, false, 2);
}

void RobotArm::fault() {
  if (state_.state == State::kFault) return;
  end_move();
  homing_.clear();
  events_.push_back(state_);
  change(state_.state, std::string(state_.sub_state.data()), false, state_.is_homed, 1);
  change(State::kFault, "FAULT", false, state_.is_homed, 2);
}

void RobotArm::recover() {
  if (state_.state != State::kFault && state_.state != State::kPaused) return;
  rest_at(measured_);
  space_ = Space::kJoint;
  change(State::kEnabled, engaged() ? "HOMED" : "ENABLED", false, engaged(), 2);
}

void RobotArm::home() {
  if (state_.state != State::kEnabled || stage_ != Stage::kStart || !homing_.empty()) return;
  events_.push_back(state_);
  change(State::kEnabled, "ENABLED", false, false, 1);
  const std::int64_t now = ticks_;
  // "HOMED, not busy" between the stages lasts less than a millisecond, as recorded.
  const std::int64_t homed = now + 3 + kHomingTicks;
  homing_ = {{now + 1, "CALIBRATING_ENCODERS_FROM_POTS", true, false},
             {now + 2, "ENCODERS_BIASED", false, true},
             {now + 3, "HOMING", true, true},
             {homed, "HOMED", false, true},
             {homed + 1, "ENGAGING_ADAPTER", true, true},
             {homed + 1, "HOMED", false, true},
             {homed + 2, "ENGAGING_TOOL", true, true},
             {homed + 2, "TOOL_ENGAGED", false, true},
             {homed + 3, "HOMED", false, true}};
}

void RobotArm::advance_homing() {
  while (!homing_.empty() && homing_.front().at <= ticks_) {
    const HomingStep step = homing_.front();
    homing_.erase(homing_.begin());
    change(State::kEnabled, step.sub_state, step.busy, step.homed, 2);
    if (step.sub_state == "HOMING") begin_homing();
    if (homing_.empty()) {
      stage_ = Stage::kEngaged;
      rest_at(setpoint_);
    }
  }
  if (stage_ != Stage::kHoming) return;
  const double way = profile(static_cast<double>(ticks_ - homing_begin_) * kTick_s,
                             kHomingTicks * kTick_s, 0.5 * kHomingTicks * kTick_s);
  setpoint_[2] = hardware_like_ ? kHardwareInsertion_m : kHomedInsertion_m * way;
}

void RobotArm::begin_homing() {
  stage_ = Stage::kHoming;
  homing_begin_ = ticks_;
  setpoint_ = {};
  measured_ = {};
  if (hardware_like_) setpoint_[2] = measured_[2] = kHardwareInsertion_m;
}

// ---- commands --------------------------------------------------------------------------------

void RobotArm::command(const CommandDatagram& commands) { pending_.push_back(commands); }

bool RobotArm::ready() const { return engaged() && state_.state == State::kEnabled; }

void RobotArm::run(const CommandDatagram& commands) {
  if (commands.known_keys == 0) return;
  if (!ready()) return refuse(Refusal::kNotReady);
  if (!commands.finite) return refuse(Refusal::kGoal);
  if (commands.hold) hold();
  if (commands.jaw_move_jp) move_jaw(*commands.jaw_move_jp);
  if (commands.jaw_servo_jp) servo_jaw(*commands.jaw_servo_jp);
  if (commands.move_cp) move_cp(*commands.move_cp);
  if (commands.move_jp) move_jp(*commands.move_jp);
  if (commands.servo_cp) servo_cp(*commands.servo_cp);
  if (commands.servo_jp) servo_jp(*commands.servo_jp);
}

void RobotArm::hold() {
  end_move();
  space_ = Space::kJoint;
  feed_forward_ = {};
}

void RobotArm::servo_jp(const JointGoal& goal) {
  if (goal.goal_count < 6) return refuse(Refusal::kGoal);
  end_move();
  space_ = Space::kJoint;
  for (std::size_t j = 0; j < 6; ++j) {
    setpoint_[j] = clip(goal.goal[j], j);
    feed_forward_[j] = goal.velocity_count == 6 ? goal.velocity[j] : 0;
  }
}

void RobotArm::servo_jaw(const JointGoal& goal) {
  if (goal.goal_count < 1) return refuse(Refusal::kGoal);
  if (move_.with_jaw && !move_.with_arm) end_move();
  move_.with_jaw = false;
  // Row 15: in Cartesian control nothing clips the jaw.
  setpoint_[6] = space_ == Space::kCartesian ? goal.goal[0] : clip(goal.goal[0], 6);
}

void RobotArm::servo_cp(const CartesianGoal& goal) {
  Joints q = setpoint_;
  if (!inverse(goal, q)) return;
  end_move();
  q[6] = setpoint_[6];
  setpoint_ = q;
  feed_forward(goal);
}

void RobotArm::move_jp(const JointGoal& goal) {
  if (goal.goal_count < 6) return refuse(Refusal::kGoal);
  space_ = Space::kJoint;
  Joints to{};  // row 7: the jaw goes to 0
  for (std::size_t j = 0; j < 6; ++j) to[j] = clip(goal.goal[j], j);
  begin_move(to, true, true);
}

void RobotArm::move_cp(const CartesianGoal& goal) {
  Joints to = setpoint_;
  if (inverse(goal, to)) begin_move(to, true, false);
}

void RobotArm::move_jaw(const JointGoal& goal) {
  if (goal.goal_count < 1) return refuse(Refusal::kGoal);
  Joints to = setpoint_;
  to[6] = clip(goal.goal[0], 6);
  begin_move(to, false, true);
}

bool RobotArm::enter_cartesian() {
  const bool inside = psm_wrist_distance(measured_[2], *mount_.instrument) < kCartesianEntry_m;
  if (space_ == Space::kJoint && inside) {
    refuse(Refusal::kInCannula);
    return false;
  }
  space_ = Space::kCartesian;
  return true;
}

/// Joints of a goal with the 45 mm rule (docs/dvrk.md 3) and the limits; false, counted, if none.
bool RobotArm::inverse(const CartesianGoal& goal, Joints& q) {
  if (!goal.has_rotation || !goal.has_translation) {
    refuse(Refusal::kGoal);
    return false;
  }
  if (!enter_cartesian()) return false;
  const Result<PsmJoints> solved =
      psm_inverse({rotation_of(goal.rotation), goal.translation}, measured_[3], *mount_.instrument);
  if (!solved) {
    refuse(Refusal::kNoInverse);
    return false;
  }
  std::copy_n(solved.value().begin(), 6, q.begin());
  const double c = psm_wrist_distance(q[2], *mount_.instrument);
  if (c < kPsmCannula) {
    const double least = q[2] + (kPsmCannula - c);
    q[2] = measured_[2] <= least ? std::max(measured_[2], q[2]) : least;
  }
  for (std::size_t j = 0; j < 6; ++j) q[j] = clip(q[j], j);
  return true;
}

/// Joint velocities of the Cartesian ones, by the difference of two inverses.
void RobotArm::feed_forward(const CartesianGoal& goal) {
  feed_forward_ = {};
  const double turn = goal.angular_velocity.norm();
  if (turn == 0 && goal.velocity.norm() == 0) return;
  constexpr double kStep_s = 1e-5;
  const PsmPose here = psm_forward(psm_joints(setpoint_), *mount_.instrument);
  PsmPose there = here;
  there.p += kStep_s * goal.velocity;
  if (turn > 0) {
    const Eigen::AngleAxisd rotated(turn * kStep_s, goal.angular_velocity / turn);
    there.R = rotated.toRotationMatrix() * here.R;
  }
  const Result<PsmJoints> from = psm_inverse(here, setpoint_[3], *mount_.instrument);
  const Result<PsmJoints> to = psm_inverse(there, setpoint_[3], *mount_.instrument);
  if (!from || !to) return;
  for (std::size_t j = 0; j < 6; ++j)
    feed_forward_[j] = (to.value()[j] - from.value()[j]) / kStep_s;
}

// ---- moves -----------------------------------------------------------------------------------

void RobotArm::begin_move(const Joints& to, bool with_arm, bool with_jaw) {
  feed_forward_ = {};
  move_ = {};
  move_.active = true;
  move_.with_arm = with_arm;
  move_.with_jaw = with_jaw;
  move_.from = setpoint_;
  move_.to = to;
  move_.begin = ticks_;
  for (std::size_t j = 0; j < 7; ++j) {
    if (!(j < 6 ? with_arm : with_jaw)) continue;
    const double way = std::fabs(to[j] - setpoint_[j]);
    const double a = kMaxAcceleration[j];
    const double v = std::min(kMaxVelocity[j], std::sqrt(way * a));
    const double duration = v > 0 ? way / v + v / a : 0;
    if (duration <= move_.duration_s) continue;
    move_.duration_s = duration;
    move_.acceleration_s = v / a;
  }
  set_busy(true);
}

void RobotArm::end_move() {
  move_ = {};
  setpoint_velocity_ = {};
  set_busy(false);
}

void RobotArm::advance_move() {
  if (!move_.active) return;
  const double t = static_cast<double>(ticks_ - move_.begin) * kTick_s;
  const bool done = t >= move_.duration_s;
  const double way = done ? 1 : profile(t, move_.duration_s, move_.acceleration_s);
  for (std::size_t j = 0; j < 7; ++j) {
    if (!(j < 6 ? move_.with_arm : move_.with_jaw)) continue;
    const double before = setpoint_[j];
    setpoint_[j] = done ? move_.to[j] : move_.from[j] + way * (move_.to[j] - move_.from[j]);
    setpoint_velocity_[j] = (setpoint_[j] - before) / kTick_s;
  }
  if (done) end_move();
}

// ---- servo -----------------------------------------------------------------------------------

/// At the level of actuators: three joints and four discs; not where a set-point is at its limit.
bool RobotArm::beyond_tolerance() const {
  for (std::size_t j = 0; j < 3; ++j) {
    const bool far = std::fabs(setpoint_[j] - measured_[j]) > kTolerance[j];
    if (far && !at_limit(j)) return true;
  }
  Eigen::Vector4d off;
  for (std::size_t j = 3; j < 7; ++j) {
    if (at_limit(j)) return false;
    off[static_cast<int>(j) - 3] = setpoint_[j] - measured_[j];
  }
  const Eigen::Vector4d discs = mount_.instrument->disc_coupling().inverse() * off;
  return discs.cwiseAbs().maxCoeff() > kDiscTolerance;
}

/// The set-point `transport_delay_s` ago, with what a velocity of the client adds: for a servo with
/// P e + D (v_set - v) = 0 the set-point leads by D/P v_set (docs/mismatch.md 2.2).
RobotArm::Joints RobotArm::delayed_target() {
  newest_ = (newest_ + 1) % history_.size();
  history_[newest_] = setpoint_;
  for (std::size_t j = 0; j < 6; ++j) history_[newest_][j] += droop_[j] * feed_forward_[j];
  const double steps = effects_.transport_delay_s() / kTick_s;
  const auto whole = static_cast<std::size_t>(steps);
  const double part = steps - static_cast<double>(whole);
  const std::size_t size = history_.size();
  const Joints& newer = history_[(newest_ + size - whole) % size];
  if (part == 0) return newer;
  const Joints& older = history_[(newest_ + size - whole - 1) % size];
  Joints between{};
  for (std::size_t j = 0; j < 7; ++j) between[j] = newer[j] + part * (older[j] - newer[j]);
  return between;
}

/// The servo stands still at these joints.
void RobotArm::rest_at(const Joints& q) {
  setpoint_ = q;
  feed_forward_ = {};
  chain_.reset_joints(chain_state_, psm_joints(q));
  tip_joints_ = psm_joints(q);
  history_.assign(history_.size(), q);
}

void RobotArm::advance_servo() {
  const Joints before = measured_;
  const bool off = state_.state == State::kFault || state_.state == State::kDisabled;
  if (off) {
    setpoint_ = measured_;  // section 4.5
  } else if (!effects_active()) {
    measured_ = setpoint_;
  } else {
    const Joints target = delayed_target();
    const ArmReport report = chain_.follow(chain_state_, psm_joints(target), load_W_, tip_joints_);
    std::copy_n(report.measured.begin(), 6, measured_.begin());
    effort_ = report.effort;
    measured_[6] = target[6];
  }
  measured_[6] = std::max(measured_[6], jaw_stop_);
  note_change(before);
}

/// As a robot in kinematic simulation reports it: way over the time since the previous change.
void RobotArm::note_change(const Joints& before) {
  if (measured_ != before) {
    const double since_s = static_cast<double>(ticks_ - changed_) * kTick_s;
    for (std::size_t j = 0; j < 7; ++j) velocity_[j] = (measured_[j] - before[j]) / since_s;
    changed_ = ticks_;
  } else if (ticks_ - changed_ > kVelocityTicks) {
    velocity_ = {};
  }
}

void RobotArm::tick() {
  ++ticks_;
  advance_homing();
  for (const CommandDatagram& commands : pending_) run(commands);
  pending_.clear();
  advance_move();
  const bool fault_now = ready() && beyond_tolerance();
  advance_servo();
  if (fault_now) {
    fault();
    setpoint_ = measured_;
  }
}

}  // namespace omentum
