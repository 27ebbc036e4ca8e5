// The task to the letter (docs/task.md) on the shipped presets.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include "core/config.h"
#include "core/reward.h"
#include "core/rng.h"
#include "sim_worker/backend/sim_backend.h"
#include "sim_worker/cluster/cluster_tissue.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

/// Preset omentum with decisions of one control period, by which these tests count.
std::shared_ptr<const SimSetup> setup_of(const std::string& preset,
                                         const std::vector<std::string>& overrides = {}) {
  std::vector<std::string> all;
  if (preset == "omentum") all.emplace_back("task.action_repeat=1");
  all.insert(all.end(), overrides.begin(), overrides.end());
  return make_sim_setup(load_config(preset, all), deploy_dir() + "/scenes");
}

EpisodeStart grid_start(std::uint32_t index) {
  EpisodeStart start;
  start.start_set = StartSet::kGrid;
  start.start_index = index;
  return start;
}

/// Steps one environment with branch indices x, y, z, gripper.
StepOutcome step_one(SimBackend& backend, std::array<std::uint8_t, 4> branch) {
  std::vector<Action> actions(static_cast<std::size_t>(backend.lanes()));
  std::vector<StepOutcome> outcomes(actions.size());
  for (Action& a : actions) std::ranges::copy(branch, a.branch.begin());
  backend.step(actions, outcomes);
  return outcomes[0];
}

Vector3d tip(const SimBackend& backend, int lane = 0) {
  const EpisodeFacts f = backend.clock(lane);
  return {f.tool_position[0], f.tool_position[1], f.tool_position[2]};
}

constexpr std::array<std::uint8_t, 4> kStay = {1, 1, 1, 0};
constexpr std::array<std::uint8_t, 4> kDown = {1, 1, 0, 0};

const Clusters& clusters_of(const SimSetup& setup) {
  return dynamic_cast<const ClusterTissueModel&>(*setup.tissue).clusters;
}

TEST(Scene, PaperHas900Particles) {
  const auto setup = setup_of("paper_literal");
  const TissueBody& body = setup->scene.tissue;
  EXPECT_EQ(body.particles.size(), 900U);
  EXPECT_EQ(std::count(body.fixed.begin(), body.fixed.end(), 1), 60);
  EXPECT_NEAR(body.particles.front().x(), -0.0435, 1e-12);
  EXPECT_NEAR(body.particles.back().y(), 0.0435, 1e-12);
  EXPECT_EQ(clusters_of(*setup).attached, 8);
}

TEST(Scene, OmentumHas961ParticlesAndNoOrphans) {
  const auto setup = setup_of("omentum");
  EXPECT_EQ(setup->scene.tissue.particles.size(), 961U);
  EXPECT_EQ(std::count(setup->scene.tissue.fixed.begin(), setup->scene.tissue.fixed.end(), 1), 62);
  EXPECT_TRUE(clusters_of(*setup).orphans.empty());
}

TEST(Scene, DerivedSampling) {
  const auto setup = setup_of("derived");
  const auto& particles = setup->scene.tissue.particles;
  EXPECT_EQ(particles.size(), 2997U);
  Vector3d extent = Vector3d::Zero();
  for (const Vector3d& p : particles) extent = extent.cwiseMax(p.cwiseAbs());
  EXPECT_NEAR(extent.x(), 0.0439, 1e-5);
  EXPECT_NEAR(extent.z(), 0.00079, 1e-5);
}

TEST(Scene, OrphansOfPaperOptimumAreRefusedByNumber) {
  try {
    setup_of("paper_literal", {"scene.tissue.cluster.orphan_policy=ORPHANS_REJECT"});
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("leaves 8 of the particles"));
  }
}

TEST(Units, GravityGuard) {
  EXPECT_THAT(setup_of("paper_literal")->warnings,
              testing::Not(testing::Contains(testing::HasSubstr("gravity"))));
  EXPECT_THAT(setup_of("paper_literal", {"scene.gravity_m_per_s2=0.981"})->warnings,
              testing::Contains(testing::HasSubstr("gravity_m_per_s2: 0.981")));
  const auto derived = setup_of("derived");
  EXPECT_THAT(derived->warnings, testing::Not(testing::Contains(testing::HasSubstr("gravity"))));
  EXPECT_NEAR(derived->scene.gravity.z(), -0.980665, 1e-12);
}

TEST(Units, SpeedGuardWarnsAboveFiftyMillimetresPerSecond) {
  EXPECT_THAT(setup_of("derived")->warnings,
              testing::Contains(testing::HasSubstr("0.1 m/s per axis")));
  EXPECT_THAT(setup_of("paper_literal")->warnings,
              testing::Not(testing::Contains(testing::HasSubstr("m/s per axis"))));
}

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

/// Brings the tool of lane 0 onto the sheet above a point and closes the jaw; true if it holds.
bool grasp_below(SimBackend& backend, double dx = 0, double dy = 0) {
  EpisodeStart start = grid_start(44);
  start.episode_limit = 100000;
  backend.reset(0, start);
  for (int i = 0; i < 40; ++i)
    step_one(backend, {static_cast<std::uint8_t>(dx > 0   ? 2
                                                 : dx < 0 ? 0
                                                          : 1),
                       static_cast<std::uint8_t>(dy > 0   ? 2
                                                 : dy < 0 ? 0
                                                          : 1),
                       1, 0});
  const bool paced = backend.setup().config.grasp().jaw_open_deg() > 0;
  for (int i = 0; i < 260; ++i) {
    std::vector<Nearest> nearest(static_cast<std::size_t>(backend.tissue_of(0).lanes()));
    std::vector<Vector3d> points(nearest.size(), tip(backend));
    backend.tissue_of(0).find_nearest(points, nearest);
    if (nearest[0].distance < (paced ? 0.0014 : 0.002)) break;
    step_one(backend, kDown);
  }
  for (int i = 0; i < 8; ++i) step_one(backend, {1, 1, 1, 1});
  return backend.clock(0).held;
}

TEST(Grasp, PatchKeepsItsShapeAndMovesRigidly) {
  SimBackend backend(setup_of("paper_literal"), 1, 1);
  ASSERT_TRUE(grasp_below(backend));
  Tissue<float>& tissue = backend.tissue_of(0);
  const auto held = tissue.held(0);
  ASSERT_GE(held.size(), 3U);
  std::vector<Vector3d> before;
  for (const int i : held) before.push_back(tissue.position(0, i) - tip(backend));
  for (int i = 0; i < 100; ++i) step_one(backend, {0, 1, 2, 1});
  for (std::size_t k = 0; k < held.size(); ++k) {
    EXPECT_LT((tissue.position(0, held[k]) - tip(backend) - before[k]).norm(), 1e-7);
  }
  // Held particles lie within the patch radius, and every free one within it is held.
  for (const Vector3d& offset : before) EXPECT_LE(offset.norm(), 0.005 + 0.0005);
}

TEST(Grasp, APinchTakesTheSheetBetweenItsParticles) {
  // 1 mm above the middle of a cell of the flat sheet: 2.3 mm from every particle.
  const auto holds = [](const std::string& pinch) {
    const auto base = load_config("omentum", {});
    const Scene scene = make_scene(base.scene(), deploy_dir() + "/scenes");
    const Vector3d p_W = scene.tissue.X_WB * Vector3d(0.0015, 0.0015, 0.001);
    SimBackend backend(setup_of("omentum", {"task.random_start=false", "scene.gravity_m_per_s2=0",
                                            fmt::format("scene.tool_start_m.x={}", p_W.x()),
                                            fmt::format("scene.tool_start_m.y={}", p_W.y()),
                                            fmt::format("scene.tool_start_m.z={}", p_W.z()),
                                            "grasp.min_pinch_m=" + pinch}),
                       1, 1);
    backend.reset(0, {});
    for (int i = 0; i < 3; ++i) step_one(backend, {1, 1, 1, 1});
    return backend.clock(0).held;
  };
  EXPECT_TRUE(holds("0.0003"));
  EXPECT_FALSE(holds("0.0015")) << "1 mm of tissue lies between the jaws";
  EXPECT_FALSE(holds("0")) << "the plain grasp knows particles only";
}

TEST(Grasp, CollapsesOnlyByNamedDefect) {
  SimBackend backend(setup_of("paper_literal", {"defects.grasp_collapse_to_point=true"}), 1, 1);
  ASSERT_TRUE(grasp_below(backend));
  step_one(backend, {1, 1, 1, 1});
  for (const int i : backend.tissue_of(0).held(0)) {
    EXPECT_LT((backend.tissue_of(0).position(0, i) - tip(backend)).norm(), 1e-7);
  }
}

TEST(Grasp, OpeningReleases) {
  SimBackend backend(setup_of("paper_literal"), 1, 1);
  ASSERT_TRUE(grasp_below(backend));
  step_one(backend, {1, 1, 2, 0});
  EXPECT_FALSE(backend.clock(0).held);
}

// The reading of P III-B in which taking hold is an event and not a state of the jaw
// (docs/decisions/0031).
TEST(Grasp, AutomaticGraspOutlastsAnOpenJawAndStillNeedsAClosedOne) {
  SimBackend backend(setup_of("paper_literal", {"grasp.automatic=true"}), 1, 1);
  ASSERT_TRUE(grasp_below(backend));
  for (int i = 0; i < 5; ++i) step_one(backend, {1, 1, 2, 0});
  EXPECT_TRUE(backend.clock(0).held);
  backend.reset(0, grid_start(44));
  EXPECT_FALSE(backend.clock(0).held);
  for (int i = 0; i < 300 && !backend.clock(0).held; ++i) step_one(backend, kDown);
  EXPECT_FALSE(backend.clock(0).held) << "it went through the sheet with its jaw open";
}

TEST(Grasp, SheetOnlyUnlessTheDefectIsNamed) {
  // The tip at the tumour's pole, sheet far away: nothing to hold for us, the organ for the seed.
  const auto hold = [](const std::vector<std::string>& overrides) {
    SimBackend backend(setup_of("paper_literal", overrides), 1, 1);
    EpisodeStart start;
    backend.reset(0, start);
    Tissue<float>& tissue = backend.tissue_of(0);
    for (int i = 0; i < tissue.particles(); ++i)
      tissue.set_position(0, i, tissue.position(0, i) + Vector3d(0, 0, 0.3));
    Bytes state = backend.save(0);
    const double pole[3] = {0.0109, 0.0361, 0.0192 + 0.0137 + 0.001};
    std::memcpy(state.data(), pole, sizeof pole);
    EXPECT_TRUE(backend.load(0, state).has_value());
    step_one(backend, {1, 1, 1, 1});
    return backend.clock(0).held;
  };
  EXPECT_FALSE(hold({}));
  EXPECT_TRUE(hold({"defects.grasp_any_body=true"}));
}

TEST(Contact, TipReachesTwoMillimetresFromTheSheetWithToolContactOn) {
  SimBackend backend(setup_of("omentum"), 1, 1);
  ASSERT_TRUE(backend.setup().config.scene().tool().contact());
  EpisodeStart start = grid_start(44);
  start.episode_limit = 100000;
  backend.reset(0, start);
  double nearest_ever = 1;
  for (int i = 0; i < 200; ++i) {
    step_one(backend, kDown);
    std::vector<Nearest> nearest(1);
    const std::vector<Vector3d> points = {tip(backend)};
    backend.tissue_of(0).find_nearest(points, nearest);
    nearest_ever = std::min(nearest_ever, nearest[0].distance);
  }
  EXPECT_LT(nearest_ever, 0.002);
}

TEST(Contact, SettledSheetDoesNotPenetrateTheOrgans) {
  SimBackend backend(setup_of("omentum"), 1, 1);
  backend.reset(0, grid_start(0));
  for (int i = 0; i < 200; ++i) step_one(backend, kStay);
  const Scene& scene = backend.setup().scene;
  for (int i = 0; i < backend.tissue_of(0).particles(); ++i) {
    const Vector3d p = backend.tissue_of(0).position(0, i);
    if (scene.tissue.fixed[static_cast<std::size_t>(i)] != 0) continue;
    EXPECT_GT(p.z(), 0.0015 - 2e-4) << i;
    for (const RigidShape& body : scene.bodies) {
      if (body.kind != RigidShape::Kind::kEllipsoid && body.kind != RigidShape::Kind::kSphere)
        continue;
      const Vector3d local = body.X_WS.inverse() * p;
      const double k0 = local.cwiseQuotient(body.size).norm();
      const double k1 = local.cwiseQuotient(body.size.cwiseProduct(body.size)).norm();
      EXPECT_GT(k0 * (k0 - 1) / k1, 0.0015 - 3e-4)
          << body.name << " particle " << i;  // one substep of fall
    }
  }
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

TEST(BadInput, EffectsAreRefusedWithTheirPlace) {
  const auto message = [](const auto& make) -> std::string {
    try {
      make();
    } catch (const Error& error) {
      return error.what();
    }
    return "accepted";
  };
  using testing::AllOf;
  using testing::HasSubstr;
  using testing::StartsWith;
  EXPECT_THAT(message([] {
                parse_config("given.txtpb",
                             "scene {\n  tissue {\n    effects { strain_stiffening: 400 }\n  }\n}");
              }),
              AllOf(StartsWith("given.txtpb:3:15: scene.tissue.effects.strain_stiffening: 400"),
                    HasSubstr("allowed -0.5 ... 50")));
  EXPECT_THAT(message([] {
                parse_config("given.txtpb",
                             "scene {\n  tissue {\n    effects { wobble: 1 }\n  }\n}");
              }),
              AllOf(StartsWith("given.txtpb:3:"), HasSubstr("wobble")));
  const auto drawn = [&](const std::string& parameter, const std::string& model) {
    return message([&] {
      setup_of("omentum", {"scene.tissue.model=" + model,
                           "randomise={ parameter: \"" + parameter + "\" min: 0.1 max: 0.4 }"});
    });
  };
  EXPECT_THAT(drawn("tissue.effects.wobble", "TISSUE_ELASTIC"), HasSubstr("wobble"));
  EXPECT_THAT(drawn("tissue.effects.poisson_change", "TISSUE_ELASTIC"), HasSubstr("0.49"));
  EXPECT_THAT(drawn("tissue.effects.strain_stiffening", "TISSUE_CLUSTER"),
              HasSubstr("not possible with TISSUE_CLUSTER"));
  EXPECT_THAT(drawn("tissue.effects.obstacle.radius_m", "TISSUE_ELASTIC"),
              HasSubstr("part of the scene"));
  EXPECT_THAT(drawn("tissue.effects.anchor.compliance_m2_per_n", "TISSUE_ELASTIC"),
              HasSubstr("above 0"));
}

TEST(Obstacle, IsOneMoreBodyOfTheScene) {
  const auto plain = setup_of("omentum", {});
  const auto with = setup_of("omentum", {"scene.tissue.effects.obstacle={ x_m: 0.01 z_m: 0.09 "
                                         "radius_m: 0.008 }"});
  ASSERT_EQ(with->scene.bodies.size(), plain->scene.bodies.size() + 1);
  const RigidShape& body = with->scene.bodies.back();
  EXPECT_EQ(body.role, pb::ROLE_OBSTACLE);
  EXPECT_EQ(body.size.x(), 0.008);
  EXPECT_EQ(body.X_WS.translation().z(), 0.09);
}

TEST(BadInput, OneLineNamesKnobValueAndRange) {
  const auto message = [](const std::string& preset,
                          const std::vector<std::string>& overrides) -> std::string {
    try {
      setup_of(preset, overrides);
    } catch (const Error& error) {
      return error.what();
    }
    return "accepted";
  };
  using testing::HasSubstr;
  EXPECT_THAT(message("omentum", {"task.increment_m=5"}),
              testing::AllOf(HasSubstr("task.increment_m: 5 m"), HasSubstr("0.01")));
  EXPECT_THAT(message("omentum", {"task.increment_m=nan"}), HasSubstr("task.increment_m: nan"));
  EXPECT_THAT(message("omentum", {"task.incremnt_m=0.001"}),
              HasSubstr("no field named \"incremnt_m\""));
  EXPECT_THAT(message("omentum", {"task.increment_m=fast"}),
              HasSubstr("--set task.increment_m=fast"));
  EXPECT_THAT(message("nothing", {}), HasSubstr("allowed: derived, derived_head, omentum"));
  EXPECT_THAT(message("omentum", {"scene.target_m={ x: 3 y: 0 z: 0 }"}),
              HasSubstr("scene.target_m"));
  EXPECT_THAT(message("omentum", {"scene.target_m={ x: 300 y: 0 z: 0 }"}),
              HasSubstr("-100 ... 100"));
  EXPECT_THAT(message("omentum", {"scene.tissue.grid.pitch_m=0.09"}),
              HasSubstr("are the lengths in metres"));
  EXPECT_THAT(message("omentum", {"scene.rigid_body={ mesh { path: \"none.obj\" } }"}),
              HasSubstr("none.obj"));
  EXPECT_THAT(message("omentum", {"scene.tissue.anchor_max_y_m=-1"}), HasSubstr("anchor_max_y_m"));
}

}  // namespace
}  // namespace omentum
