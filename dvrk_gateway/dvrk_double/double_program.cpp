#include "dvrk_gateway/dvrk_double/double_program.h"

#include <fmt/format.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "core/check.h"
#include "core/constants.h"
#include "core/csv.h"
#include "core/log.h"

namespace omentum {
namespace {

constexpr int kPriority = 70;  // below the gateway's control loop

struct OperatorCommand {
  const char* name;
  const char* help;
  void (*run)(DvrkDouble&);
};

/// Those that need nothing but the robot.
constexpr OperatorCommand kCommands[] = {
    {"power", "DISABLED -> ENABLED", [](DvrkDouble& r) { r.arm().power(); }},
    {"disable", "-> DISABLED", [](DvrkDouble& r) { r.arm().disable(); }},
    {"pause", "ENABLED -> PAUSED", [](DvrkDouble& r) { r.arm().pause(); }},
    {"home", "home, engage adapter and tool", [](DvrkDouble& r) { r.arm().home(); }},
    {"unhome", "forget the homing", [](DvrkDouble& r) { r.arm().unhome(); }},
    {"fault", "-> FAULT", [](DvrkDouble& r) { r.arm().fault(); }},
    {"recover", "FAULT or PAUSED -> ENABLED", [](DvrkDouble& r) { r.arm().recover(); }},
    {"silent", "the stream stops", [](DvrkDouble& r) { r.set_silent(true); }},
    {"speak", "the stream goes on", [](DvrkDouble& r) { r.set_silent(false); }},
    {"timestamps", "Timestamps begin at 0", [](DvrkDouble& r) { r.restart_timestamps(); }},
};

/// A command and the stream behind it, empty without one.
std::pair<std::string, std::string> split(const std::string& command) {
  const std::size_t blank = std::min(command.find(' '), command.size());
  return {command.substr(0, blank), command.substr(std::min(blank + 1, command.size()))};
}

/// Why a line is no command.
Result<void> check_command(const std::string& command) {
  const auto is_word = [](const std::string& word, auto... words) {
    return ((word == words) || ...);
  };
  const auto [word, stream] = split(command);
  if (is_word(word, "missing", "invalid", "not-finite")) {
    if (stream.empty() ||
        std::find(kStreamNames.begin(), kStreamNames.end(), stream) != kStreamNames.end())
      return {};
    return Failure{
        fmt::format("{}: no such stream, allowed {}", command, fmt::join(kStreamNames, ", "))};
  }
  if (word == "carry") {
    const std::optional<double> roll_deg = stream.empty() ? 0 : parse_number(stream);
    if (roll_deg && std::abs(*roll_deg) <= 260) return {};
    return Failure{fmt::format("{}: roll of the tool in degrees, allowed -260 ... 260", command)};
  }
  const bool known =
      is_word(command, "place", "lay", "restart", "steal", "foreign", "state", "quit") ||
      std::any_of(std::begin(kCommands), std::end(kCommands),
                  [&](const OperatorCommand& one) { return command == one.name; });
  if (known) return {};
  return Failure{fmt::format("{}: no such command, see --help", command)};
}

}  // namespace

std::string DoubleProgram::commands_help() {
  std::string help;
  for (const OperatorCommand& command : kCommands)
    help += fmt::format("  {:11}{}\n", command.name, command.help);
  return help +
         "  place      move the tip over the middle of the scene's workspace, turned as the "
         "scene's\n"
         "  carry      the same with the tool in its own orientation: roll and wrist as they "
         "stand\n"
         "  carry R    the same with the tool as it was homed: wrist straight, roll R degrees\n"
         "  lay        lay the tissue anew, as between two trials\n"
         "  restart    another robot process: other port, Timestamps from 0, not homed\n"
         "  steal      a second sender speaks to the robot and gets the stream\n"
         "  foreign    a second sender speaks to the client as a robot; again: it ends\n"
         "  missing S, invalid S, not-finite S   a stream; without one: as before\n"
         "  state      print state, joints and tip\n"
         "  quit\n";
}

DoubleProgram::DoubleProgram(const DoubleProgramOptions& options)
    : options_(options),
      client_(resolve_address("--to", options.host, options.port)),
      stranger_(0) {
  for (const std::string& text : options_.at) {
    const std::size_t blank = text.find(' ');
    const std::optional<double> time_s = parse_number(text.substr(0, blank));
    if (blank == std::string::npos || !time_s || !(*time_s >= 0))
      throw_error("--at {}: expected \"SECONDS COMMAND\", as in \"5 fault\"", text);
    script_.push_back({*time_s, text.substr(blank + 1)});
    if (const Result<void> can = check_command(script_.back().command); !can)
      throw_error("--at {}", can.error());
  }
  std::stable_sort(script_.begin(), script_.end(),
                   [](const Timed& a, const Timed& b) { return a.time_s > b.time_s; });
  start_robot();
  if (options_.tissue) tissue_.emplace(options_.tissue);
}

void DoubleProgram::start_robot() {
  network_.reset();
  socket_ = std::make_unique<UdpSocket>(0);
  if (options_.network.any()) {
    network_ = std::make_unique<DisturbedLink>(*socket_, clock_, options_.network, options_.network,
                                               options_.seed);
  }
  robot_.emplace(options_.robot, options_.effects, options_.mount, client_);
  told_ = {};
  told_refusals_ = {};
  log().info("sends to {} from port {}", to_string(client_), socket_->port());
}

Result<void> DoubleProgram::execute(const std::string& command) {
  if (Result<void> can = check_command(command); !can) return can;
  for (const OperatorCommand& known : kCommands) {
    if (command == known.name) known.run(*robot_);
  }
  const auto [word, stream] = split(command);
  if (word == "missing") robot_->options().missing_stream = stream;
  if (word == "invalid") robot_->options().invalid_stream = stream;
  if (word == "not-finite") robot_->options().not_finite_stream = stream;
  if (word == "restart") restart_asked_ = true;  // by the next period
  if (word == "place") place_arm();
  if (word == "carry") {
    const std::optional<double> roll_deg = parse_number(stream);
    carry_arm(roll_deg ? std::optional(kDegree * *roll_deg) : std::nullopt);
  }
  if (word == "lay" && tissue_) tissue_->lay();
  if (word == "steal") stranger_.send("{}", {INADDR_LOOPBACK, socket_->port()});
  if (word == "foreign") foreign_ = !foreign_;
  if (word == "state") tell_state();
  if (word == "quit") quit_ = true;
  return {};
}

void DoubleProgram::place_arm() {
  const Eigen::Vector3d middle =
      0.5 * (options_.mount.workspace_min + options_.mount.workspace_max);
  const Result<PsmJoints> q = joints_for_tip(options_.mount, middle);
  if (!q) return log().warn("the middle of the workspace is out of reach: {}", q.error());
  move_by_hand(q.value());
}

/// Shoulder and insertion alone lead the tip; roll and wrist stay, or the wrist is straight and the
/// tool rolled so far.
void DoubleProgram::carry_arm(std::optional<double> roll_rad) {
  const ToolMount& mount = options_.mount;
  const PsmInstrument& instrument = *mount.instrument;
  const Eigen::Vector3d middle = 0.5 * (mount.workspace_min + mount.workspace_max);
  const Eigen::Vector3d p_RT = mount.X_WR.inverse() * middle;
  PsmJoints q{0, 0, 0, roll_rad.value_or(0), 0, 0};
  const JointState stands = robot_->arm().setpoint_js();
  if (!roll_rad) std::copy_n(stands.position.begin() + 3, 3, q.begin() + 3);
  // The shaft points from the remote centre at `aim`. A bent wrist holds the tip beside the shaft:
  // the aim goes as far to the other side, which changes where beside a little.
  constexpr int kTimes = 100;
  Eigen::Vector3d aim = p_RT, miss;
  for (int k = 0; k < kTimes; ++k) {
    const double wrist_m = aim.norm() - mount.tip_offset - instrument.pitch_to_yaw;
    q[0] = std::atan2(aim.x(), -aim.z());
    q[1] = -std::asin(aim.y() / aim.norm());
    q[2] = wrist_m - psm_wrist_distance(0, instrument);
    const PsmPose pose = psm_forward(q, instrument);
    miss = p_RT - pose.p - mount.tip_offset * pose.R.col(2);
    aim += miss;
  }
  constexpr double kThere_m = 1e-6;
  if (!(miss.norm() < kThere_m))
    return log().warn("the middle of the workspace is out of reach with the tool as it stands");
  move_by_hand(q);
}

void DoubleProgram::move_by_hand(const PsmJoints& q) {
  CommandDatagram by_hand;
  by_hand.known_keys = 1;
  by_hand.move_jp.emplace();
  by_hand.move_jp->goal_count = 6;
  std::copy_n(q.begin(), 6, by_hand.move_jp->goal.begin());
  robot_->arm().command(by_hand);
}

void DoubleProgram::tell_state() {
  const RobotArm& arm = robot_->arm();
  const JointState joints = arm.measured_js();
  const Eigen::Vector3d tip = arm.true_tip();
  std::printf(
      "state=%s sub_state=%s busy=%d homed=%d q=[%s] jaw=%.6g p_WT=[%.6g %.6g %.6g] m held=%d\n",
      operating_state_word(arm.operating_state().state), arm.operating_state().sub_state.data(),
      arm.operating_state().is_busy, arm.operating_state().is_homed,
      fmt::format("{:.6g}",
                  fmt::join(joints.position.begin(), joints.position.begin() + joints.count, " "))
          .c_str(),
      arm.jaw(), tip.x(), tip.y(), tip.z(), tissue_ && tissue_->holds());
  std::fflush(stdout);
}

void DoubleProgram::tell_changes() {
  const RobotArm& arm = robot_->arm();
  if (const OperatingState& now = arm.operating_state(); now != told_) {
    log().info("state={} sub_state={} busy={} homed={}", operating_state_word(now.state),
               now.sub_state.data(), now.is_busy, now.is_homed);
    told_ = now;
  }
  for (std::size_t k = 0; k < told_refusals_.size(); ++k) {
    const std::uint64_t count = arm.refusals(static_cast<Refusal>(k));
    if (count == told_refusals_[k]) continue;
    log().warn("command ignored, reason={} total={}", name_of(static_cast<Refusal>(k)), count);
    told_refusals_[k] = count;
  }
}

void DoubleProgram::read_operator(int input) {
  pollfd waiting{input, POLLIN, 0};
  while (operator_listens_ && poll(&waiting, 1, 0) > 0) {
    std::array<char, 256> memory{};
    const ssize_t size = read(input, memory.data(), memory.size());
    if (size <= 0) {
      operator_listens_ = false;
      return;
    }
    typed_.append(memory.data(), static_cast<std::size_t>(size));
    for (std::size_t end = 0; (end = typed_.find('\n')) != std::string::npos;) {
      const std::string line = typed_.substr(0, end);
      typed_.erase(0, end + 1);
      if (line.empty()) continue;
      if (const Result<void> done = execute(line); !done)
        std::fprintf(stderr, "dvrk_double: %s\n", done.error().c_str());
    }
  }
}

void DoubleProgram::send_foreign() {
  std::array<char, 1024> memory{};
  const std::size_t size = encode_stream("measured_js", robot_->arm().measured_js(), memory);
  stranger_.send({memory.data(), size}, client_);
}

void DoubleProgram::touch_tissue() {
  if (!tissue_ || !robot_->arm().engaged()) return;
  const double time_s = robot_->arm().time_s();
  if (time_s - touched_s_ < tissue_->control_period_s() - 1e-6) return;  // a tick is 7e-4 s
  touched_s_ = time_s;
  robot_->arm().set_load(tissue_->step(robot_->arm().true_tip(), robot_->arm().jaw()));
  robot_->arm().set_jaw_stop(tissue_->jaw_stop_rad());
}

void DoubleProgram::period(double time_s) {
  while (!script_.empty() && script_.back().time_s <= time_s) {
    const Result<void> done = execute(script_.back().command);
    OMENTUM_CHECK(done.has_value(), "{}", done.error());  // checked at the start
    script_.pop_back();
  }
  if (restart_asked_) {
    restart_asked_ = false;
    start_robot();
    started_s_ = time_s;
    touched_s_ = 0;
  }
  Link& link = network_ ? static_cast<Link&>(*network_) : *socket_;
  robot_->period(static_cast<std::int64_t>((time_s - started_s_) * 1e9), link);
  if (foreign_) send_foreign();
  touch_tissue();
  tell_changes();
}

void DoubleProgram::run(const volatile std::sig_atomic_t& stop, int operator_input) {
  // As the process of a real robot does; without the right to it a busy machine delays the periods.
  sched_param priority{};
  priority.sched_priority = kPriority;
  pthread_setschedparam(pthread_self(), SCHED_FIFO, &priority);
  RandomStream random(options_.seed, 1, Purpose::kDynamics, 0);
  const std::int64_t begin_ns = clock_.now_ns();
  const auto time_s = [&] { return 1e-9 * static_cast<double>(clock_.now_ns() - begin_ns); };
  for (std::int64_t due_ns = begin_ns; stop == 0 && !quit_; due_ns += DvrkDouble::kPeriod_ns) {
    std::int64_t late_ns = 0;
    if (options_.period_jitter_s > 0) {
      late_ns = static_cast<std::int64_t>(
          1e9 * uniform_between(random.next(), 0, options_.period_jitter_s));
    }
    clock_.sleep_until(due_ns + late_ns);
    period(time_s());
    read_operator(operator_input);
    // Datagrams that the network holds back leave between the periods.
    for (int k = 1; network_ && k < 10; ++k) {
      clock_.sleep_until(due_ns + k * DvrkDouble::kPeriod_ns / 10);
      network_->flush();
    }
    if (options_.seconds > 0 && time_s() >= options_.seconds) break;
    // Periods that a busy machine missed are left out, as the robot's own task does.
    for (; due_ns + DvrkDouble::kPeriod_ns < clock_.now_ns(); due_ns += DvrkDouble::kPeriod_ns)
      ++missed_periods_;
  }
  log().info("ends: sent={} not_sent={} received={} cut={} missed_periods={}", robot_->sent(),
             robot_->not_sent(), robot_->received(), robot_->cut(), missed_periods_);
}

}  // namespace omentum
