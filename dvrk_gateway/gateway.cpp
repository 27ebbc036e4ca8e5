#include "dvrk_gateway/gateway.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <thread>
#include <utility>

#include "core/build_id.h"
#include "core/clock.h"
#include "core/config.h"
#include "core/constants.h"
#include "core/limits.h"
#include "core/log.h"
#include "core/rollout.h"
#include "dvrk_gateway/backend/decision_time.h"
#include "sim_worker/backend/image_source.h"

namespace omentum {
namespace {

constexpr double kLongestDemonstration_s = 600;

/// Throws Error for a scene that cannot be computed in the control periods of its decisions.
void require_speed(const std::shared_ptr<const SimSetup>& setup, Policy& policy) {
  SimBackend alone(setup, 1, 0, make_image_source(*setup));
  const Result<void> fits =
      check_decision_time(setup->config.task(), measure_decision_s(alone, policy));
  if (!fits) throw_error("--policy: {}", fits.error());
}

ArmGuideOptions guide_options(const pb::Grasp& grasp) {
  ArmGuideOptions options;
  if (grasp.jaw_open_deg() > 0) options.jaw_open_rad = kDegree * grasp.jaw_open_deg();
  return options;
}

}  // namespace

std::unique_ptr<Gateway> Gateway::start(const GatewayOptions& options,
                                        std::vector<GatewayObserver*> more) {
  catch_operator_signals();
  std::unique_ptr<GatewayBus> bus = join_bus(options.bus, end_was_signalled);
  std::unique_ptr<PolicySource> policies = policy_source_of(options, bus.get(), end_was_signalled);
  if (!policies) return nullptr;
  return std::unique_ptr<Gateway>(
      new Gateway(options, std::move(bus), std::move(policies), std::move(more)));
}

Gateway::Gateway(const GatewayOptions& options, std::unique_ptr<GatewayBus> bus,
                 std::unique_ptr<PolicySource> policies, std::vector<GatewayObserver*> more)
    : options_(options),
      bus_(std::move(bus)),
      policies_(std::move(policies)),
      policies_of_bus_(dynamic_cast<BusPolicySource*>(policies_.get())),
      policy_(&policies_->for_next_episode()),
      setup_(make_sim_setup(config())),
      scene_(std::make_unique<SimBackend>(setup_, 1, 0, make_image_source(*setup_))),
      screen_(options.mode == GatewayMode::kTeach),
      observers_(std::move(more)) {
  for (const std::string& warning : setup_->warnings) log().warn("{}", warning);
  require_speed(setup_, *policy_);
  const SafetySetup safety = safety_of(options, setup_->mount, config());
  const bool teaches = options.mode == GatewayMode::kTeach;
  // The other modes never become ready without one, and say so.
  if (teaches && !safety.registered)
    throw_error("--registration: mode teach needs to know where the arm stands; see `register`");
  observers_.insert(observers_.begin(), &screen_);
  told_ = std::make_unique<BusObservers>(bus_.get(), options.bus, safety, options.dry_run);
  told_->append_to(observers_);
  recording_ = std::make_unique<GatewayRecording>(
      options.recording,
      RecordedSessionFacts{mode_name(options.mode), options.registration, git_revision(),
                           options.dry_run},
      config(), safety);
  recording_->append_to(observers_);
  session_ = std::make_unique<GatewaySession>(robot_address(options), options.robot_port, safety,
                                              options.dry_run || teaches);
  recording_->stop_on_failure(session_->events());
  session_->attend([this] { return ask(); }, observers_);
  const ArmGuideOptions guiding = guide_options(config().grasp());
  guide_ = std::make_unique<ArmGuide>(session_->port(), safety, guiding);
  switch (options.mode) {
    case GatewayMode::kMeasured:
      backend_ = std::make_unique<MeasuredBackend>(*scene_, *guide_);
      break;
    case GatewayMode::kTeach: {
      auto taught = std::make_unique<TaughtBackend>(
          *scene_, *guide_, [this] { return demonstration_begins_.exchange(false); },
          [this] { return demonstration_ends_.exchange(false); },
          0.5 * (guiding.jaw_open_rad + guiding.jaw_closed_rad));
      taught_ = taught.get();
      backend_ = std::move(taught);
      break;
    }
    default:
      backend_ = std::make_unique<TwinBackend>(*scene_, *guide_);
      break;
  }
}

Gateway::~Gateway() { session_->end(); }

bool Gateway::end() {
  screen_.end_follows();
  session_->end();
  return recording_->finish();
}

OperatorWishes Gateway::ask() {
  OperatorWishes wishes = desk_.ask();
  if (wishes.key != 0) key_ = wishes.key;
  if (wishes.end) screen_.end_follows();
  if (options_.mode != GatewayMode::kTeach) return wishes;
  // Nothing is sent: the keys begin and end a demonstration.
  if (std::exchange(wishes.arm, false)) demonstration_begins_ = true;
  if (std::exchange(wishes.stop, false)) demonstration_ends_ = true;
  return wishes;
}

std::optional<char> Gateway::ask_key(std::string_view keys) {
  key_ = 0;
  while (!session_->ended()) {
    const char key = key_.exchange(0);
    if (key != 0 && keys.find(key) != std::string_view::npos) return key;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return std::nullopt;
}

/// Between two episodes, where nothing is asked of the arm, and never while it is armed: one that
/// the operator arms meanwhile holds until it is led, and stops at once as ever.
void Gateway::stay_on_bus() {
  if (policies_of_bus_ == nullptr) return;
  // As this thread saw it at the end of the episode, and as it is now.
  const SafetyPhase seen = session_->port().period().judgement.memory.phase;
  if (seen == SafetyPhase::kActive || told_->sees_armed()) return;
  if (!bus_->is_deaf(policies_of_bus_->heard_ns(), false, steady_now_ns())) return;
  std::vector<BusMember*> members = told_->members();
  members.push_back(policies_of_bus_);
  if (const Result<void> joined = bus_->join_anew(members); !joined)
    log().warn("event=rejoin_failed reason=\"{}\"", joined.error());
}

RolloutTask Gateway::next_task(StartSet start_set, std::uint32_t start_index,
                               std::uint64_t episode) {
  policy_ = &policies_->for_next_episode();  // first: it takes what has arrived
  stay_on_bus();
  told_->pin(weights());
  const pb::Task& task = config().task();
  RolloutTask t;
  t.learner_epoch = weights().learner_epoch;
  t.config_hash = config_hash(config());
  t.kind = TaskKind::kEvaluate;
  t.greedy = !options_.drawn_actions.value_or(!config().randomise().empty());
  t.reset = true;
  t.run_seed = options_.run_seed;
  t.episode = episode;
  t.start_set = start_set;
  t.start_index = start_index;
  t.policy_version = weights().policy_version;
  t.weights_hash = weights().weights_hash;
  t.policy_steps = std::max(1U, task.episode_steps() / task.action_repeat());
  t.hold_steps = hold_steps(task);
  t.steps = evaluation_steps(config(), false);
  if (options_.mode == GatewayMode::kTeach) {
    const double decision_s = task.control_period_s() * task.action_repeat();
    t.steps = static_cast<std::uint32_t>(kLongestDemonstration_s / decision_s);
    t.episode_limit = t.steps;
  }
  t.task_hash = hash_task(t);
  return t;
}

RolloutSegment Gateway::predict(const RolloutTask& task) const {
  SimBackend alone(setup_, 1, 0, make_image_source(*setup_));
  return std::move(run_rollout(alone, *policy_, std::array{task}, {}).front());
}

std::optional<RolloutSegment> Gateway::run_episode(const RolloutTask& task) {
  raise_deciding_thread();  // where it is refused the session has warned of it
  const Actor actor = taught_ == nullptr ? Actor(*policy_)
                                         : Actor(
                                               [this](std::uint32_t, std::span<Action> actions) {
                                                 actions[0] = taught_->next_action();
                                               },
                                               policy_->shape().continuous);
  std::vector<RolloutSegment> segments =
      run_rollout(*backend_, actor, std::array{task}, [this] { return session_->ended(); });
  if (segments.empty()) return std::nullopt;
  if (segments[0].failed == 0 && taught_ == nullptr) (void)guide_->hold();
  for (GatewayObserver* observer : observers_) observer->on_episode(task, segments[0]);
  return std::move(segments[0]);
}

}  // namespace omentum
