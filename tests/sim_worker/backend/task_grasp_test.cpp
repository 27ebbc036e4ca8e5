// Grasp and contact of the task to the letter (docs/task.md) on the shipped presets.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <string>
#include <vector>

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

}  // namespace
}  // namespace omentum
