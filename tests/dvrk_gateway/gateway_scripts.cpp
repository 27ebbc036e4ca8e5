// Random scripts against the whole gateway in simulated time: gateway_scripts N [FIRST=0]. Control
// loop, codec, safety function and guide on one side, the double behind a bad network on the other;
// robot, network, clock, operator and policy do right and wrong at random. A witness judges every
// datagram that leaves the gateway. Output and exit code as fault_scripts.
#include <vector>

#include "core/rng.h"
#include "dvrk_gateway/backend/arm_guide.h"
#include "tests/dvrk_gateway/gateway_faults.h"
#include "tests/dvrk_gateway/ideal_robot.h"
#include "tests/dvrk_gateway/script_tally.h"
#include "tests/dvrk_gateway/two_sides.h"
#include "tests/dvrk_gateway/witness.h"

namespace omentum {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using test::Event;
using test::Fault;
using test::kFaults;
using test::Tally;
using test::TwoSides;

constexpr double kJawClosed = -0.2, kJawOpen = 0.7;  // rad
constexpr std::int64_t kPeriod = 20'000'000;

class GatewayScript final : public ControlPort {
 public:
  explicit GatewayScript(std::uint64_t number)
      : number_(number),
        draws_(number, 1, Purpose::kReset, 0),
        events_(random_events()),
        setup_(random_setup()),
        sides_(robot_options(), random_effects(), setup_.mount, random_network(), number),
        loop_(sides_.gateway_link, clock_, setup_),
        witness_(setup_) {}

  void run(Tally& tally) {
    tally_ = &tally;
    bring_robot();
    loop_.receive();
    ArmGuide guide(*this, setup_, {.turn_step_rad = 0.015, .clearance_m = 0.001});
    while (!ended()) act(guide);
    tally.armed += armed_ ? 1 : 0;
  }

  /// A request that comes late is taken in a later period, as RealTimeLoop does.
  const Period& exchange(const PolicyRequest& request) override {
    while (!ended() && request.fresh && (active(Fault::kPolicyStalls) != nullptr || chance(0.01)))
      run_period({});
    return run_period(request);
  }
  const Period& period() const override { return loop_.period(); }
  bool ended() const override { return tick_ >= ticks_; }

 private:
  const Period& run_period(PolicyRequest request) {
    spoil(request);
    operate();
    judge_period(loop_.send(request, operator_));
    ++tick_;
    for (const Event& event : events_) disturb(event);
    move_clock();
    return loop_.receive();
  }

  double uniform(double min, double max) { return uniform_between(draws_.next(), min, max); }
  bool chance(double share) { return uniform(0, 1) < share; }
  std::uint32_t below(std::uint32_t bound) { return bounded(draws_.next(), bound); }
  const Event* active(Fault fault) const {
    for (const Event& event : events_) {
      if (event.fault == fault && tick_ >= event.from && tick_ < event.until) return &event;
    }
    return nullptr;
  }
  bool has(Fault fault) const {
    return std::any_of(events_.begin(), events_.end(),
                       [&](const Event& event) { return event.fault == fault; });
  }

  // ---- what a script is ------------------------------------------------------------------------

  /// The first fault by the number, so that a few hundred scripts have each of them.
  std::vector<Event> random_events() {
    std::vector<Event> events(1 + below(3));
    for (Event& event : events) {
      event.fault = static_cast<Fault>(below(static_cast<std::uint32_t>(kFaults - 3)));
      event.from = chance(0.8) ? 25 + static_cast<int>(below(60)) : static_cast<int>(below(25));
      event.until = event.from + 1 + static_cast<int>(chance(0.5) ? below(3) : below(50));
      event.size = uniform(0, 1);
      event.part = below(8);
    }
    events[0].fault = static_cast<Fault>(number_ % static_cast<std::uint64_t>(kFaults + 4));
    return events;
  }

  SafetySetup random_setup() {
    pb::SafetyLimits limits;
    if (chance(0.2) || has(Fault::kKeyReleased)) limits.set_dead_man(true);
    ToolMount mount = test::paper_mount(psm_instruments()[below(12)]);
    if (chance(0.1) || has(Fault::kPolicyToCentre)) {  // centre and cannula inside
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
    return make_safety_setup(limits, mount, X_AR, !has(Fault::kNotRegistered));
  }

  DoubleOptions robot_options() {
    DoubleOptions options;
    options.X_AR = setup_.X_AR;
    options.hardware_like = has(Fault::kStartsInCannula);
    if (has(Fault::kOldShapes)) options.shape = DoubleOptions::Shape::k2019;
    return options;
  }

  pb::ArmEffects random_effects() {
    pb::ArmEffects effects;
    if (has(Fault::kLoad)) effects.set_servo_compliance(1);
    if (!chance(0.4)) return effects;
    effects.set_transport_delay_s(uniform(0, 0.02));
    effects.mutable_droop_s()->set_yaw(uniform(0, 0.05));
    effects.mutable_droop_s()->set_insertion(uniform(0, 0.05));
    effects.mutable_coulomb_friction()->set_pitch(uniform(0, 0.3));
    effects.mutable_backlash()->set_wrist_pitch(uniform(0, 0.02));
    effects.mutable_joint_offset()->set_insertion(uniform(-0.002, 0.002));
    return effects;
  }

  Disturbance random_network() {
    Disturbance network;
    if (!chance(0.4)) return network;
    network.loss = uniform(0, 0.1);
    network.duplication = uniform(0, 0.1);
    network.reordering = uniform(0, 0.1);
    network.jitter_s = uniform(0, 0.005);
    return network;
  }

  /// To a place that the arm reaches; the gateway has heard nothing of it.
  void bring_robot() {
    Result<PsmJoints> joints = Failure{""};
    while (!joints) {
      tip_ = Vector3d(uniform(-0.05, 0.05), uniform(-0.05, 0.09), uniform(0.02, 0.1));
      joints = joints_for_tip(setup_.mount, tip_);
    }
    PsmJoints goal = joints.value();
    if (has(Fault::kStartsInCannula)) goal[2] = 0.02;
    sides_.bring_to(goal);
    std::array<char, 4096> memory{};
    while (sides_.gateway_link.receive(memory)) {
    }
    ticks_ = 60 + static_cast<int>(below(80));
    next_ns_ = clock_.now_ns();
  }

  // ---- right -----------------------------------------------------------------------------------

  /// One episode of the policy: to a start close by, then at random.
  void act(ArmGuide& guide) {
    while (!guide.measures()) {
      if (!guide.watch()) return;
    }
    const Vector3d aside(uniform(-0.002, 0.002), uniform(-0.002, 0.002), uniform(-0.001, 0.001));
    tip_ = inside(guide.measured_tip() + aside);
    if (!guide.go_to(tip_)) return;
    Vector3d direction = Vector3d::Zero();
    const int steps = static_cast<int>(below(100));
    for (int k = 0; k < steps; ++k) {
      if (k == 0 || chance(0.05))
        direction = Vector3d(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
      tip_ = inside(tip_ + 0.0005 * direction);
      if (!guide.follow(tip_, chance(0.5) ? kJawClosed : kJawOpen)) return;
    }
    (void)guide.hold();
  }
  Vector3d inside(const Vector3d& p_WT) const {
    return p_WT.cwiseMax(setup_.mount.workspace_min).cwiseMin(setup_.mount.workspace_max);
  }

  void operate() {
    const std::int64_t now_ns = clock_.now_ns();
    const SafetyPhase phase = loop_.period().judgement.memory.phase;
    if (active(Fault::kKeyReleased) == nullptr) operator_.held_ns = now_ns;
    operator_.fault = active(Fault::kGatewayFault) != nullptr;
    if (active(Fault::kOperatorStops) != nullptr) operator_.stop_ns = now_ns;
    if (phase == SafetyPhase::kReady && number_ % 13 != 0) operator_.arm_ns = now_ns;
    if (active(Fault::kArmAtRandom) != nullptr)
      operator_.arm_ns = now_ns - static_cast<std::int64_t>(uniform(-1e9, 1e9));
    if (phase == SafetyPhase::kStopped && chance(0.1)) operator_.acknowledge_ns = now_ns;
  }

  void judge_period(const Period& period) {
    const Judgement& judged = period.judgement;
    armed_ |= judged.memory.phase == SafetyPhase::kActive;
    ++(judged.stopped_now ? tally_->stopped
                          : tally_->waited)[static_cast<std::size_t>(judged.finding.reason)];
    const auto& sent = sides_.gateway_link.sent;
    std::optional<RobotCommand> command;
    const char* wrong = nullptr;
    if (sent.size() != seen_ + (judged.send ? 1 : 0)) wrong = "not one datagram per command";
    if (sent.size() > seen_) {
      command = test::command_of(sent.back().text);
      if (!command) wrong = "a datagram that is no command";
      if (sent.back().address != period.robot.source) wrong = "not to the robot";
    }
    seen_ = sent.size();
    const char* unsafe = witness_.judge(period.robot, operator_, clock_.now_ns(),
                                        command ? &*command : nullptr, judged.stopped_now);
    if (wrong == nullptr) wrong = unsafe;
    if (wrong == nullptr) wrong = holds_.judge(judged, operator_);
    if (wrong != nullptr) tally_->note_unsafe(number_, tick_, wrong);
  }

  // ---- wrong: the policy -----------------------------------------------------------------------

  void spoil(PolicyRequest& request) {
    if (request.looked && active(Fault::kNoWay) != nullptr)
      request.obstacle = {StopReason::kNoWay, 4.4, -1.5, 3};
    if (!request.fresh) return;
    RobotCommand& command = request.command;
    if (active(Fault::kPolicyHolds) != nullptr) command.kind = RobotCommand::Kind::kHold;
    if (command.kind == RobotCommand::Kind::kHold) return;
    const Isometry3d X_AW = setup_.X_AR * setup_.mount.X_WR.inverse();
    if (const Event* event = active(Fault::kPolicyLeaps))
      command.translation += X_AW.linear() * (0.002 * event->size * axis(*event));
    if (const Event* event = active(Fault::kPolicyTurns))
      command.rotation =
          command.rotation * Eigen::AngleAxisd(0.3 * event->size, axis(*event)).matrix();
    if (const Event* event = active(Fault::kPolicyRolls)) {
      const double angle = 0.08 * event->size * (tick_ - event->from + 1);
      command.rotation = command.rotation * Eigen::AngleAxisd(angle, Vector3d::UnitZ()).matrix();
    }
    if (const Event* event = active(Fault::kPolicyFar)) {
      const Vector3d corner(-0.0914, 0.11, 0.002 + 0.05 * event->size);
      command.translation = X_AW * setup_.mount.control_point(corner);
    }
    if (active(Fault::kPolicyOutside) != nullptr) {
      const Vector3d above = setup_.mount.workspace_max + Vector3d(-0.05, -0.05, 0.0005);
      command.translation = X_AW * setup_.mount.control_point(above);
    }
    if (const Event* event = active(Fault::kPolicyToCentre)) {
      const double depth = event->part < 4 ? 0.0 : 0.05 * event->size;
      command.translation = setup_.X_AR * Vector3d(0, 0, -depth);
    }
    if (by_joints_) turn_to_joints(command);
    if (const Event* event = active(Fault::kPolicyScales))
      command.rotation *= 1 + 1e-6 * (event->size - 0.5);
    if (const Event* event = active(Fault::kPolicyVelocity)) {
      command.velocity = 0.05 * event->size * axis(*event);
      command.joint_velocity[event->part % 6] = event->size;
    }
    if (const Event* event = active(Fault::kPolicyNotFinite)) {
      double* const numbers[] = {&command.translation[1], &command.rotation(2, 0), &command.jaw,
                                 &command.joints[4]};
      *numbers[event->part % 4] =
          event->part < 4 ? std::nan("") : std::numeric_limits<double>::infinity();
    }
  }
  static Vector3d axis(const Event& event) {
    return Vector3d::Unit(static_cast<Eigen::Index>(event.part % 3));
  }
  void turn_to_joints(RobotCommand& command) const {
    const Isometry3d X_RA = setup_.X_AR.inverse();
    const InverseSolution solution =
        psm_solve({X_RA.linear() * command.rotation, X_RA * command.translation},
                  loop_.period().robot.measured_js.payload.position[3], *setup_.mount.instrument);
    if (solution.fault != InverseFault::kNone) return;
    command.kind = RobotCommand::Kind::kServoJp;
    command.joints = solution.q;
  }

  // ---- wrong: the clock and the robot ----------------------------------------------------------

  void move_clock() {
    next_ns_ += kPeriod;
    std::int64_t until_ns = next_ns_ + static_cast<std::int64_t>(uniform(0, 3e6));
    if (const Event* late =
            active(Fault::kTickLate)) {  // the gateway stands still: it does not look
      until_ns += static_cast<std::int64_t>(2e8 * late->size);
      clock_.sleep_until(until_ns);
    }
    if (active(Fault::kTickBurst) != nullptr) until_ns = clock_.now_ns() + kPeriod / 8;
    while (sleep_looking(loop_, clock_, until_ns, [this] { return operator_; })) {
      judge_period(loop_.period());
      until_ns = next_ns_ = loop_.period().began_ns + kPeriod;
    }
    next_ns_ = std::max(next_ns_, clock_.now_ns() - 3'000'000);
    if (const Event* back = active(Fault::kClockBack)) {
      const auto by_ns = static_cast<std::int64_t>(3e9 * back->size);
      clock_.offset_ns -= by_ns;
      next_ns_ -= by_ns;
    }
  }

  void disturb(const Event& event) {
    DvrkDouble& robot = sides_.robot();
    const bool begins = tick_ == event.from, ends = tick_ == event.until;
    if (!begins && !ends && event.fault != Fault::kGarbage && event.fault != Fault::kForeign)
      return;
    const std::string stream(kStreamNames[event.part % kStreamNames.size()]);
    switch (event.fault) {
      case Fault::kSilence:
        return robot.set_silent(begins);
      case Fault::kTheft:
        return begins ? robot.steal(test::kStranger) : void();
      case Fault::kThiefMoves:
        if (!begins) return;
        robot.steal(test::kStranger);
        return shift_joint(event);
      case Fault::kRestart:
        return begins ? sides_.restart() : void();
      case Fault::kRobotFault:
        return begins ? robot.arm().fault() : robot.arm().recover();
      case Fault::kDisabled:
        return begins ? robot.arm().disable() : robot.arm().power();
      case Fault::kPaused:
        return begins ? robot.arm().pause() : robot.arm().recover();
      case Fault::kUnhomed:
        return begins ? robot.arm().unhome() : robot.arm().home();
      case Fault::kMissing:
        robot.options().missing_stream = begins ? stream : "";
        return;
      case Fault::kInvalid:
        robot.options().invalid_stream = begins ? stream : "";
        return;
      case Fault::kNotFinite:
        robot.options().not_finite_stream = begins ? stream : "";
        return;
      case Fault::kTimestamps:
        return begins ? robot.restart_timestamps() : void();
      case Fault::kMove:
        return begins ? robot.arm().command(
                            decode_commands(R"({"move_jp":{"Goal":[0.1,0.1,0.15,0,0,0]}})"))
                      : void();
      case Fault::kConsoleServo:
        return begins ? shift_joint(event) : void();
      case Fault::kCannula:
        return begins ? withdraw() : void();
      case Fault::kLoad:
        return robot.arm().set_load(begins ? Vector3d(30 * axis(event)) : Vector3d::Zero());
      case Fault::kDeaf:
        sides_.deaf = begins;
        return;
      case Fault::kLeftVelocity:  // of a client that was here before, and is gone
        return begins ? leave_velocity() : void();
      case Fault::kForeign:
        if (active(Fault::kForeign) != &event) return;
        return sides_.tell_gateway(R"({"measured_js":{"Position":[0],"Valid":true}})",
                                   test::kStranger);
      case Fault::kGarbage:
        return tell_garbage();
      default:
        if (begins) sides_.tamper = test::tampering(event);
        if (ends) sides_.tamper = nullptr;
    }
  }
  void leave_velocity() {
    CommandDatagram command;
    command.known_keys = 1;
    command.servo_jp = JointGoal{};
    command.servo_jp->goal_count = command.servo_jp->velocity_count = 6;
    const JointState at = sides_.robot().arm().setpoint_js();
    std::copy_n(at.position.begin(), 6, command.servo_jp->goal.begin());
    command.servo_jp->velocity.fill(0.05);
    sides_.robot().arm().command(command);
  }
  void shift_joint(const Event& event) {
    CommandDatagram command;
    command.known_keys = 1;
    command.servo_jp = JointGoal{};
    command.servo_jp->goal_count = 6;
    const JointState at = sides_.robot().arm().setpoint_js();
    std::copy_n(at.position.begin(), 6, command.servo_jp->goal.begin());
    command.servo_jp->goal[event.part % 6] += 0.02 * (event.size - 0.5);
    sides_.robot().arm().command(command);
  }
  /// Between two periods of the streamer: as one motion.
  void withdraw() {
    RobotArm& arm = sides_.robot().arm();
    const double target = 0.05 + 0.4162 - setup_.mount.instrument->tool_length;
    for (int k = 0; k < 5; ++k) {
      CommandDatagram command;
      command.known_keys = 1;
      command.servo_jp = JointGoal{};
      command.servo_jp->goal_count = 6;
      const JointState at = arm.setpoint_js();
      std::copy_n(at.position.begin(), 6, command.servo_jp->goal.begin());
      command.servo_jp->goal[2] = std::max(target, at.position[2] - 0.045);
      arm.command(command);
      arm.tick();
    }
  }
  void tell_garbage() {
    std::string bytes(below(200), '{');
    for (char& byte : bytes) byte = static_cast<char>(below(256));
    sides_.tell_gateway(bytes, test::kRobot);
    sides_.tell_gateway(std::string(70'000, 'x'), test::kRobot);
    sides_.tell_gateway("", test::kRobot);
  }

  std::uint64_t number_;
  RandomStream draws_;
  bool by_joints_ = false;
  std::vector<Event> events_;
  SafetySetup setup_;
  TwoSides sides_;
  test::GatewayClock clock_{sides_};
  ControlLoop loop_;
  test::Witness witness_;
  test::HoldLaw holds_;
  GatewayEvents operator_;
  Vector3d tip_ = Vector3d::Zero();
  Tally* tally_ = nullptr;
  int tick_ = 0, ticks_ = 0;
  std::int64_t next_ns_ = 0;
  std::size_t seen_ = 0;  ///< datagrams
  bool armed_ = false;
};

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  return omentum::test::run_scripts<omentum::GatewayScript>("gateway_scripts", argc, argv);
}
