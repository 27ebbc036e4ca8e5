#include "dvrk_gateway/gateway_program.h"

#include <fmt/core.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <csignal>
#include <memory>
#include <thread>

#include "core/checkpoint_file.h"
#include "core/clock.h"
#include "core/config.h"
#include "core/log.h"
#include "core/policy.h"
#include "core/registration_file.h"
#include "core/rollout.h"
#include "core/touched_points.h"
#include "dvrk_gateway/backend/twin_backend.h"
#include "dvrk_gateway/loop/real_time_loop.h"
#include "dvrk_gateway/operator_keys.h"
#include "dvrk_gateway/protocol/udp_socket.h"
#include "dvrk_gateway/robot_report.h"
#include "sim_worker/backend/image_source.h"

namespace omentum {
namespace {

// Signals are for scripts and foot pedals: what a key does, from another process.
volatile std::sig_atomic_t signal_arm = 0, signal_stop = 0, signal_end = 0;
void on_signal(int number) {
  if (number == SIGUSR1) signal_arm = 1;
  if (number == SIGUSR2) signal_stop = 1;
  if (number == SIGINT || number == SIGTERM) signal_end = 1;
}

void catch_signals() {
  for (const int number : {SIGUSR1, SIGUSR2, SIGINT, SIGTERM}) std::signal(number, on_signal);
}

SavedPolicy policy_of(const GatewayOptions& options) {
  Result<SavedPolicy> saved = load_policy(options.policy);
  if (!saved) throw_error("--policy {}", saved.error());
  return std::move(saved).value();
}

pb::SafetyLimits limits_of(const std::string& path) {
  pb::SafetyLimits limits;
  if (!path.empty()) read_text_proto(path, limits);
  return limits;
}

/// The arm as it stands: the mount of the scene at the base that the registration found.
SafetySetup safety_of(const GatewayOptions& options, const ToolMount& scene_mount,
                      const pb::Config& config) {
  ToolMount mount = scene_mount;
  mount.instrument = &find_instrument(options.instrument);
  const bool registered = !options.registration.empty();
  if (registered) {
    const Registration found = load_registration(options.registration);
    if (found.instrument != mount.instrument->name) {
      throw_error("--registration {}: made with {}, and --instrument is {}", options.registration,
                  found.instrument, mount.instrument->name);
    }
    mount.X_WR = found.X_WR;
    for (const std::string& warning : found.warnings) log().warn("registration: {}", warning);
    const std::string age = age_warning(found, pb::RegistrationRules{}, wall_now_ns());
    if (!age.empty()) log().warn("registration: {}", age);
  }
  SafetySetup safety = make_safety_setup(limits_of(options.limits), mount,
                                         Eigen::Isometry3d::Identity(), registered);
  if (std::abs(safety.limits.period_s() - config.task().control_period_s()) > 1e-9) {
    throw_error("period_s: {} s, the policy's control period is {} s", safety.limits.period_s(),
                config.task().control_period_s());
  }
  return safety;
}

/// Socket, period and thread: what both subcommands listen with.
struct Robot {
  Robot(const GatewayOptions& options, const SafetySetup& safety, bool dry_run)
      : address(resolve_address("--robot", options.robot_host, options.robot_port)),
        socket(options.robot_port),
        control(socket, clock, safety, address.ipv4, dry_run),
        real_time(control, clock, events) {
    for (const std::string& warning : real_time.start()) log().warn("{}", warning);
  }

  UdpAddress address;
  UdpSocket socket;
  SteadyClock clock;
  ControlLoop control;
  OperatorEvents events;
  RealTimeLoop real_time;
};

/// One line for each change that an operator must know of.
class Teller {
 public:
  void tell(const Period& period) {
    const SafetyMemory& memory = period.judgement.memory;
    const bool changed = memory.phase != phase_ || period.judgement.finding.reason != reason_;
    phase_ = memory.phase;
    reason_ = period.judgement.finding.reason;
    if (!changed) return;
    const std::string why =
        period.judgement.finding ? ": " + describe(period.judgement.finding) : "";
    fmt::print("{}{}\n", safety_phase_name(phase_), why);
    if (phase_ == SafetyPhase::kReady) fmt::print("press a to arm, space to stop, q to end\n");
    if (phase_ == SafetyPhase::kStopped) fmt::print("press k when you have seen why\n");
    std::fflush(stdout);
  }

 private:
  SafetyPhase phase_ = SafetyPhase::kListening;
  StopReason reason_ = StopReason::kNone;
};

void attend(Robot& robot, const std::atomic<bool>& done) {
  OperatorKeys keys;
  Teller teller;
  const auto now = [&robot] { return robot.clock.now_ns(); };
  while (!done) {
    const char key = keys.next(20).value_or('\0');
    if (key == 'a' || std::exchange(signal_arm, 0) != 0) robot.events.arm_ns = now();
    if (key == 'a' || key == 'h') robot.events.held_ns = now();  // a held key repeats
    if (key == ' ' || std::exchange(signal_stop, 0) != 0) robot.events.stop_ns = now();
    if (key == 'k') robot.events.acknowledge_ns = now();
    if (key == 'q') signal_end = 1;
    for (Period period; robot.real_time.watch(period);) teller.tell(period);
    if (signal_end != 0) {
      robot.events.stop_ns = now();
      std::this_thread::sleep_for(std::chrono::milliseconds(100));  // three periods of hold
      robot.real_time.stop();
    }
  }
}

RolloutTask task_of(const GatewayOptions& options, const pb::Config& config, int episode) {
  RolloutTask task;
  task.kind = TaskKind::kEvaluate;
  task.greedy = true;
  task.reset = true;
  task.run_seed = options.run_seed;
  task.episode = static_cast<std::uint64_t>(episode);
  task.start_set = options.robot_grid ? StartSet::kRobotGrid : StartSet::kTraining;
  task.start_index = options.robot_grid ? static_cast<std::uint32_t>(episode) : 0;
  task.policy_steps = std::max(1U, config.task().episode_steps() / config.task().action_repeat());
  task.steps = task.policy_steps;
  task.task_hash = hash_task(task);
  return task;
}

void print_times(const LoopTimes& times) {
  const auto line = [](const char* name, const Histogram& h) {
    fmt::print("{:<10} p50 {:.2f} p99 {:.2f} max {:.2f} ms\n", name, h.quantile_ms(0.5),
               h.quantile_ms(0.99), h.max_ms());
  };
  fmt::print("periods    {}, {} late by more than 5 ms, {} missed, {} not recorded\n",
             times.periods, times.late, times.missed, times.unwatched);
  line("jitter", times.jitter);
  line("latency", times.latency);
  line("state age", times.state_age);
}

}  // namespace

int run_gateway(const GatewayOptions& options) {
  const SavedPolicy saved = policy_of(options);
  const pb::Config& config = saved.config;
  const auto setup = make_sim_setup(config);
  for (const std::string& warning : setup->warnings) log().warn("{}", warning);
  Policy policy(policy_shape(config), saved.weights);
  SimBackend scene(setup, 1, 0, make_image_source(*setup));
  const SafetySetup safety = safety_of(options, setup->mount, config);

  catch_signals();
  Robot robot(options, safety, options.dry_run);
  ArmGuide guide(robot.real_time, safety, {});
  TwinBackend twin(scene, guide);
  std::atomic<bool> done{false};
  std::thread attendant([&] { attend(robot, done); });
  int ran = 0;
  while (ran < options.episodes && !robot.real_time.ended()) {
    const std::vector<RolloutTask> task = {task_of(options, config, ran)};
    const std::vector<RolloutSegment> segments =
        run_rollout(twin, policy, task, [&] { return robot.real_time.ended(); });
    if (segments.empty() || robot.real_time.ended()) break;
    const RolloutSegment& s = segments[0];
    fmt::print("episode {}: {} steps, {}\n", ran, s.steps,
               s.failed != 0               ? "stopped: " + s.failure
               : s.episode_outcome.empty() ? std::string("no end")
               : s.episode_outcome[0] == static_cast<std::uint8_t>(Outcome::kTargetReached)
                   ? "target reached"
                   : "target not reached");
    std::fflush(stdout);
    if (s.failed == 0) {
      ++ran;  // one that was stopped is run again when the operator has armed
      (void)guide.hold();
    }
  }
  done = true;
  attendant.join();
  robot.real_time.stop();
  print_times(robot.real_time.times());
  return ran == options.episodes ? 0 : 1;
}

int register_robot(const GatewayOptions& options) {
  const SavedPolicy saved = policy_of(options);
  const ToolMount mount = make_sim_setup(saved.config)->mount;
  RegistrationInput input;
  input.touches = options.touches;
  input.pivots = options.pivots;
  input.instrument = find_instrument(options.instrument).name;
  input.nominal_tip_offset = mount.tip_offset;
  input.workspace_min = mount.workspace_min;
  input.workspace_max = mount.workspace_max;
  input.date_ns = wall_now_ns();
  const Result<Registration> found = register_from_tables(input);
  if (!found) {
    fmt::print(stderr, "dvrk_gateway: {}\n", found.error());
    return 1;
  }
  const Result<void> kept = save_registration(options.registration, found.value());
  if (!kept) throw_error("{}", kept.error());
  fmt::print(
      "{}{}\n",
      describe_registration(found.value(), input.rules, input.workspace_min, input.workspace_max),
      options.registration);
  return 0;
}

int check_robot(const GatewayOptions& options) {
  const SavedPolicy saved = policy_of(options);
  const auto setup = make_sim_setup(saved.config);
  const SafetySetup safety = safety_of(options, setup->mount, saved.config);
  catch_signals();
  Robot robot(options, safety, true);
  StreamRates rates;
  Period last;
  const std::int64_t end = robot.clock.now_ns() + static_cast<std::int64_t>(1e9 * options.seconds);
  while (robot.clock.now_ns() < end && signal_end == 0) {
    if (!robot.real_time.watch(last)) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      continue;
    }
    rates.add(last);
  }
  robot.real_time.stop();
  const bool go = last.judgement.memory.phase == SafetyPhase::kReady;
  fmt::print("{}", describe_robot(last, rates, safety));
  fmt::print("{}\n", go ? "go" : "no go: " + describe(last.judgement.finding));
  return go ? 0 : 1;
}

}  // namespace omentum
