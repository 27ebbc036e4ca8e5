// Random scripts against the safety function: fault_scripts N [FIRST=0]. In each the operator, the
// policy, the robot and the clock do right and wrong at random; a witness that shares no code with
// the function says of every command whether it was safe. Prints the reasons and what was unsafe;
// last line scripts=N armed=A unsafe=U reasons=R/T. Exit code 1 when U > 0, R < T or A < N / 20.
#include <array>
#include <limits>
#include <vector>

#include "core/rng.h"
#include "dvrk_gateway/safety/safety.h"
#include "tests/dvrk_gateway/ideal_robot.h"
#include "tests/dvrk_gateway/script_tally.h"
#include "tests/dvrk_gateway/witness.h"

namespace omentum {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using test::Tally;

constexpr std::int64_t kPeriod = 20'000'000;

enum class Fault : int {
  kSilence,
  kLoss,
  kDuplicates,
  kReordering,
  kOneStreamStops,
  kSetpointJump,
  kSetpointDrift,
  kNotFinite,
  kInvalid,
  kNullJoints,
  kRobotFault,
  kDisabled,
  kUnhomed,
  kBusy,
  kRestart,
  kTimestampBack,
  kTheft,
  kForeignDatagram,
  kForeignSource,
  kClockBack,
  kTickLate,
  kTickBurst,
  kPolicyStalls,
  kPolicyNotFinite,
  kPolicyLeaps,
  kPolicyDrifts,
  kPolicyTurns,
  kPolicyRolls,
  kPolicyScales,
  kPolicyVelocity,
  kPolicyJaw,
  kPolicyHolds,
  kPolicyToCentre,
  kPolicyFar,
  kRobotDeaf,
  kLag,
  kEffort,
  kOtherInstrument,
  kOtherBase,
  kSkewed,
  kCannula,
  kOperatorStops,
  kKeyReleased,
  kGatewayFault,
  kArmAtRandom,
  kLeftVelocity,
  kNoWay,
  kCount
};

/// One fault and when it acts.
struct Event {
  Fault fault;
  int from, until;
  double size;  ///< in [0, 1)
  int part;
  bool acts(int tick) const { return tick >= from && tick < until; }
};

class FaultScript {
 public:
  FaultScript(std::uint64_t number)
      : number_(number),
        draws_(number, 0, Purpose::kReset, 0),
        setup_(random_setup()),
        robot_(*setup_.mount.instrument, setup_.X_AR, start()),
        witness_(setup_) {}

  void run(Tally& tally) {
    const int ticks = 30 + static_cast<int>(below(60));
    arm_at_ = chance(0.93) ? 10 + static_cast<int>(below(12)) : 1000;
    const int events = static_cast<int>(below(4));
    for (int k = 0; k < events; ++k) {
      Event event{static_cast<Fault>(below(static_cast<std::uint32_t>(Fault::kCount))), 0, 0,
                  uniform(0, 1), static_cast<int>(below(8))};
      // Most come once the arm is under way.
      event.from = chance(0.75) ? 14 + static_cast<int>(below(60)) : static_cast<int>(below(14));
      event.until = event.from + 1 + static_cast<int>(chance(0.5) ? below(3) : below(40));
      events_.push_back(event);
    }
    if (chance(0.03)) robot_.set_jaw(uniform(-0.75, 1.5));
    direction_ = Vector3d(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
    bool armed = false;
    for (tick_ = 0; tick_ < ticks; ++tick_) {
      step(tally);
      armed |= memory_.phase == SafetyPhase::kActive;
    }
    tally.armed += armed ? 1 : 0;
  }

 private:
  double uniform(double min, double max) { return uniform_between(draws_.next(), min, max); }
  bool chance(double share) { return uniform(0, 1) < share; }
  std::uint32_t below(std::uint32_t bound) { return bounded(draws_.next(), bound); }
  const Event* active(Fault fault) const {
    for (const Event& event : events_) {
      if (event.fault == fault && event.acts(tick_)) return &event;
    }
    return nullptr;
  }

  SafetySetup random_setup() {
    pb::SafetyLimits limits;
    if (chance(0.2)) limits.set_dead_man(true);
    const auto instruments = psm_instruments();
    ToolMount mount = test::paper_mount(instruments[below(12)]);
    // Some boxes hold the remote centre, so that cannula and centre are reached.
    large_box_ = chance(0.15);
    if (large_box_) {
      mount.workspace_min = Vector3d::Constant(-0.4);
      mount.workspace_max = Vector3d::Constant(0.4);
    }
    Isometry3d X_AR = Isometry3d::Identity();
    if (chance(0.3)) {
      X_AR.linear() = Eigen::Quaterniond(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1), 0.1)
                          .normalized()
                          .toRotationMatrix();
      X_AR.translation() = Vector3d(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
    }
    by_joints_ = chance(0.2);
    return make_safety_setup(limits, mount, X_AR, !chance(0.01));
  }

  /// A place of the tip that the arm reaches.
  PsmJoints start() {
    if (large_box_ && chance(0.3)) {
      // Just past the cannula, and on the way back.
      withdraws_ = true;
      const double depth = uniform(0.0455, 0.048) + setup_.mount.instrument->pitch_to_yaw;
      tip_ = setup_.mount.tip(setup_.mount.X_WR.translation() - depth * Vector3d::UnitZ());
      return joints_for_tip(setup_.mount, tip_).value();
    }
    while (true) {
      tip_ = Vector3d(uniform(-0.05, 0.05), uniform(-0.05, 0.09), uniform(0.02, 0.119));
      if (const Result<PsmJoints> joints = joints_for_tip(setup_.mount, tip_)) {
        return joints.value();
      }
    }
  }

  RobotCommand goal() {
    const Isometry3d X_AW = setup_.X_AR * setup_.mount.X_WR.inverse();
    RobotCommand command;
    command.kind = RobotCommand::Kind::kServoCp;
    command.rotation = X_AW.linear() * setup_.mount.R_WC;
    command.translation = X_AW * setup_.mount.control_point(tip_);
    command.jaw = jaw_;
    if (by_joints_) {
      PsmPose pose;
      const Isometry3d X_RA = setup_.X_AR.inverse();
      pose.R = X_RA.linear() * command.rotation;
      pose.p = X_RA * command.translation;
      const InverseSolution solution =
          psm_solve(pose, robot_.joints()[3], *setup_.mount.instrument);
      command.kind = RobotCommand::Kind::kServoJp;
      command.joints = solution.q;
    }
    return command;
  }

  void move_clock() {
    std::int64_t dt = kPeriod + static_cast<std::int64_t>(uniform(-3e6, 3e6));
    if (active(Fault::kClockBack) != nullptr) dt = -static_cast<std::int64_t>(uniform(0, 3e9));
    if (const Event* late = active(Fault::kTickLate))
      dt += static_cast<std::int64_t>(2e8 * late->size);
    if (active(Fault::kTickBurst) != nullptr) dt /= 8;
    now_ns_ += dt;
    robot_s_ += 0.02;
  }

  /// What the receiver would hold after this period.
  void receive() {
    RobotState& state = robot_.state;
    if (active(Fault::kRestart) != nullptr) {
      robot_s_ = 1;
      ++state.restarts;
    }
    state.gap_s = active(Fault::kTheft) != nullptr ? 0.02 : 0.01;
    if (active(Fault::kForeignDatagram) != nullptr) {
      ++state.foreign;
      state.foreign_source = {0x0a000001, 9};
    }
    if (active(Fault::kForeignSource) != nullptr) state.source.port = 9;
    if (active(Fault::kReordering) != nullptr) ++state.reordered;
    const bool lost = active(Fault::kSilence) != nullptr || chance(0.02) ||
                      (active(Fault::kLoss) != nullptr && chance(0.4));
    if (lost) return;
    if (active(Fault::kDuplicates) != nullptr && chance(0.5)) {
      // The last datagrams once more: they arrive, and nothing advances.
      robot_.report(now_ns_, robot_s_ - 0.02);
      return;
    }
    const RobotState before = state;
    robot_.report(now_ns_, robot_s_);
    if (const Event* event = active(Fault::kOneStreamStops)) keep_stream(before, event->part);
    spoil(state);
  }

  void keep_stream(const RobotState& before, int part) {
    RobotState& state = robot_.state;
    switch (part) {
      case 0:
        state.measured_js = before.measured_js;
        break;
      case 1:
        state.measured_cp = before.measured_cp;
        break;
      case 2:
        state.setpoint_cp = before.setpoint_cp;
        break;
      case 3:
        state.local_measured_cp = before.local_measured_cp;
        break;
      case 4:
        state.jaw_measured_js = before.jaw_measured_js;
        break;
      case 5:
        state.operating_state = before.operating_state;
        break;
      default:
        state.old_shapes_only = part == 6;
    }
  }

  void spoil(RobotState& state) {
    using State = OperatingState::State;
    OperatingState& operating = state.operating_state.payload;
    operating.state = State::kEnabled;
    operating.is_homed = true;
    operating.is_busy = active(Fault::kBusy) != nullptr;
    if (active(Fault::kUnhomed) != nullptr) operating.is_homed = false;
    if (active(Fault::kDisabled) != nullptr) operating.state = State::kDisabled;
    if (active(Fault::kRobotFault) != nullptr) operating.state = State::kFault;
    CartesianPose* const poses[] = {&state.measured_cp.payload, &state.setpoint_cp.payload,
                                    &state.local_measured_cp.payload};
    if (const Event* event = active(Fault::kNotFinite)) spoil_number(state, event->part);
    if (const Event* event = active(Fault::kInvalid)) poses[event->part % 3]->valid = false;
    if (const Event* event = active(Fault::kSkewed))
      poses[event->part % 3]->rotation *= 1 + 1e-4 * event->size;
    if (const Event* event = active(Fault::kTimestampBack))
      poses[event->part % 3]->timestamp_s -= 0.5 + event->size;
    if (const Event* event = active(Fault::kNullJoints))
      (event->part % 2 == 0 ? state.measured_js : state.jaw_measured_js).payload.count =
          event->part;
    if (const Event* event = active(Fault::kSetpointJump))
      state.setpoint_cp.payload.translation[event->part % 3] += 0.008 * event->size;
    if (const Event* event = active(Fault::kSetpointDrift))
      state.setpoint_cp.payload.translation[event->part % 3] +=
          0.0004 * event->size * (tick_ - event->from);
    if (const Event* event = active(Fault::kLag)) {
      state.measured_cp.payload.timestamp_s += 1e-4;  // read at another moment than the joints
      state.measured_cp.payload.translation[event->part % 3] += 0.01 * event->size;
    }
    if (const Event* event = active(Fault::kEffort)) {
      const auto joint = static_cast<std::size_t>(event->part % 6);
      state.measured_js.payload.effort[joint] =
          -1.4 * event->size * setup_.mount.instrument->effort_limits[joint];
    }
    if (const Event* event = active(Fault::kOtherInstrument))
      state.local_measured_cp.payload.translation.z() -= 0.05 * event->size;
    if (const Event* event = active(Fault::kOtherBase))
      state.measured_cp.payload.translation.x() += 0.02 * event->size;
    if (active(Fault::kCannula) != nullptr) stand_in_cannula(state);
    if (const Event* event = active(Fault::kLeftVelocity))
      state.setpoint_js.payload.velocity[static_cast<std::size_t>(event->part % 6)] = event->size;
  }

  void spoil_number(RobotState& state, int part) {
    double* const numbers[] = {
        &state.measured_cp.payload.translation[0],       &state.setpoint_cp.payload.translation[1],
        &state.local_measured_cp.payload.translation[2], &state.setpoint_cp.payload.rotation(1, 2),
        &state.measured_js.payload.position[3],          &state.jaw_measured_js.payload.position[0],
        &state.jaw_setpoint_js.payload.position[0],      &state.measured_js.payload.effort[1]};
    *numbers[part] = not_finite();
  }

  void stand_in_cannula(RobotState& state) {
    PsmJoints q = robot_.joints();
    q[2] = 0.05 + 0.4162 - setup_.mount.instrument->tool_length;
    const PsmPose pose = psm_forward(q, *setup_.mount.instrument);
    std::copy(q.begin(), q.end(), state.measured_js.payload.position.begin());
    state.local_measured_cp.payload.rotation = pose.R;
    state.local_measured_cp.payload.translation = pose.p;
    state.measured_cp.payload.rotation = setup_.X_AR.linear() * pose.R;
    state.measured_cp.payload.translation = setup_.X_AR * pose.p;
  }

  double not_finite() {
    return chance(0.5) ? std::numeric_limits<double>::quiet_NaN()
                       : std::numeric_limits<double>::infinity();
  }

  PolicyRequest ask() {
    PolicyRequest request;
    if (active(Fault::kPolicyStalls) != nullptr || chance(0.03)) return request;
    if (memory_.phase == SafetyPhase::kActive) {
      if (chance(0.05)) direction_ = Vector3d(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
      if (withdraws_) direction_ = Vector3d(0.3 * direction_.x(), 0.3 * direction_.y(), 1);
      tip_ += 0.0005 * direction_;
      if (const Event* event = active(Fault::kPolicyLeaps))
        tip_[event->part % 3] += 0.002 * event->size;
      if (const Event* event = active(Fault::kPolicyDrifts))
        direction_ = Vector3d::Unit(event->part % 3) * (event->part < 4 ? 1 : -1);
      if (active(Fault::kPolicyJaw) != nullptr) jaw_ = uniform(-3, 3);
    }
    request.fresh = true;
    request.looked = true;
    if (active(Fault::kNoWay) != nullptr) request.obstacle = {StopReason::kNoWay, 0.5, 1.5, 3};
    request.command = goal();
    spoil(request.command);
    return request;
  }

  void spoil(RobotCommand& command) {
    if (const Event* event = active(Fault::kPolicyNotFinite)) {
      double* const numbers[] = {&command.translation[1], &command.rotation(2, 0), &command.jaw,
                                 &command.joints[4]};
      *numbers[event->part % 4] = not_finite();
    }
    if (const Event* event = active(Fault::kPolicyTurns)) {
      const Eigen::AngleAxisd turn(0.3 * event->size, Vector3d::Unit(event->part % 3));
      command.rotation = command.rotation * turn;
      command.joints[3 + static_cast<std::size_t>(event->part % 3)] += 0.3 * event->size;
    }
    if (const Event* event = active(Fault::kPolicyRolls)) {
      // About the jaw, which leaves the tip where it is, a little more each period.
      const double angle = 0.08 * event->size * (tick_ - event->from + 1);
      command.rotation = command.rotation * Eigen::AngleAxisd(angle, Vector3d::UnitZ());
    }
    if (const Event* event = active(Fault::kPolicyScales))
      command.rotation *= 1 + 1e-6 * (event->size - 0.5);
    if (const Event* event = active(Fault::kPolicyVelocity)) {
      command.velocity[event->part % 3] = 0.05 * event->size;
      command.joint_velocity[static_cast<std::size_t>(event->part % 6)] = event->size;
    }
    if (active(Fault::kPolicyHolds) != nullptr) command.kind = RobotCommand::Kind::kHold;
    if (const Event* event = active(Fault::kPolicyToCentre)) {
      const Vector3d p_RC(0, 0, -0.05 * event->size * event->size);
      command.kind = RobotCommand::Kind::kServoCp;
      command.rotation =
          setup_.X_AR.linear() * setup_.mount.X_WR.linear().transpose() * setup_.mount.R_WC;
      command.translation = setup_.X_AR * (event->size < 0.1 ? Vector3d::Zero() : p_RC);
    }
    if (const Event* event = active(Fault::kPolicyFar)) {
      const Vector3d corner(-0.0914, 0.11, 0.002 + 0.05 * event->size);
      const Isometry3d X_AW = setup_.X_AR * setup_.mount.X_WR.inverse();
      command.kind = RobotCommand::Kind::kServoCp;
      command.translation = X_AW * setup_.mount.control_point(corner);
    }
  }

  void operate() {
    if (active(Fault::kKeyReleased) == nullptr) events_now_.held_ns = now_ns_;
    events_now_.fault = active(Fault::kGatewayFault) != nullptr;
    if (active(Fault::kOperatorStops) != nullptr) events_now_.stop_ns = now_ns_;
    const bool at_random = active(Fault::kArmAtRandom) != nullptr && chance(0.5);
    if (tick_ >= arm_at_ && memory_.phase == SafetyPhase::kReady) {
      events_now_.arm_ns = now_ns_;
      arm_at_ = tick_ + 8;
    } else if (at_random) {
      events_now_.arm_ns = now_ns_ - static_cast<std::int64_t>(uniform(-1e9, 1e9));
    }
    if (memory_.phase == SafetyPhase::kStopped && chance(0.1)) {
      events_now_.acknowledge_ns = now_ns_;
      robot_.state.source.port = 40000;
    }
  }

  void step(Tally& tally) {
    move_clock();
    receive();
    operate();
    // A new start: the policy begins where the arm stands.
    if (memory_.phase != SafetyPhase::kActive || memory_.holding) {
      const PsmPose pose = psm_forward(robot_.joints(), *setup_.mount.instrument);
      tip_ = setup_.mount.tip(setup_.mount.X_WR * pose.p);
    }
    const PolicyRequest request = ask();
    if (tick_ == 0 && chance(0.01)) robot_.state.has_source = false;
    const Finding held = must_hold(setup_, memory_, robot_.state, events_now_, now_ns_);
    const Judgement judged = judge(setup_, memory_, robot_.state, request, events_now_, now_ns_);
    if (held && !(judged.stopped_now && judged.finding.reason == held.reason))
      tally.note_unsafe(number_, tick_, "a look would hold, the period does not");
    const char* wrong = witness_.judge(robot_.state, events_now_, now_ns_,
                                       judged.send ? &judged.command : nullptr, judged.stopped_now);
    robot_.state.has_source = true;
    if (wrong == nullptr) wrong = holds_.judge(judged, events_now_);
    if (wrong != nullptr) tally.note_unsafe(number_, tick_, wrong);
    const auto reason = static_cast<std::size_t>(judged.finding.reason);
    ++(judged.stopped_now ? tally.stopped : tally.waited)[reason];
    memory_ = judged.memory;
    if (judged.send && active(Fault::kRobotDeaf) == nullptr && !chance(0.01))
      robot_.obey(judged.command);
  }

  std::uint64_t number_;
  RandomStream draws_;
  bool by_joints_ = false, large_box_ = false, withdraws_ = false;
  SafetySetup setup_;
  Vector3d tip_ = Vector3d::Zero();
  test::IdealRobot robot_;
  test::Witness witness_;
  SafetyMemory memory_;
  GatewayEvents events_now_;
  std::vector<Event> events_;
  Vector3d direction_ = Vector3d::Zero();
  double jaw_ = 0.5;
  int tick_ = 0, arm_at_ = 0;
  test::HoldLaw holds_;
  std::int64_t now_ns_ = 5'000'000'000;
  double robot_s_ = 100;
};

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  return omentum::test::run_scripts<omentum::FaultScript>("fault_scripts", argc, argv);
}
