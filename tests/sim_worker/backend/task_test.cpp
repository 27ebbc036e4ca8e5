// The task to the letter (docs/task.md) on the shipped presets.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "core/hash.h"
#include "core/reward.h"
#include "support/preset_task.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::grasp_below;
using test::grid_start;
using test::kDown;
using test::kStay;
using test::setup_of;
using test::step_one;
using test::tip;

TEST(Reward, ReferenceValues) {  // docs/task.md 7
  constexpr double kDiagonal = 0.28098;
  const auto at = [](pb::RewardKind kind, bool held, double dq, double dt) {
    RewardState s;
    s.held = held;
    s.distance_q = dq;
    s.distance_target = dt;
    s.workspace_diagonal = kDiagonal;
    return reward(kind, s, RewardWeights{0.5, 0.1, 0});
  };
  EXPECT_NEAR(at(pb::REWARD_PAPER, false, 0.08877, 0), -0.65795, 2e-5);
  EXPECT_NEAR(at(pb::REWARD_DERIVED, false, 0.09666, 0), -0.67200, 1e-5);
  EXPECT_NEAR(at(pb::REWARD_PAPER, true, 0, 0.08521), -0.15162, 2e-5);
  EXPECT_NEAR(at(pb::REWARD_DERIVED, true, 0, 0.08521), -0.40162, 2e-5);
  EXPECT_EQ(at(pb::REWARD_PAPER, true, 0, 0), 0);
  EXPECT_NEAR(make_task(*setup_of("paper_literal")).workspace_diagonal(), 0.28098, 5e-6);
}

TEST(Reward, BelongsToTheStateBeforeTheMotion) {
  SimBackend backend(setup_of("paper_literal"), 1, 1);
  backend.reset(0, grid_start(0));
  const Vector3d p = tip(backend);
  const double expected =
      -0.5 / backend.task().workspace_diagonal() * (p - backend.setup().scene.tumour_point).norm() -
      0.5;
  EXPECT_NEAR(step_one(backend, kDown).reward, expected, 1e-6);
}

TEST(Reward, ClosedJawInAirIsNotHeld) {
  SimBackend ours(setup_of("paper_literal"), 1, 1);
  ours.reset(0, grid_start(0));
  step_one(ours, {1, 1, 1, 1});
  EXPECT_LT(step_one(ours, {1, 1, 1, 1}).reward, -0.5F);
  SimBackend literal(setup_of("paper_literal", {"defects.reward_jaw_closed=true"}), 1, 1);
  literal.reset(0, grid_start(0));
  step_one(literal, {1, 1, 1, 1});
  EXPECT_GT(step_one(literal, {1, 1, 1, 1}).reward, -0.5F);
}

TEST(Action, TablesOfEveryPreset) {
  // paper: x, y, z with -1, 0, +1
  SimBackend paper(setup_of("paper_literal"), 1, 1);
  paper.reset(0, grid_start(44));
  Vector3d before = tip(paper);
  step_one(paper, {2, 0, 0, 0});
  EXPECT_LT((tip(paper) - before - Vector3d(0.0005, -0.0005, -0.0005)).norm(), 1e-12);
  // derived: Unity x, y, z = W x, z, y with 0, +1, -1, five ticks
  SimBackend derived(setup_of("derived"), 1, 1);
  derived.reset(0, grid_start(44));
  before = tip(derived);
  step_one(derived, {1, 2, 1, 0});
  EXPECT_LT((tip(derived) - before - 5 * Vector3d(0.0005, 0.0005, -0.0005)).norm(), 1e-12);
  // derived_head: Unity y, z, x = W z, y, x with -1, 0, +1
  SimBackend head(setup_of("derived_head"), 1, 1);
  head.reset(0, grid_start(44));
  before = tip(head);
  step_one(head, {0, 2, 1, 0});
  EXPECT_LT((tip(head) - before - 5 * Vector3d(0, 0.0005, -0.0005)).norm(), 1e-12);
}

TEST(Action, ContinuousIncrementIsBounded) {
  SimBackend backend(setup_of("omentum", {"task.action=ACTION_CONTINUOUS"}), 1, 1);
  backend.reset(0, grid_start(44));
  const Vector3d before = tip(backend);
  std::vector<Action> actions(1);
  actions[0].continuous = {5.0F, -0.5F, -7.0F, -1.0F};
  std::vector<StepOutcome> outcomes(1);
  backend.step(actions, outcomes);
  EXPECT_LT((tip(backend) - before - Vector3d(0.0005, -0.00025, -0.0005)).norm(), 1e-9);
}

TEST(Workspace, DropsIncrement) {
  SimBackend backend(setup_of("paper_literal"), 1, 1);
  backend.reset(0, grid_start(44));
  for (int i = 0; i < 40; ++i) step_one(backend, {1, 1, 2, 0});
  EXPECT_LE(tip(backend).z(), 0.119);
  EXPECT_GT(tip(backend).z(), 0.1185 - 1e-9);
  EXPECT_GT(backend.counters().axes_dropped, 0U);
  const double x = tip(backend).x();
  step_one(backend, {2, 1, 2, 0});
  EXPECT_NEAR(tip(backend).x(), x + 0.0005, 1e-12);
}

TEST(Observation, CompositionAndScaling) {
  SimBackend backend(setup_of("omentum"), 1, 1);
  backend.reset(0, grid_start(0));
  std::vector<float> o(20);
  backend.observe(0, o);
  const Scene& scene = backend.setup().scene;
  EXPECT_EQ(o[0], 1);  // not held
  for (int k = 0; k < 3; ++k) {
    const double middle = 0.5 * (scene.workspace_min[k] + scene.workspace_max[k]);
    const double half = 0.5 * (scene.workspace_max[k] - scene.workspace_min[k]);
    EXPECT_NEAR(o[static_cast<std::size_t>(1 + k)], (tip(backend)[k] - middle) / half, 1e-6);
    EXPECT_NEAR(o[static_cast<std::size_t>(4 + k)], (scene.tumour_point[k] - middle) / half, 1e-6);
    EXPECT_NEAR(o[static_cast<std::size_t>(7 + k)], (scene.target[k] - middle) / half, 1e-6);
  }
  EXPECT_NEAR(o[10],
              (tip(backend) - scene.tumour_point).norm() / backend.task().workspace_diagonal(),
              1e-6);
  EXPECT_NEAR(o[11], (tip(backend) - scene.target).norm() / backend.task().workspace_diagonal(),
              1e-6);
  EXPECT_EQ(o[12], 0);
  step_one(backend, {1, 1, 1, 1});
  backend.observe(0, o);
  EXPECT_NEAR(o[12], 8.0 / 24.0, 1e-6);  // 400 deg/s for 20 ms of an opening of 24 deg

  SimBackend head(setup_of("derived_head"), 1, 1);
  head.reset(0, grid_start(0));
  std::vector<float> raw(8);
  head.observe(0, raw);
  EXPECT_NEAR(raw[1], 10 * tip(head).x(), 1e-6);  // Unity x, y, z = W x, z, y in units of 100 mm
  EXPECT_NEAR(raw[2], 10 * tip(head).z(), 1e-6);
  EXPECT_NEAR(raw[3], 10 * tip(head).y(), 1e-6);
}

TEST(Observation, OmentumSeesTheWayLeftWithinFiveMillimetres) {
  // 2 mm beside q, 1 mm below it, far off in y: what counts near the goal fills the input range.
  SimBackend backend(
      setup_of("omentum", {"task.random_start=false", "scene.tool_start_m.x=0.0174",
                           "scene.tool_start_m.y=0.0321", "scene.tool_start_m.z=0.0226"}),
      1, 1);
  backend.reset(0, {});
  std::vector<float> seen(static_cast<std::size_t>(backend.observation_size()));
  backend.observe(0, seen);
  EXPECT_NEAR(seen[17], -0.4, 1e-6);
  EXPECT_EQ(seen[18], 1.0F);
  EXPECT_NEAR(seen[19], 0.2, 1e-6);
}

TEST(ArmEffects, ThePolicySeesTheEncodersAndTheTissueMeetsTheTrueTip) {
  const std::vector<std::string> effects = {"scene.arm.tool_length_offset_m=0.004",
                                            "scene.arm.transport_delay_s=0.04"};
  SimBackend backend(setup_of("omentum", effects), 1, 1);
  SimBackend nominal(setup_of("omentum"), 1, 1);
  backend.reset(0, grid_start(44));
  nominal.reset(0, grid_start(44));
  std::vector<float> seen(static_cast<std::size_t>(backend.observation_size()));
  std::vector<float> expected(seen.size());
  nominal.observe(0, expected);
  backend.observe(0, seen);
  for (std::size_t k = 1; k < 4; ++k) EXPECT_NEAR(seen[k], expected[k], 1e-6);
  EXPECT_NEAR(tip(nominal).z() - tip(backend).z(), 0.004, 1e-9);
  for (int i = 0; i < 10; ++i) step_one(backend, kDown);
  for (int i = 0; i < 8; ++i) step_one(nominal, kDown);  // two steps of delay
  EXPECT_NEAR(tip(nominal).z() - tip(backend).z(), 0.004, 1e-9);

  // The memory of the effects travels with the state.
  const Bytes state = backend.save(0);
  SimBackend other(setup_of("omentum", effects), 3, 1);
  ASSERT_TRUE(other.load(1, state).has_value());
  for (int i = 0; i < 5; ++i) {
    step_one(backend, {2, 1, 0, 1});
    step_one(other, {2, 1, 0, 1});
  }
  EXPECT_EQ(backend.save(0), other.save(1));
  EXPECT_FALSE(nominal.load(0, state).has_value()) << "a state with an arm's memory";
}

TEST(Grid, HundredDistinctStartsAtThePublishedPlaces) {
  const auto setup = setup_of("omentum");
  const auto& starts = setup->scene.grid_starts;
  ASSERT_EQ(starts.size(), 100U);
  EXPECT_NEAR(starts[0].x(), -0.0571, 5e-5);
  EXPECT_NEAR(starts[9].x(), 0.0227, 5e-5);
  EXPECT_NEAR(starts[0].y(), 0.0139, 5e-5);
  EXPECT_NEAR(starts[99].y(), 0.0933, 5e-5);
  EXPECT_NEAR(starts[50].z(), 0.1076, 1e-9);
  std::set<std::uint64_t> hashes;
  SimBackend backend(setup, 1, 1);
  for (std::uint32_t i = 0; i < 100; ++i) {
    backend.reset(0, grid_start(i));
    hashes.insert(fnv1a64(backend.save(0)));
  }
  EXPECT_EQ(hashes.size(), 100U);
  EXPECT_EQ(setup->scene.robot_starts.size(), 25U);
  EXPECT_NEAR(setup->scene.robot_starts[0].y(), starts[50].y(), 2e-5);  // rows 6-10
}

TEST(Grid, TrainingNeverStartsOnAnEvaluationCell) {
  const auto setup = setup_of("omentum");
  SimBackend backend(setup, 1, 1);
  Vector3d low = Vector3d::Constant(1);
  Vector3d high = Vector3d::Constant(-1);
  for (std::uint64_t episode = 0; episode < 300; ++episode) {
    EpisodeStart start;
    start.run_seed = 5;
    start.episode = episode;
    backend.reset(0, start);
    const Vector3d p = tip(backend);
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
    for (const Vector3d& cell : setup->scene.grid_starts) ASSERT_GT((p - cell).norm(), 1e-9);
  }
  EXPECT_LT(low.z(), 0.0976 + 0.001);  // height +- 10 mm is used
  EXPECT_GT(high.z(), 0.1176 - 0.001);
  EXPECT_GE(low.x(), -0.0572);
  EXPECT_LE(high.y(), 0.0934);
}

TEST(Episode, LengthsAndAccounting) {
  SimBackend paper(setup_of("paper_literal", {"task.episode_steps=30"}), 1, 1);
  paper.reset(0, grid_start(0));
  for (int i = 1; i < 30; ++i) ASSERT_FALSE(step_one(paper, kStay).truncated) << i;
  const StepOutcome last = step_one(paper, kStay);
  EXPECT_TRUE(last.truncated);
  EXPECT_FALSE(last.terminated);
  EXPECT_EQ(load_config("paper_literal", {}).task().episode_steps(), 1500U);
  EXPECT_EQ(paper.ticks_per_step(), 8U);  // four solver ticks of 2 x 5
  SimBackend derived(setup_of("derived"), 1, 1);
  EXPECT_EQ(derived.ticks_per_step(), 10U);  // five ticks of 2 substeps
  derived.reset(0, grid_start(0));
  EXPECT_EQ(derived.clock(0).episode_limit, 500U);  // 2500 ticks
}

TEST(Reset, IsComplete) {
  const auto setup = setup_of("omentum");
  SimBackend fresh(setup, 1, 1);
  fresh.reset(0, grid_start(12));
  const std::uint64_t expected = fnv1a64(fresh.save(0));
  SimBackend used(setup, 1, 1);
  ASSERT_TRUE(grasp_below(used));
  for (int i = 0; i < 50; ++i) step_one(used, {0, 1, 2, 1});
  ASSERT_TRUE(used.clock(0).held);
  EpisodeStart next = grid_start(12);
  next.follows_episode = true;
  used.reset(0, next);
  EXPECT_EQ(fnv1a64(used.save(0)), expected);
}

TEST(Reset, NamedDefectsCarryTheLastEpisodeOver) {
  for (const char* defect :
       {"defects.reset_positions_only=true", "defects.reset_patch_at_tool=true"}) {
    const auto setup = setup_of("paper_literal", {defect});
    SimBackend fresh(setup, 1, 1);
    fresh.reset(0, grid_start(12));
    SimBackend used(setup, 1, 1);
    ASSERT_TRUE(grasp_below(used));
    for (int i = 0; i < 20; ++i) step_one(used, {0, 1, 2, 1});
    EpisodeStart next = grid_start(12);
    next.follows_episode = true;
    used.reset(0, next);
    EXPECT_NE(fnv1a64(used.save(0)), fnv1a64(fresh.save(0))) << defect;
    used.reset(0, grid_start(12));  // a task's own first reset starts from nothing even then
    EXPECT_EQ(fnv1a64(used.save(0)), fnv1a64(fresh.save(0))) << defect;
  }
}

TEST(Reset, EveryTrainingStartIsAnotherUnlessTheGridIsStuck) {
  for (const bool stuck : {false, true}) {
    SimBackend backend(setup_of("omentum", {fmt::format("defects.grid_stuck={}", stuck)}), 1, 1);
    std::set<std::array<double, 3>> starts;
    for (std::uint64_t episode = 0; episode < 5; ++episode) {
      EpisodeStart start;
      start.run_seed = 1;
      start.episode = episode;
      backend.reset(0, start);
      starts.insert(backend.clock(0).start_position);
    }
    EXPECT_EQ(starts.size(), stuck ? 1u : 5u);
  }
}

TEST(Bonus, BelongsToItsEpisodeUnlessTheDefectIsNamed) {
  const auto returns = [](const std::string& next_episode) {
    SimBackend backend(
        setup_of("derived", {"defects.bonus_next_episode=" + next_episode, "grasp.radius_m=0.05"}),
        1, 1);
    EpisodeStart start = grid_start(44);
    start.episode_limit = 10000;
    backend.reset(0, start);
    StepOutcome outcome;
    for (int i = 0; i < 400 && !outcome.terminated; ++i) {
      std::vector<Action> actions(1);
      actions[0] = backend.clock(0).held ? backend.hold_action(0) : Action{{0, 2, 0, 0}, {}};
      std::vector<StepOutcome> outcomes(1);
      backend.step(actions, outcomes);
      outcome = outcomes[0];
    }
    EXPECT_TRUE(outcome.terminated);
    EpisodeStart next = grid_start(44);
    next.follows_episode = true;
    backend.reset(0, next);
    return std::pair<float, float>(outcome.reward, step_one(backend, {0, 0, 0, 0}).reward);
  };
  const auto ours = returns("false");
  const auto seed = returns("true");
  EXPECT_NEAR(ours.first - seed.first, 1.0, 1e-5);
  EXPECT_NEAR(seed.second - ours.second, 1.0, 1e-5);
}

}  // namespace
}  // namespace omentum
