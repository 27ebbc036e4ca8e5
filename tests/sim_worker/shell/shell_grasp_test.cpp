// The grasp of the elastic shell (docs/tissue.md 8): what it holds and what it leaves free.

#include <gtest/gtest.h>

#include <Eigen/QR>
#include <cmath>
#include <utility>
#include <vector>

#include "support/shell_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::make_shell_sheet;
using test::move_tool;
using test::rms_distance;
using test::run_free;
using test::ShellCase;

/// Mean position and slopes of a patch (SheetPatch).
template <typename Real>
Eigen::Matrix3d rows_of(const ShellTissue<Real>& tissue, int lane, const SheetPatch& patch) {
  Eigen::Matrix3d rows = Eigen::Matrix3d::Zero();
  for (std::size_t k = 0; k < patch.node.size(); ++k) {
    rows += tissue.position(lane, patch.node[k]) * patch.weight.row(static_cast<Eigen::Index>(k));
  }
  return rows;
}

/// Part of the unbalanced forces of a resting sheet that no force on these rows explains [N], and
/// the force on the mean.
std::pair<double, Vector3d> unexplained_force(ShellTissue<double>& tissue,
                                              const SheetPatch& patch) {
  const ShellTissueModel& model = tissue.model();
  Eigen::MatrixXd force(model.nodes(), 3);
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(model.nodes(), kPatchRows);
  const std::vector<Vector3d> gradient = tissue.elastic_gradient(0);
  for (int i = 0; i < model.nodes(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    force.row(i) = (gradient[k] - model.structure.mass[k] * model.surroundings.gravity).transpose();
    if (model.body.fixed[k] != 0) force.row(i).setZero();
  }
  for (std::size_t k = 0; k < patch.node.size(); ++k)
    rows.row(patch.node[k]) = patch.weight.row(static_cast<Eigen::Index>(k));
  const Eigen::MatrixXd on_rows = rows.colPivHouseholderQr().solve(force);
  return {(force - rows * on_rows).norm(), Vector3d(on_rows.row(0))};
}

// The means do what pinned nodes do: they go where the tool goes, and nothing else is held.
TEST(Elastic, GraspEqualsPinnedMeans) {
  ShellCase c;
  c.young = 30e3;
  c.damping = 20;
  const auto model = make_shell_sheet(c);
  ShellTissue<double> held(model, f64x1());
  ShellTissue<float> single(model, f32x1());
  const Vector3d tip(-0.0413, 0.0411, 0);
  const Vector3d way(0, -0.01, 0.02);
  const SheetPatch patch = model->make_patch({tip.x(), tip.y(), 0}, 0.004);
  const Eigen::Matrix3d start = rows_of(held, 0, patch);
  const auto miss = [&](const auto& tissue, const Vector3d& moved) {
    Eigen::Matrix3d rows = rows_of(tissue, 0, patch) - start;
    rows.col(0) -= moved;
    return rows.norm();
  };
  held.hold(0, tip, 0.004, false);
  single.hold(0, tip, 0.004, false);
  move_tool(held, tip, tip + way, 50);
  move_tool(single, tip, tip + way, 50);
  EXPECT_LT(miss(held, way), 1e-12);  // rounding, also while it moves
  EXPECT_LT(miss(single, way), 1e-7);
  move_tool(held, tip + way, tip + way, 300);
  move_tool(single, tip + way, tip + way, 300);
  EXPECT_LT(rms_distance(single, 0, held, 0), 2e-6);
  const auto [rest, force] = unexplained_force(held, patch);
  EXPECT_LT(rest, 1e-6);  // of 0.08 N of weight: what is left to settle
  EXPECT_LT((force + held.held_force(0)).norm(), 1e-6);
}

// Two meshes that share no node inside the patch hold the same tissue.
TEST(Elastic, PatchIsThatOfTheRestSheetWhateverTheMesh) {
  const Vector3d centre(0.0107, 0.0391, 0);
  for (const unsigned n : {31U, 46U, 61U}) {
    ShellCase c;
    c.nx = c.ny = n;
    c.pitch = 0.09 / (n - 1);
    const auto model = make_shell_sheet(c);
    const SheetPatch patch = model->make_patch(centre, 0.004);
    ShellTissue<double> tissue(model, f64x1());
    const Eigen::Matrix3d rows = rows_of(tissue, 0, patch);
    EXPECT_NEAR(patch.weight.col(0).sum(), 1, 1e-12);
    EXPECT_LT((rows.col(0) - centre).norm(), 1e-9) << n;
    EXPECT_NEAR(patch.weight.col(1).sum(), 0, 1e-12);
    EXPECT_NEAR(rows(1, 1), 0, 1e-9);  // the slope along x sees nothing of y
  }
}

TEST(Elastic, GraspCarriesTheWeightOfAHangingSheet) {
  ShellCase c;
  c.young = 30e3;
  c.damping = 10;
  c.anchor_max_y = -1;  // nothing else holds it
  for (const double radius : {0.0015, 0.005}) {
    ShellTissue<float> tissue(make_shell_sheet(c), f32x1());
    const Vector3d tip = tissue.position(0, 31 * 15 + 28);
    tissue.hold(0, tip, radius, false);
    move_tool(tissue, tip, tip, 400);
    const double weight = 1000 * 0.003 * 0.09 * 0.09 * 9.81;
    const Vector3d force = tissue.held_force(0);
    EXPECT_NEAR(force.z() / weight, -1.0, 0.01) << radius;
    EXPECT_LT(std::hypot(force.x(), force.y()), 0.01 * weight) << radius;
  }
}

TEST(Elastic, JawsTakeTheCornerOfASheetThatLiesFreeAndNothingOfAClamp) {
  for (const bool free : {true, false}) {
    ShellCase c;
    if (free) c.anchor_max_y = -1;
    ShellTissue<double> tissue(make_shell_sheet(c), f64x1());
    tissue.hold(0, tissue.position(0, 0), 0.004, false);
    EXPECT_EQ(tissue.held(0).empty(), !free);
  }
}

TEST(Elastic, GraspMovesSmoothlyWithThePinchPoint) {
  // The sheet lifted by pinches 0.25 mm apart: were whole nodes taken, the shape would stand still
  // and then jump when a row of nodes comes or goes.
  std::vector<double> height;
  for (int k = 0; k <= 12; ++k) {
    ShellCase c;
    c.young = 30e3;
    ShellTissue<double> tissue(make_shell_sheet(c), f64x1());
    const Vector3d tip(0, 0.03 + 0.00025 * k, 0);
    tissue.hold(0, tip, 0.004, false);
    move_tool(tissue, tip, tip, 150);
    height.push_back(tissue.position(0, 31 * 15 + 30).z());  // at the free edge
  }
  const double mean = (height.back() - height.front()) / 12;
  for (std::size_t k = 1; k < height.size(); ++k) {
    const double step = height[k] - height[k - 1];
    EXPECT_GT(step / mean, 0.2) << k;
    EXPECT_LT(step / mean, 2.0) << k;
  }
}

TEST(Elastic, AWidePatchHoldsAndLeavesOtherLanesAsTheyAre) {
  const auto model = make_shell_sheet({});
  ShellTissue<float> wide(model, f32x8());
  ShellTissue<float> narrow(model, f32x8());
  const Vector3d tip = wide.position(0, 480);
  wide.hold(0, tip, 0.004, false);
  narrow.hold(0, tip, 0.004, false);
  wide.hold(1, tip, 0.02, false);
  EXPECT_GT(wide.held(1).size(), 100U);
  move_tool(wide, tip, tip + Vector3d(0, 0, 0.01), 50);
  move_tool(narrow, tip, tip + Vector3d(0, 0, 0.01), 50);
  EXPECT_EQ(wide.hash(0), narrow.hash(0));
  const SheetPatch patch = model->make_patch({tip.x(), tip.y(), 0}, 0.02);
  EXPECT_LT((rows_of(wide, 1, patch).col(0) - tip - Vector3d(0, 0, 0.01)).norm(), 1e-6);
}

TEST(Oracle, ElasticLiftInSinglePrecisionFollowsDoublePrecision) {
  const auto lift = [](auto& tissue) {
    run_free(tissue, 1);
    const Vector3d tip = tissue.position(0, 31 * 1 + 29);
    tissue.hold(0, tip, 0.0045, false);
    const Vector3d top = tip + Vector3d(0, -0.02, 0.05);
    move_tool(tissue, tip, top, 110);
    move_tool(tissue, top, top, 400);
  };
  const auto model = make_shell_sheet({});
  ShellTissue<float> single(model, f32x1());
  ShellTissue<double> exact(model, f64x1());
  lift(single);
  lift(exact);
  EXPECT_LT(rms_distance(single, 0, exact, 0), 0.05e-3);  // docs/tissue.md 12
}

}  // namespace
}  // namespace omentum
