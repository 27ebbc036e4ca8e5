// Modes that run episodes, with the double behind them, in simulated time.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <fstream>
#include <memory>
#include <thread>
#include <utility>

#include "contract/backend_contract.h"
#include "core/config.h"
#include "core/segment_fields.h"
#include "dvrk_gateway/backend/decision_time.h"
#include "dvrk_gateway/backend/dvrk_backend.h"
#include "dvrk_gateway/backend/motion_replay.h"
#include "dvrk_gateway/recording/robot_recorder.h"
#include "tests/dvrk_gateway/recorded_session.h"
#include "tests/dvrk_gateway/two_sides.h"
#include "tests/support/small_disk.h"
#include "tests/support/temp_dir.h"

namespace omentum::test {
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(BackendContract);  // tasks and policy of its header
}

namespace omentum {
namespace {

using test::TwoSides;

/// A gateway whose robot is homed, stands above the scene and was armed.
class Modes : public testing::Test {
 protected:
  static constexpr std::int64_t kS = 1'000'000'000;

  void make(const pb::ArmEffects& effects = {}) {
    // Decisions of one control period, by which these tests count.
    const pb::Config config =
        load_config("omentum", std::vector<std::string>{"task.action_repeat=1"});
    setup_ = make_sim_setup(config);
    sides_ = std::make_unique<TwoSides>(DoubleOptions{}, effects, setup_->mount);
    sides_->sleep_until(kS / 100);
    sides_->robot().arm().power();
    sides_->robot().arm().home();
    sides_->sleep_until(2 * kS);
    const Eigen::Vector3d middle =
        0.5 * (setup_->mount.workspace_min + setup_->mount.workspace_max);
    const PsmJoints q = joints_for_tip(setup_->mount, middle).value();
    sides_->say(fmt::format(R"({{"move_jp":{{"Goal":{}}}}})", test::text_of({q.begin(), q.end()})));
    sides_->sleep_until(5 * kS);
    safety_ = make_safety_setup({}, setup_->mount, Eigen::Isometry3d::Identity(), true);
    loop_ = std::make_unique<ControlLoop>(sides_->gateway_link, *sides_, safety_);
    port_ = std::make_unique<SteppedPort>(*loop_, *sides_, events_);
    guide_ = std::make_unique<ArmGuide>(*port_, safety_, ArmGuideOptions{},
                                        [this](const Period& period) { arm_when_ready(period); });
    scene_ = std::make_unique<SimBackend>(setup_, 1);
    policy_ = std::make_unique<Policy>(test::make_policy(policy_shape(config)));
  }
  void arm_when_ready(const Period& period) {
    if (period.judgement.memory.phase == SafetyPhase::kReady) events_.arm_ns = sides_->now_ns();
    if (sides_->now_ns() > 20 * kS)
      throw_error("not armed: {}", describe(period.judgement.finding));
  }
  static std::vector<RolloutTask> task(std::uint32_t steps) {
    std::vector<RolloutTask> tasks = test::make_tasks(1, steps);
    return tasks;
  }

  std::shared_ptr<const SimSetup> setup_;
  std::unique_ptr<TwoSides> sides_;
  SafetySetup safety_;
  GatewayEvents events_;
  std::unique_ptr<ControlLoop> loop_;
  std::unique_ptr<SteppedPort> port_;
  std::unique_ptr<ArmGuide> guide_;
  std::unique_ptr<SimBackend> scene_;
  std::unique_ptr<Policy> policy_;
};

TEST_F(Modes, SegmentIsThatOfTheSimulationAndTheArmIsOnePeriodBehind) {
  make();
  TwinBackend twin(*scene_, *guide_);
  RolloutSegment led = run_rollout(twin, *policy_, task(100), {})[0];
  ASSERT_EQ(led.failed, 0U) << led.failure;
  EXPECT_EQ(led.source, Source::kDvrk);
  SimBackend alone(setup_, 1);
  const RolloutSegment simulated = run_rollout(alone, *policy_, task(100), {})[0];
  led.source = Source::kSimulation;
  EXPECT_EQ(segment_crc(led), simulated.payload_crc32c);
  EXPECT_LT((guide_->measured_tip() - scene_->commanded_tip(0)).norm(), 1e-5);
}

TEST_F(Modes, AStopOfTheOperatorEndsTheEpisodeKeepsItsStepsAndHolds) {
  make();
  TwinBackend twin(*scene_, *guide_);
  int steps = 0;
  const RolloutSegment s = run_rollout(twin, *policy_, task(100), [&] {
    if (++steps == 31) events_.stop_ns = sides_->now_ns();
    return false;
  })[0];
  EXPECT_EQ(s.failed, 1U);
  EXPECT_NE(s.failure.find("operator"), std::string::npos) << s.failure;
  EXPECT_EQ(s.steps, 31U);
  EXPECT_EQ(s.episode_outcome.at(0), static_cast<std::uint8_t>(Outcome::kSafetyStop));
  // Nothing resumes by itself; three holds went out, then silence.
  for (int i = 0; i < 50; ++i) port_->exchange({.fresh = true, .command = {}});
  EXPECT_EQ(port_->period().judgement.memory.phase, SafetyPhase::kStopped);
  const auto& sent = sides_->gateway_link.sent;
  int holds = 0;
  for (const auto& datagram : sent) holds += datagram.text.find("hold") != std::string::npos;
  EXPECT_EQ(holds, 3);
  EXPECT_LT(sent.back().time_ns, sides_->now_ns() - 40 * 20'000'000);
}

TEST_F(Modes, ADiskThatIsFullUnderAnArmedArmHoldsIt) {
  make();
  const test::TempDir folder;
  RobotRecorderOptions options;
  options.path = folder / "a.mcap";
  options.setup = test::recording_setup(setup_->mount);
  options.min_free_bytes = 0;
  RobotRecorder recorder(options);
  recorder.stop_on_failure([this] { events_.fault = true; });
  TwinBackend twin(*scene_, *guide_);
  const test::SmallDisk disk(20'000);
  int steps = 0;
  const RolloutSegment s = run_rollout(twin, *policy_, task(200), [&] {
    recorder.on_period(port_->period());
    if (++steps <= 100) return false;
    const auto patience = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    // Two seconds of it are more than the disk takes; the thread that writes finds that in its
    // time.
    while (!recorder.failed() && std::chrono::steady_clock::now() < patience)
      std::this_thread::yield();
    return false;
  })[0];
  EXPECT_EQ(s.failed, 1U);
  EXPECT_EQ(port_->period().judgement.memory.stop.reason, StopReason::kGatewayFault) << s.failure;
  EXPECT_THAT(s.failure, testing::HasSubstr("see its log"));
  for (int i = 0; i < 10; ++i) port_->exchange({.fresh = true, .command = {}});
  int holds = 0;
  for (const auto& datagram : sides_->gateway_link.sent)
    holds += datagram.text.find("hold") != std::string::npos;
  EXPECT_EQ(holds, 3);
  const Result<void> finished = recorder.finish();
  ASSERT_FALSE(finished);
  EXPECT_THAT(finished.error(), testing::HasSubstr("a.mcap: File too large; "));
}

TEST_F(Modes, AFaultOfTheRobotIsNamed) {
  make();
  TwinBackend twin(*scene_, *guide_);
  int steps = 0;
  const RolloutSegment s = run_rollout(twin, *policy_, task(100), [&] {
    if (++steps == 11) sides_->robot().set_silent(true);
    return false;
  })[0];
  EXPECT_EQ(s.failed, 1U);
  EXPECT_EQ(port_->period().judgement.memory.stop.reason, StopReason::kStale) << s.failure;
  EXPECT_LE(s.steps, 11U + 3) << "50 ms";
}

/// Goes to a place of the sheet, closes the jaw, lifts to the target: takes hold where a policy
/// does.
class Retract {
 public:
  explicit Retract(SimBackend& scene) : scene_(scene) {}
  void operator()(std::uint32_t, std::span<Action> actions) const {
    const Eigen::Vector3d tip = scene_.commanded_tip(0);
    const int middle = static_cast<int>(scene_.setup().scene.tissue.particles.size() / 2);
    const Eigen::Vector3d way = scene_.tissue_of(0).position(0, middle) - tip;
    const bool there = way.norm() < 0.001;
    actions[0] =
        scene_.clock(0).held ? scene_.hold_action(0) : scene_.task().action_towards(way, there);
  }

 private:
  SimBackend& scene_;
};

TEST_F(Modes, TheRealJawShutsWhileTheTipWaitsWhenTheSceneTakesHold) {
  make();
  TwinBackend twin(*scene_, *guide_);
  const RolloutSegment s = run_rollout(twin, Actor(Retract(*scene_), false), task(200), {})[0];
  ASSERT_EQ(s.failed, 0U) << s.failure;
  ASSERT_TRUE(scene_->clock(0).held) << "or this shows nothing";
  EXPECT_LT(guide_->measured_jaw_rad(), 0);
  // Of the goals that turned the jaw below half none left its place.
  std::vector<std::string> places;
  bool opened = false;  // on the way to the start
  for (const auto& datagram : sides_->gateway_link.sent) {
    const auto command = decode_commands(datagram.text);
    if (!command.servo_cp || !command.jaw_servo_jp) continue;
    const double jaw = command.jaw_servo_jp->goal[0];
    opened = opened || jaw >= ArmGuideOptions{}.jaw_open_rad;
    if (!opened || jaw > 0.2) continue;
    if (jaw <= ArmGuideOptions{}.jaw_closed_rad) break;
    places.push_back(fmt::format("{}", fmt::join(command.servo_cp->translation, " ")));
  }
  ASSERT_GT(places.size(), 5U);
  for (const std::string& place : places) EXPECT_EQ(place, places.front());
}

TEST_F(Modes, MeasuredOnAnIdealRobotEndsAsTheTwinDoes) {
  std::array<RolloutSegment, 2> ends;
  for (const int mode : {0, 1}) {
    make();
    std::unique_ptr<DvrkBackend> backend;
    if (mode == 0) backend = std::make_unique<TwinBackend>(*scene_, *guide_);
    if (mode == 1) backend = std::make_unique<MeasuredBackend>(*scene_, *guide_);
    ends[static_cast<std::size_t>(mode)] =
        run_rollout(*backend, Actor(Retract(*scene_), false), task(400), {})[0];
  }
  for (const RolloutSegment& s : ends) ASSERT_EQ(s.failed, 0U) << s.failure;
  EXPECT_EQ(ends[0].episode_held, std::vector<std::uint8_t>{1});
  EXPECT_EQ(ends[1].episode_held, ends[0].episode_held);
  EXPECT_EQ(ends[1].episode_outcome, ends[0].episode_outcome);
  EXPECT_NEAR(ends[1].episode_exposure[0], ends[0].episode_exposure[0], 0.02F);
}

TEST_F(Modes, MeasuredObservesWhereADroopingRobotIsAndItsSceneFollows) {
  pb::ArmEffects effects;
  effects.mutable_droop_s()->set_yaw(0.045);
  effects.mutable_droop_s()->set_pitch(0.042);
  effects.mutable_droop_s()->set_insertion(0.033);
  make(effects);
  MeasuredBackend measured(*scene_, *guide_);
  std::vector<double> apart;
  const auto down = [&](std::uint32_t step, std::span<Action> actions) {
    if (step == 0) return void(actions[0] = scene_->task().action_towards({0, 0, 0}, false));
    const EpisodeFacts facts = measured.clock(0);
    const Eigen::Vector3d tool = Eigen::Map<const Eigen::Vector3d>(facts.tool_position.data());
    EXPECT_LT((tool - guide_->measured_tip()).norm(), 1e-12);
    apart.push_back((scene_->commanded_tip(0) - tool).norm());
    actions[0] = scene_->task().action_towards({0, 0, -1}, false);
  };
  const RolloutSegment s = run_rollout(measured, Actor(down, false), task(40), {})[0];
  ASSERT_EQ(s.failed, 0U) << s.failure;
  EXPECT_EQ(s.end_state.size(), 0U) << "half of the state is the robot's";
  // 25 mm/s, mostly by the yaw.
  const double most = *std::max_element(apart.begin(), apart.end());
  EXPECT_GT(most, 0.0007);
  EXPECT_LT(most, 0.0012);
}

TEST_F(Modes, ATaughtMotionIsInTheActionsWithinAStepAndNothingIsSent) {
  make();
  bool begins = false;
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(guide_->watch());  // what has arrived so far
  const std::size_t sent_before = sides_->gateway_link.sent.size();
  TaughtBackend taught(
      *scene_, *guide_, [&] { return std::exchange(begins, true); },
      [&] { return scene_->clock(0).episode_step == 60; }, 0.25);
  const Eigen::Vector3d from = guide_->measured_tip();
  // An operator at the console, at 15 mm/s towards x and 10 mm/s down.
  const Eigen::Vector3d velocity(0.015, 0, -0.010);
  const Actor actor(
      [&](std::uint32_t step, std::span<Action> actions) {
        const Eigen::Vector3d at = from + velocity * 0.02 * (step + 1);
        const PsmJoints q = joints_for_tip(setup_->mount, at).value();
        sides_->say(test::servo_jp({q.begin(), q.end()}));
        actions[0] = taught.next_action();
      },
      false);
  const RolloutSegment s = run_rollout(taught, actor, task(400), {})[0];
  ASSERT_EQ(s.failed, 0U) << s.failure;
  EXPECT_EQ(s.steps, 61U) << "ends when the operator says so";
  EXPECT_EQ(sides_->gateway_link.sent.size(), sent_before);
  Eigen::Vector3d way = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < s.steps; ++k) {
    Action action;
    std::copy_n(s.actions.begin() + static_cast<std::ptrdiff_t>(4 * k), 4, action.branch.begin());
    way += scene_->task().decode(action).increment;
  }
  EXPECT_LT((way - (guide_->measured_tip() - from)).cwiseAbs().maxCoeff(), 0.0005);
  EXPECT_GT(way.norm(), 0.015);
  EXPECT_LT(taught.lag_m(), 0.0009);
}

TEST_F(Modes, AReplayLeadsTheTipAlongTheMotion) {
  make();
  std::vector<MotionSample> goals;
  const Eigen::Vector3d from = 0.5 * (setup_->mount.workspace_min + setup_->mount.workspace_max);
  for (int k = 0; k < 100; ++k)
    goals.push_back({0.02 * k, from + Eigen::Vector3d(0.0003 * k, -0.0001 * k, 0), 0.3});
  const Result<void> went = replay_goals(*guide_, goals);
  ASSERT_TRUE(went) << went.error();
  EXPECT_LT((guide_->measured_tip() - goals.back().p_WT).norm(), 1e-5);
  EXPECT_NEAR(guide_->measured_jaw_rad(), 0.3, 1e-9);
}

TEST_F(Modes, AMotionThatWasTaughtIsReplayed) {
  make();
  for (int i = 0; i < 20; ++i) ASSERT_TRUE(guide_->watch());
  const test::TempDir folder;
  const std::string path = folder / "taught.mcap";
  std::vector<Eigen::Vector3d> taught_way;
  {
    std::ofstream out(path, std::ios::binary);
    RecordingSetup setup = test::recording_setup(setup_->mount);
    setup.start_ns = sides_->now_ns();
    RecordingFile file(out, setup);
    bool begins = false;
    TaughtBackend taught(
        *scene_, *guide_, [&] { return std::exchange(begins, true); },
        [&] { return scene_->clock(0).episode_step == 100; }, 0.25);
    const Eigen::Vector3d from = guide_->measured_tip();
    // An operator at the console: a quarter of a circle of 20 mm, the jaw closes in its second
    // half.
    const Actor actor(
        [&](std::uint32_t step, std::span<Action> actions) {
          const double angle = 0.0157 * step;
          const Eigen::Vector3d way(0.02 * std::sin(angle), 0.02 * (1 - std::cos(angle)), 0);
          const PsmJoints q = joints_for_tip(setup_->mount, from + way).value();
          sides_->say(test::servo_jp({q.begin(), q.end()}));
          sides_->say(test::jaw_servo_jp(step < 50 ? 0.5 : 0.5 - 0.01 * (step - 50)));
          actions[0] = taught.next_action();
          file.add_period(port_->period());
          taught_way.push_back(guide_->measured_tip());
        },
        false);
    const RolloutSegment s = run_rollout(taught, actor, task(400), {})[0];
    ASSERT_EQ(s.failed, 0U) << s.failure;
    ASSERT_TRUE(file.finish());
  }
  const double jaw_at_end = guide_->measured_jaw_rad();
  ASSERT_LT(jaw_at_end, 0.1) << "or the jaw shows nothing";

  const Result<std::vector<MotionSample>> motion = load_motion(path);
  ASSERT_TRUE(motion) << motion.error();
  const Result<std::vector<MotionSample>> goals = goals_of(motion.value(), 0.02, 1, 0.0005);
  ASSERT_TRUE(goals) << goals.error();
  make();  // the robot another day
  std::vector<Eigen::Vector3d> replayed_way;
  sides_->after_period = [&](DvrkDouble&) { replayed_way.push_back(guide_->measured_tip()); };
  const Result<void> went = replay_goals(*guide_, goals.value());
  ASSERT_TRUE(went) << went.error();
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(guide_->watch());
  EXPECT_LT((guide_->measured_tip() - taught_way.back()).norm(), 1e-5);
  EXPECT_NEAR(guide_->measured_jaw_rad(), jaw_at_end, 1e-6);
  for (const Eigen::Vector3d& tip : taught_way) {
    double nearest = 1;
    for (const Eigen::Vector3d& other : replayed_way)
      nearest = std::min(nearest, (tip - other).norm());
    EXPECT_LT(nearest, 0.0005) << "one action";
  }
}

TEST(DecisionTime, ASceneThatIsTooSlowForThePeriodIsRefusedInOneLine) {
  pb::Task task;
  task.set_control_period_s(0.02);
  task.set_action_repeat(1);
  EXPECT_TRUE(check_decision_time(task, 0.0079));
  const Result<void> slow = check_decision_time(task, 0.0121);
  ASSERT_FALSE(slow);
  EXPECT_EQ(
      slow.error(),
      "its scene needs 12.1 ms of each control period on this machine, allowed 8.0 ms: take a "
      "coarser scene or a faster machine");
  task.set_action_repeat(2);  // a decision is for two periods
  EXPECT_TRUE(check_decision_time(task, 0.0121));
}

}  // namespace
}  // namespace omentum
