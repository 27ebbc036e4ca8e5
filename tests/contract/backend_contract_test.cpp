#include "contract/snapshots_contract.h"
#include "core/config.h"
#include "sim_worker/backend/image_source.h"
#include "sim_worker/backend/sim_backend.h"
#include "support/dummy_backend.h"

namespace omentum::test {
namespace {

/// The setup is made when the first back end is: ctest runs one case per process, and every process
/// lists them all.
BackendCase sim_case(const std::string& name, const std::string& preset,
                     const std::vector<std::string>& overrides = {}) {
  const pb::Config config = load_config(preset, overrides);
  const auto setup = std::make_shared<std::shared_ptr<const SimSetup>>();
  const auto make = [config, setup](int lanes) {
    if (*setup == nullptr) *setup = make_sim_setup(config, deploy_dir() + "/scenes");
    return std::make_unique<SimBackend>(*setup, lanes, 0, make_image_source(**setup));
  };
  return {name, make, policy_shape(config)};
}

PolicyShape dummy_shape() {
  PolicyShape shape;
  shape.observations = 12;
  shape.branches = {3, 3, 3, 2};
  return shape;
}

/// Without states, like a robot.
BackendCase dummy_backend() {
  return {"dummy_backend", [](int lanes) { return std::make_unique<DummyBackend>(lanes); },
          dummy_shape()};
}

std::vector<BackendCase> with_snapshots() {
  return {
      {"dummy_simulation", [](int lanes) { return std::make_unique<DummySimulation>(lanes); },
       dummy_shape()},
      sim_case("paper_literal", "paper_literal"),
      sim_case("omentum", "omentum"),
      // A short episode brings resets, a near start brings grasp and contact into the 40 ... 100
      // steps.
      sim_case("omentum_short", "omentum",
               {"task.episode_steps=23", "scene.start_grid.centre_m={ x: 0.005 y: 0.04 z: 0.05 }",
                "task.start_height_range_m=0.015"}),
      // Above the places where the sheet is inclined, the tool turning.
      sim_case("omentum_oriented", "omentum_oriented",
               {"task.episode_steps=46", "scene.start_grid.centre_m={ x: 0.005 y: 0.04 z: 0.05 }",
                "task.start_height_range_m=0.02", "task.turn_increment_deg=5"}),
      sim_case("omentum_elastic", "omentum_elastic"),
      sim_case("omentum_elastic_short", "omentum_elastic",
               {"task.episode_steps=23", "scene.start_grid.centre_m={ x: 0.005 y: 0.04 z: 0.05 }",
                "task.start_height_range_m=0.015"}),
      // Above the soft organ; wide decisions, so that the tool ploughs through sheet and organ.
      sim_case("omentum_soft", "omentum_soft",
               {"task.action_repeat=2", "task.increment_m=0.002", "task.episode_steps=23",
                "scene.start_grid.centre_m={ x: -0.025 y: 0.045 z: 0.045 }",
                "scene.start_grid.row_pitch_m=0.001", "scene.start_grid.column_pitch_m=0.001",
                "task.start_height_range_m=0.015", "grasp.radius_m=0.01", "grasp.jaw_open_deg=0",
                "grasp.max_approach_deg=0", "grasp.min_pinch_m=0"}),
      sim_case("omentum_continuous", "omentum", {"task.action=ACTION_CONTINUOUS"}),
      sim_case("omentum_plastic", "omentum",
               {"scene.tissue.cluster.plastic_creep=0.1",
                "scene.tissue.cluster.plastic_threshold_m2=1e-8",
                "scene.tissue.cluster.self_collision=true", "scene.tissue.grid.count_x=12"}),
      sim_case("omentum_image", "omentum",
               {"task.observation=OBSERVATION_IMAGE", "task.image_size=16"})};
}

std::vector<BackendCase> all_back_ends() {
  std::vector<BackendCase> cases = with_snapshots();
  cases.push_back(dummy_backend());
  return cases;
}

constexpr auto kName = [](const auto& param_info) { return param_info.param.name; };
INSTANTIATE_TEST_SUITE_P(All, BackendContract, testing::ValuesIn(all_back_ends()), kName);
INSTANTIATE_TEST_SUITE_P(All, SnapshotsContract, testing::ValuesIn(with_snapshots()), kName);

TEST(BackendWithoutSnapshots, RefusesATaskThatContinuesAState) {
  Policy policy = make_policy(dummy_shape());
  DummyBackend backend(1);
  auto task = make_tasks(1, 10);
  task[0].reset = false;
  task[0].start_state = DummySimulation(1).save(0);
  const RolloutSegment s = run_rollout(backend, policy, task, {})[0];
  EXPECT_EQ(s.failed, 1U);
  EXPECT_EQ(s.failure, "task continues from a state, and this back end cannot load one");
  EXPECT_EQ(s.steps, 0U);
}

/// A robot whose third decision is not carried out.
class StoppingRobot : public DummyBackend {
 public:
  using DummyBackend::DummyBackend;
  void step(std::span<const Action> actions, std::span<StepOutcome> outcomes) override {
    DummyBackend::step(actions, outcomes);
    outcomes[0].stopped = clock(0).episode_step == 3;
  }
  std::string failure(int /*lane*/) const override { return "stale state"; }
  Source source() const override { return Source::kDvrk; }
};

TEST(BackendThatStops, KeepsTheStepsThatWereDoneAndSaysWhy) {
  Policy policy = make_policy(dummy_shape());
  StoppingRobot robot(1);
  const RolloutSegment s = run_rollout(robot, policy, make_tasks(1, 10), {})[0];
  EXPECT_EQ(s.failed, 1U);
  EXPECT_EQ(s.failure, "stale state");
  EXPECT_EQ(s.steps, 3U);
  EXPECT_EQ(s.rewards.size(), 3U);
  EXPECT_EQ(s.episode_end_step, std::vector<std::uint32_t>{2});
  EXPECT_EQ(s.episode_outcome[0], static_cast<std::uint8_t>(Outcome::kSafetyStop));
  EXPECT_EQ(s.source, Source::kDvrk);
}

}  // namespace
}  // namespace omentum::test
