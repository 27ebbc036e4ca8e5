// The policy in the simulated scene, the double behind it, in simulated time.
#include <gtest/gtest.h>

#include <memory>

#include "contract/backend_contract.h"
#include "core/config.h"
#include "core/segment_fields.h"
#include "dvrk_gateway/backend/twin_backend.h"
#include "tests/dvrk_gateway/double_session.h"

namespace omentum::test {
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(BackendContract);  // tasks and policy of its header
}

namespace omentum {
namespace {

using test::kClient;
using test::kRobot;

/// Robot and gateway on one clock: while the gateway sleeps the robot's periods pass.
class TwoSides final : public Clock {
 public:
  TwoSides(const DoubleOptions& options, const pb::ArmEffects& effects, const ToolMount& mount)
      : robot_(options, effects, mount, kClient) {}

  std::int64_t now_ns() noexcept override { return time_.time_ns; }
  void sleep_until(std::int64_t until_ns) noexcept override {
    for (; next_ns_ <= until_ns; next_ns_ += DvrkDouble::kPeriod_ns) {
      time_.time_ns = next_ns_;
      for (; said_ < gateway_link.sent.size(); ++said_)
        robot_link_.deliver(gateway_link.sent[said_].time_ns, gateway_link.sent[said_].text,
                            kClient);
      robot_.period(next_ns_, robot_link_);
      for (; heard_ < robot_link_.sent.size(); ++heard_)
        gateway_link.deliver(next_ns_, robot_link_.sent[heard_].text, kRobot);
    }
    time_.time_ns = until_ns;
  }
  DvrkDouble& robot() { return robot_; }
  void say(const std::string& text) { robot_link_.deliver(time_.time_ns, text, kClient); }

 private:
  test::ScriptClock time_;

 public:
  test::ScriptLink gateway_link{time_};

 private:
  test::ScriptLink robot_link_{time_};
  DvrkDouble robot_;
  std::int64_t next_ns_ = 0;
  std::size_t said_ = 0, heard_ = 0;
};

/// A gateway whose robot is homed, stands above the scene and was armed.
class Twin : public testing::Test {
 protected:
  static constexpr std::int64_t kS = 1'000'000'000;

  void make(const pb::ArmEffects& effects = {}) {
    const pb::Config config = load_config("omentum", std::vector<std::string>{});
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

TEST_F(Twin, SegmentIsThatOfTheSimulationAndTheArmIsOnePeriodBehind) {
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

TEST_F(Twin, AStopOfTheOperatorEndsTheEpisodeKeepsItsStepsAndHolds) {
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

TEST_F(Twin, AFaultOfTheRobotIsNamed) {
  make();
  TwinBackend twin(*scene_, *guide_);
  int steps = 0;
  const RolloutSegment s = run_rollout(twin, *policy_, task(100), [&] {
    if (++steps == 11) sides_->robot().set_silent(true);
    return false;
  })[0];
  EXPECT_EQ(s.failed, 1U);
  EXPECT_EQ(port_->period().judgement.memory.stop.reason, StopReason::kStale) << s.failure;
  EXPECT_LE(s.steps, 11U + 4) << "50 ms";
}

}  // namespace
}  // namespace omentum
