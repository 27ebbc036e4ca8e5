// State and mesh of the converged solid (docs/tissue.md 12, 13).

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "core/check.h"
#include "sim_worker/models.h"
#include "support/reference_scene.h"

namespace omentum {
namespace {

using namespace test;  // NOLINT(google-build-using-namespace)

TEST(ReferenceState, RoundTripContinuesBitForBit) {
  ReferenceCase c = free_sheet();
  c.bodies = {make_slope(0)};
  c.static_friction = 0.3;
  c.dynamic_friction = 0.2;
  c.X_WB.translation().z() = 0.0015;
  const auto model = make_model(c);
  ReferenceTissue tissue(model);
  const Vector3d tip(0.01, 0.01, 0.0015);
  tissue.set_parameters(0, {1.1, 0.9, 1.2, 0.8});
  tissue.hold(0, tip, 0.004, false);
  const ToolMotion lift{tip, tip + Vector3d(0, 0, 0.002)};
  tissue.step({&lift, 1});
  tissue.step({&lift, 1});
  Bytes state;
  tissue.save(0, state);
  ReferenceTissue other(model);
  const auto used = other.load(0, state);
  ASSERT_TRUE(used) << used.error();
  EXPECT_EQ(used.value(), state.size());
  EXPECT_EQ(other.hash(0), tissue.hash(0));
  EXPECT_EQ(other.held_force(0), tissue.held_force(0));
  for (int i = 0; i < 3; ++i) {
    tissue.step({&lift, 1});
    other.step({&lift, 1});
    EXPECT_EQ(other.hash(0), tissue.hash(0));
  }
}

TEST(ReferenceState, BadBytesAreRefusedAndChangeNothing) {
  const auto model = make_model(free_sheet());
  ReferenceTissue tissue(model);
  tissue.hold(0, Vector3d::Zero(), 0.004, false);
  Bytes state;
  tissue.save(0, state);
  const std::uint64_t before = tissue.hash(0);
  for (const std::size_t size : {std::size_t{0}, state.size() / 2, state.size() - 1}) {
    EXPECT_FALSE(tissue.load(0, {state.data(), size}));
  }
  const double bad = std::numeric_limits<double>::quiet_NaN();
  for (const std::size_t at : {std::size_t{0}, state.size() / 2 / 8 * 8, state.size() - 8}) {
    Bytes spoiled = state;
    std::memcpy(spoiled.data() + at, &bad, sizeof bad);
    EXPECT_FALSE(tissue.load(0, spoiled));
  }
  EXPECT_EQ(tissue.hash(0), before);
}

TEST(ReferenceState, StepThatCannotConvergeMarksTheTissue) {
  ReferenceTissue tissue(make_model(free_sheet()));
  tissue.set_velocity(0, 60, Vector3d(std::nan(""), 0, 0));
  EXPECT_FALSE(tissue.healthy(0));
  const ToolMotion still{Vector3d::UnitZ(), Vector3d::UnitZ()};
  tissue.step({&still, 1});
  EXPECT_FALSE(tissue.healthy(0));
  EXPECT_FALSE(tissue.failure(0).empty());
  tissue.reset(0, Vector3d::Zero());
  EXPECT_TRUE(tissue.healthy(0));
  run(tissue, 1);
}

TEST(ReferenceState, LanesOfSinglePrecisionAreRefused) {
  const auto model = make_model(free_sheet());
  EXPECT_THROW(static_cast<void>(model->make_tissue(f32x1())), Error);
  EXPECT_EQ(model->make_tissue(f64x1())->lanes(), 1);
}

// ---- mesh ---------------------------------------------------------------------------------------

TEST(ReferenceMesh, SceneChoosesTheModelAndVolumesAreRefused) {
  std::vector<std::string> warnings;
  Scene scene = make_reference_scene(free_sheet());
  const auto model = make_tissue_model(scene, 0.02, warnings);
  EXPECT_NE(dynamic_cast<const ReferenceTissueModel*>(model.get()), nullptr);
  EXPECT_EQ(model->substeps(), 1U);
  scene.tissue.surface_is_particles = false;
  EXPECT_THROW(static_cast<void>(make_tissue_model(scene, 0.02, warnings)), Error);
}

TEST(ReferenceMesh, GridLinesLieOnClampAndPatchEdges) {
  ReferenceCase c;
  c.nx = c.ny = 31;
  c.anchor = -0.0413;
  c.ex = c.ey = 24;
  c.pinches = {{{0.0251, 0.0352}, 0.005}, {{0.044, -0.01}, 0.005}};  // the second cut by the edge
  const auto model = make_model(c);
  const auto has_line = [&](std::size_t axis, double at) {
    for (const double line : model->lines[axis]) {
      if (std::fabs(line - at) < 1e-12) return true;
    }
    return false;
  };
  EXPECT_TRUE(has_line(1, c.anchor));
  for (const double x : {0.0201, 0.0301, 0.039}) EXPECT_TRUE(has_line(0, x)) << x;
  for (const double y : {0.0302, 0.0402, -0.015, -0.005}) EXPECT_TRUE(has_line(1, y)) << y;
  EXPECT_EQ(model->lines[0].size(), 25U);
  EXPECT_EQ(model->lines[1].size(), 26U);  // one more for the clamped strip
  double mass = 0;
  for (std::size_t axis = 0; axis < 2; ++axis) {
    for (std::size_t k = 1; k < model->lines[axis].size(); ++k)
      EXPECT_GT(model->lines[axis][k], model->lines[axis][k - 1]);
  }
  for (const double m : model->mass) mass += m;
  EXPECT_NEAR(mass, 1000 * 0.09 * 0.09 * 0.003, 1e-12);
}

}  // namespace
}  // namespace omentum
