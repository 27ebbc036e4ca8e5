// Grasp of the converged solid (docs/tissue.md 12, 13).

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <vector>

#include "support/reference_scene.h"

namespace omentum {
namespace {

using namespace test;  // NOLINT(google-build-using-namespace)

TEST(ReferenceGrasp, ForceIsTheCarriedWeight) {
  ReferenceTissue tissue(make_model(free_sheet()));
  const Vector3d tip(0.004, 0.003, 0);
  tissue.hold(0, tip, 0.005, false);
  ASSERT_FALSE(tissue.held(0).empty());
  run(tissue, 150, tip);
  const double weight = tissue.model().total_mass * kGravity;
  EXPECT_LT((tissue.held_force(0) - Vector3d(0, 0, -weight)).norm(), 1e-4 * weight);
  tissue.release(0);
  EXPECT_TRUE(tissue.held(0).empty());
  run(tissue, 5, tip);
  EXPECT_LT(tissue.velocity(0, 60).z(), -0.3);  // falls, g / damping at most
}

TEST(ReferenceGrasp, PatchFollowsTheTipAndTheShift) {
  ReferenceCase c = free_sheet();
  c.gravity = 0;
  ReferenceTissue tissue(make_model(c));
  const Vector3d tip(0, 0, 0);
  tissue.hold(0, tip, 0.005, false);
  const Vector3d by(0.003, -0.002, 0.004);
  const ToolMotion motion{tip, tip + by};
  tissue.step({&motion, 1});
  run(tissue, 100, tip + by);
  EXPECT_LT((tissue.position(0, 60) - by).norm(), 1e-5);
  tissue.shift_held(0, Vector3d(0.001, 0, 0));
  run(tissue, 100, tip + by);
  EXPECT_LT((tissue.position(0, 60) - by - Vector3d(0.001, 0, 0)).norm(), 1e-5);
}

TEST(ReferenceGrasp, JawsThatAStretchedSheetPullsOnNeitherTurnNorDeformThePatch) {
  ReferenceCase c;
  c.nx = c.ny = 11;
  c.anchor = -0.015;
  c.ex = c.ey = 8;
  c.young = 2e5;
  c.poisson = 0.45;
  c.damping = 20;
  c.period = 0.2;
  c.integrator = pb::INTEGRATOR_BACKWARD_EULER;
  const auto model = make_model(c);
  ReferenceTissue tissue(model);
  const Vector3d tip(0.004, 0.008, 0);
  const double radius = 0.003;
  const GraspPatch patch = model->make_patch(tip.head<2>(), radius);
  const auto rows = [&] {
    Eigen::Matrix<double, 3, GraspPatch::kRows> sum;
    sum.setZero();
    for (std::size_t k = 0; k < patch.node.size(); ++k)
      sum += tissue.node_positions()[static_cast<std::size_t>(patch.node[k])] *
             patch.weight.row(static_cast<Eigen::Index>(k));
    return sum;
  };
  auto expected = rows();
  tissue.hold(0, tip, radius, false);
  const Vector3d way(0.001, 0.004, 0.002);
  for (int s = 0; s < 10; ++s) {
    const ToolMotion motion{tip + 0.1 * s * way, tip + 0.1 * (s + 1) * way};
    tissue.step({&motion, 1});
  }
  run(tissue, 10, tip + way);
  expected.col(0) += way;
  EXPECT_GT(tissue.held_force(0).norm(), 0.5);
  // 5 N on a row and 1e-9 m/N; with 1e-6 m/N a row is off by 3.8 um, a slope of 1.3e-3.
  EXPECT_LT((rows() - expected).cwiseAbs().maxCoeff(), 1e-8);
}

TEST(ReferenceGrasp, HoldsTheSameMeansWhereLayersCrowdAtTheFaces) {
  // Of a linear field the means are exact: of the position the centre, of the slopes the second
  // moments of a disc and of the thickness.
  ReferenceCase c;
  c.nx = c.ny = 11;
  c.anchor = -0.015;
  c.law = pb::LAW_NEO_HOOKE;
  const Eigen::Vector2d centre(0.004, 0.001);
  const double radius = 0.004;
  Eigen::Matrix<double, 3, GraspPatch::kRows> expected;
  expected.setZero();
  expected.col(0).head<2>() = centre;
  expected(0, 1) = expected(1, 2) = radius / 4;
  expected(2, 3) = c.thickness / 6;
  for (const bool crowded : {false, true}) {
    c.ex = c.ey = crowded ? 0 : 8;
    c.ez = crowded ? 0 : 3;
    const auto model = make_model(c);
    const std::vector<double>& lines = model->lines[2];
    ASSERT_EQ(lines[2] - lines[1] > 1.5 * (lines[1] - lines[0]), crowded);
    const GraspPatch patch = model->make_patch(centre, radius);
    Eigen::Matrix<double, 3, GraspPatch::kRows> rows;
    rows.setZero();
    for (std::size_t k = 0; k < patch.node.size(); ++k)
      rows += model->nodes[static_cast<std::size_t>(patch.node[k])] *
              patch.weight.row(static_cast<Eigen::Index>(k));
    EXPECT_LT((rows - expected).cwiseAbs().maxCoeff(), 1e-9) << rows << "\n" << expected;
  }
}

TEST(ReferenceGrasp, FixedTissueCannotBeHeld) {
  ReferenceCase c = free_sheet();
  c.anchor = -0.009;
  ReferenceTissue tissue(make_model(c));
  tissue.hold(0, Vector3d(0, -0.012, 0), 0.002, false);
  EXPECT_TRUE(tissue.held(0).empty());
  tissue.hold(0, Vector3d(0, 0, 0.006), 0.005, false);  // too far above
  EXPECT_TRUE(tissue.held(0).empty());
}

TEST(ReferenceGrasp, MovesSmoothlyWithThePinchPoint) {
  // Far corner of a clamped sheet lifted at pinch points 0.1 mm apart, across element borders and
  // near the edge: neighbours differ by little, evenly.
  ReferenceCase c;
  c.nx = c.ny = 11;
  c.anchor = -0.015;
  c.ex = c.ey = 8;
  c.young = 3e4;
  c.poisson = 0.4;
  c.damping = 20;
  c.period = 0.2;
  const auto model = make_model(c);
  std::vector<Vector3d> corner;
  for (int k = 0; k < 12; ++k) {
    const Vector3d tip(0.0085 + 1e-4 * k, 0.0105, 0);
    ReferenceTissue tissue(model);
    tissue.hold(0, tip, 0.003, false);
    const Vector3d lifted = tip + Vector3d(0, 0, 0.01);
    for (int s = 0; s < 10; ++s) {
      const ToolMotion motion{tip + 0.1 * s * (lifted - tip), tip + 0.1 * (s + 1) * (lifted - tip)};
      tissue.step({&motion, 1});
    }
    run(tissue, 20, lifted);
    corner.push_back(tissue.position(0, 10));
  }
  double largest = 0;
  double unevenness = 0;
  for (std::size_t k = 1; k < corner.size(); ++k) {
    largest = std::max(largest, (corner[k] - corner[k - 1]).norm());
    if (k > 1) {
      unevenness = std::max(unevenness, (corner[k] - 2 * corner[k - 1] + corner[k - 2]).norm());
    }
  }
  std::printf(
      "# pinch moved by 0.1 mm: far corner moves %.4f mm at most, second difference %.4f mm\n",
      1e3 * largest, 1e3 * unevenness);
  EXPECT_LT(largest, 1.5e-4);
  EXPECT_LT(unevenness, 2e-5);
}

}  // namespace
}  // namespace omentum
