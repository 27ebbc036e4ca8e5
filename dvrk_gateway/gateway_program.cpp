#include "dvrk_gateway/gateway_program.h"

#include <fmt/core.h>

#include <chrono>
#include <thread>

#include "core/clock.h"
#include "core/config.h"
#include "core/log.h"
#include "core/registration_file.h"
#include "core/touched_points.h"
#include "dvrk_gateway/backend/motion_replay.h"
#include "dvrk_gateway/gateway.h"
#include "dvrk_gateway/robot_report.h"

namespace omentum {
namespace {

void print_times(const LoopTimes& times) {
  const auto line = [](const char* name, const Histogram& h) {
    if (h.count() == 0) return;  // nothing was sent
    fmt::print("{:<10} p50 {:.2f} p99 {:.2f} max {:.2f} ms\n", name, h.quantile_ms(0.5),
               h.quantile_ms(0.99), h.max_ms());
  };
  fmt::print("periods    {}, {} late by more than 5 ms, {} missed, {} not recorded\n",
             times.periods, times.late, times.missed, times.unwatched);
  line("jitter", times.jitter);
  line("latency", times.latency);
  line("state age", times.state_age);
}

void print_episode(int number, const RolloutSegment& s) {
  std::string end = "no end";
  if (s.failed != 0) {
    end = "stopped: " + s.failure;
  } else if (!s.episode_outcome.empty()) {
    const bool reached = s.episode_outcome[0] == static_cast<std::uint8_t>(Outcome::kTargetReached);
    end = reached ? "target reached" : "target not reached";
  }
  fmt::print("episode {}: {} steps, {}\n", number, s.steps, end);
  std::fflush(stdout);
}

/// Exit code.
int ended(Gateway& gateway, bool all_done) {
  const bool recorded = gateway.end();
  print_times(gateway.session().times());
  return all_done && recorded ? 0 : 1;
}

std::vector<MotionSample> motion_goals(const GatewayOptions& options) {
  if (options.motion.empty()) throw_error("--motion: mode replay needs a recording");
  const Result<std::vector<MotionSample>> motion = load_motion(options.motion);
  if (!motion) throw_error("--motion {}", motion.error());
  const pb::SafetyLimits limits = limits_of(options);
  Result<std::vector<MotionSample>> goals =
      goals_of(motion.value(), limits.period_s(), options.slow, limits.step_m());
  if (!goals) throw_error("--motion {}: {}", options.motion, goals.error());
  return std::move(goals).value();
}

/// Mode replay: the motion, so often as there are episodes.
int replay(const GatewayOptions& options) {
  const std::vector<MotionSample> goals = motion_goals(options);
  const std::unique_ptr<Gateway> started = Gateway::start(options, {});
  if (!started) return 1;
  Gateway& gateway = *started;
  if (const Result<void> can = check_goals(gateway.session().safety(), goals); !can)
    throw_error("--motion {}: {}", options.motion, can.error());
  raise_deciding_thread();
  int ran = 0;
  while (ran < options.episodes && !gateway.session().ended()) {
    const Result<void> went = replay_goals(gateway.guide(), goals);
    fmt::print("replay {}: {}\n", ran, went ? "done" : "stopped: " + went.error());
    std::fflush(stdout);
    if (went) ++ran;
  }
  return ended(gateway, ran == options.episodes);
}

}  // namespace

int run_gateway(const GatewayOptions& options) {
  if (options.mode == GatewayMode::kReplay) return replay(options);
  const std::unique_ptr<Gateway> started = Gateway::start(options, {});
  if (!started) return 1;
  Gateway& gateway = *started;
  const auto grid_starts = static_cast<int>(robot_starts(gateway.config().scene()));
  if (options.robot_grid && options.episodes > grid_starts) {
    throw_error(
        "--episodes: {}, allowed with --starts robot_grid: up to {}, the starts of the scene",
        options.episodes, grid_starts);
  }
  const auto starts = options.robot_grid ? StartSet::kRobotGrid : StartSet::kTraining;
  int ran = 0;
  while (ran < options.episodes && !gateway.session().ended()) {
    const auto number = static_cast<std::uint32_t>(ran);
    const std::optional<RolloutSegment> segment =
        gateway.run_episode(gateway.next_task(starts, options.robot_grid ? number : 0, number));
    if (!segment) break;
    print_episode(ran, *segment);
    if (gateway.taught() != nullptr) {
      fmt::print("largest distance of the actions from the motion {:.2f} mm\n",
                 1000 * gateway.taught()->lag_m());
    }
    if (segment->failed == 0) ++ran;  // one that was stopped is run again when the operator armed
  }
  return ended(gateway, ran == options.episodes);
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
  catch_operator_signals();
  std::optional<Registration> registration;
  if (safety.registered) registration = load_registration(options.registration);
  RobotReport report(safety, registration ? &*registration : nullptr);
  GatewaySession session(robot_address(options), options.robot_port, safety, true);
  session.attend(
      [] {
        std::this_thread::sleep_for(std::chrono::milliseconds(5));
        OperatorWishes wishes;
        wishes.end = end_was_signalled();
        return wishes;
      },
      {&report});
  const std::int64_t end_ns =
      session.clock().now_ns() + static_cast<std::int64_t>(1e9 * options.seconds);
  while (session.clock().now_ns() < end_ns && !session.ended())
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  session.end();
  fmt::print("{}", report.text());
  return report.ready() ? 0 : 1;
}

}  // namespace omentum
