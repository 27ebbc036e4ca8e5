// The elastic shell on a mesh without order, flat and curved, and its map of thickness.

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <utility>

#include "core/constants.h"
#include "support/elastic_energy.h"
#include "support/shell_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::make_irregular_mesh;
using test::make_shell_mesh;
using test::rms_distance;
using test::run_free;
using test::ShellCase;

constexpr double kJitter = 0.25;  // of the pitch

TEST(SheetMesh, CurvatureIsExactForQuadricsRimIncluded) {
  ShellCase c;
  c.nx = 12;
  c.ny = 9;
  const TriangleMesh mesh = make_irregular_mesh(c, kJitter);
  const SheetGeometry sheet = measure_sheet("mesh", mesh.vertices, mesh.triangles);
  const auto quadric = [](const Vector3d& p) {
    return 3 + 2 * p.x() - p.y() + 40 * p.x() * p.x() - 25 * p.y() * p.y() + 60 * p.x() * p.y();
  };
  for (const CurvatureStencil& at : sheet.curvature) {
    const Vector3d& base = mesh.vertices[static_cast<std::size_t>(at.base)];
    Eigen::Matrix<double, 5, 1> derivatives = Eigen::Matrix<double, 5, 1>::Zero();
    for (std::size_t k = 0; k < at.node.size(); ++k) {
      const Vector3d& p = mesh.vertices[static_cast<std::size_t>(at.node[k])];
      derivatives += (quadric(p) - quadric(base)) * at.weight[k];
    }
    EXPECT_LT((derivatives.head<3>() - Vector3d(80, -50, 60)).norm(), 1e-8);
    const Eigen::Vector2d slope(2 + 80 * base.x() + 60 * base.y(),
                                -1 - 50 * base.y() + 60 * base.x());
    EXPECT_LT((derivatives.tail<2>() - slope).norm(), 1e-10);
    EXPECT_LT(curvature(at, mesh.vertices).norm(), 1e-9);
  }
}

TEST(SheetMesh, BendingIsThatOfThePlateAboutEveryAxis) {
  ShellCase c;
  c.poisson = 0.3;
  c.anchor_max_y = -1;
  const auto model = make_shell_mesh(c, make_irregular_mesh(c, kJitter));
  const double plate = c.young * std::pow(c.thickness, 3) / 12 / (1 - 0.09);
  for (const double angle : {0.0, 0.4, kPi / 4, kPi / 2}) {
    constexpr double kCurvature = 0.01;  // [1/m]: second order in the slopes is left out
    const Vector3d across(std::cos(angle), std::sin(angle), 0);
    std::vector<Vector3d> p = model->body.particles;
    for (Vector3d& q : p) q.z() = 0.5 * kCurvature * q.dot(across) * q.dot(across);
    const double exact = 0.5 * plate * kCurvature * kCurvature * 0.09 * 0.09;
    EXPECT_NEAR(shell_energy(*model, p).bending / exact, 1, 1e-6) << angle;
  }
}

TEST(SheetMesh, GradientIsTheDerivativeOfTheEnergy) {
  ShellCase c;
  c.nx = c.ny = 9;
  c.poisson = 0.3;
  c.anchor_max_y = -1;
  const auto model = make_shell_mesh(c, make_irregular_mesh(c, kJitter));
  ShellTissue<double> tissue(model, f64x1());
  std::vector<Vector3d> p;
  for (int i = 0; i < tissue.particles(); ++i) {
    p.push_back(tissue.position(0, i) +
                1e-3 * Vector3d(std::sin(7 * i), std::cos(5 * i), std::sin(3 * i)));
    tissue.set_position(0, i, p.back());
  }
  test::expect_gradient_of_energy(tissue, p);
}

/// Mean place of the nodes at the largest y_B.
Vector3d free_edge(const ShellTissue<double>& tissue) {
  double far = -1;
  for (const Vector3d& p : tissue.model().body.particles) far = std::max(far, p.y());
  Vector3d sum = Vector3d::Zero();
  int count = 0;
  for (int i = 0; i < tissue.particles(); ++i) {
    if (tissue.model().body.particles[static_cast<std::size_t>(i)].y() < far - 1e-6) continue;
    sum += tissue.position(0, i);
    ++count;
  }
  return sum / count;
}

TEST(SheetMesh, HangingSheetStretchesByTheClosedForm) {
  ShellCase c;
  c.X_WB.linear() = Eigen::AngleAxisd(-kPi / 2, Vector3d::UnitX()).toRotationMatrix();
  ShellTissue<double> tissue(make_shell_mesh(c, make_irregular_mesh(c, kJitter)), f64x1());
  run_free(tissue, 6);
  const double expected = 1000 * c.gravity * 0.09 * 0.09 / (2 * c.young);
  EXPECT_NEAR((-0.045 - free_edge(tissue).z()) / expected, 1.0, 0.005);
}

TEST(SheetMesh, CantileverFollowsTheHeavyElastica) {
  // As Elastic.CantileverFollowsTheHeavyElastica.
  for (const auto& [load, expected] : {std::pair{0.907, 0.11218}, std::pair{9.07, 0.67504}}) {
    ShellCase c;
    c.damping = 10;
    c.anchor_max_y = -0.045 + 1.01 * c.pitch;
    const double length = 0.09 - c.pitch;
    c.young = 12 * 1000 * c.gravity * std::pow(length, 3) / (c.thickness * c.thickness * load);
    ShellTissue<double> tissue(make_shell_mesh(c, make_irregular_mesh(c, kJitter)), f64x1());
    run_free(tissue, 4);
    const double stretch = load * std::pow(c.thickness / length, 2) / 24;
    EXPECT_NEAR(-free_edge(tissue).z() / length / expected, 1 + stretch, 0.01) << load;
  }
}

TEST(SheetMesh, ALiftIsThatOfTheGrid) {
  ShellCase c;
  c.young = 60e3;
  c.poisson = 0.4;
  c.anchor_max_y = -0.0419;
  const auto lift = [](ShellTissue<double>& tissue) {
    const Vector3d tip(0.03, 0.03, 0);
    tissue.hold(0, tip, 0.005, false);
    for (int step = 0; step < 200; ++step) {
      const auto at = [&](int k) {
        return Vector3d(tip + std::min(1.0, k / 60.0) * Vector3d(0, 0, 0.03));
      };
      const ToolMotion motion{at(step), at(step + 1)};
      tissue.step({&motion, 1});
    }
  };
  ShellTissue<double> grid(test::make_shell_sheet(c), f64x1());
  ShellTissue<double> ordered(make_shell_mesh(c, make_irregular_mesh(c, 0)), f64x1());
  lift(grid);
  lift(ordered);
  // Other diagonals and another plate stencil: what is left is that of the 3 mm mesh itself.
  EXPECT_LT(rms_distance(grid, 0, ordered, 0), 3e-4);
  EXPECT_LT((grid.held_force(0) - ordered.held_force(0)).norm(), 0.01 * grid.held_force(0).norm());
}

TEST(SheetMesh, ThePatchIsTheDiscAroundThePinchPointWhateverTheTriangles) {
  ShellCase c;
  const auto model = make_shell_mesh(c, make_irregular_mesh(c, kJitter));
  for (int k = 0; k < 20; ++k) {
    const Vector3d centre = Vector3d(0.01, 0.01, 0) + 2e-4 * k * Vector3d(1, 0.5, 0);
    const SheetPatch patch = model->make_patch(centre, 0.005);
    Eigen::Matrix<double, 3, kPatchRows> rows = Eigen::Matrix<double, 3, kPatchRows>::Zero();
    for (std::size_t i = 0; i < patch.node.size(); ++i) {
      rows += model->body.particles[static_cast<std::size_t>(patch.node[i])] *
              patch.weight.row(static_cast<Eigen::Index>(i));
    }
    EXPECT_LT((rows.col(0) - centre).norm(), 5e-5) << k;  // its middle
    // A slope sees its own axis, not the other one, and no shift.
    EXPECT_LT(std::fabs(rows(1, 1)), 0.02 * rows(0, 1)) << k;
    EXPECT_LT(std::fabs(rows(0, 2)), 0.02 * rows(1, 2)) << k;
    EXPECT_NEAR(patch.weight.col(1).sum(), 0, 1e-12);
  }
}

TEST(SheetMesh, JawsBesideTheSheetOrOnItsClampHoldNothing) {
  ShellCase c;
  c.anchor_max_y = -0.0419;
  ShellTissue<double> tissue(make_shell_mesh(c, make_irregular_mesh(c, kJitter)), f64x1());
  for (const Vector3d& tip :
       {Vector3d(0.06, 0, 0), Vector3d(0, 0, 0.006), Vector3d(0, -0.0449, 0)}) {
    tissue.hold(0, tip, 0.002, false);
    EXPECT_TRUE(tissue.held(0).empty()) << tip.transpose();
  }
  tissue.hold(0, Vector3d(0, 0, 0.001), 0.005, false);
  EXPECT_FALSE(tissue.held(0).empty());
}

// ---------------------------------------------------------------------------------------------------------------------
// Curved at rest.

/// A quarter arch over the x axis: up from z = 0, then over towards +y; below z = 0 one row of
/// straight wall for the clamp. Irregular in the surface.
TriangleMesh make_arch(double radius, int along) {
  const double step = 0.5 * kPi * radius / along;
  ShellCase c;
  c.nx = 9;
  c.ny = static_cast<unsigned>(along + 2);
  c.pitch = step;
  TriangleMesh mesh = make_irregular_mesh(c, kJitter);
  for (Vector3d& p : mesh.vertices) {
    const double s = p.y() + 0.5 * (along + 1) * step - step;  // from the clamp edge
    const double angle = std::max(0.0, s) / radius;
    p = {p.x(), radius * (1 - std::cos(angle)), s < 0 ? s : radius * std::sin(angle)};
  }
  return mesh;
}

std::shared_ptr<const ShellTissueModel> make_arch_model(double young, double gravity, int along) {
  ShellCase c;
  c.young = young;
  c.gravity = gravity;
  c.damping = 20;
  Scene scene = test::make_mesh_scene(c, make_arch(0.06, along));
  for (std::size_t i = 0; i < scene.tissue.particles.size(); ++i) {
    scene.tissue.fixed[i] =
        scene.tissue.particles[i].z() <= 1e-9 && scene.tissue.particles[i].y() < 0.03 ? 1 : 0;
  }
  std::vector<std::string> warnings;
  return make_shell_model(scene, 0.02, warnings);
}

TEST(SheetMesh, ACurvedSheetIsAtRestInItsOwnShapeHoweverTurned) {
  const auto model = make_arch_model(1e6, 0, 31);
  ShellTissue<double> tissue(model, f64x1());
  const Eigen::Matrix3d turn =
      (Eigen::AngleAxisd(0.7, Vector3d::UnitX()) * Eigen::AngleAxisd(-1.2, Vector3d::UnitZ()))
          .toRotationMatrix();
  for (int i = 0; i < tissue.particles(); ++i)
    tissue.set_position(0, i, turn * tissue.position(0, i));
  // Scale: the bending force of the arch laid flat.
  const double scale = 1e6 * std::pow(0.003, 3) / 12 / 0.06;
  for (const Vector3d& force : tissue.elastic_gradient(0)) EXPECT_LT(force.norm(), 1e-6 * scale);
}

TEST(SheetMesh, AQuarterArchSagsByTheClosedForm) {
  // Castigliano: moment w R^2 ((pi/2 - a) cos a - (1 - sin a)) at the angle a from the clamp, so
  // the free end sinks by (pi^2 / 16 - 1/4) w R^4 / (E t^3 / 12), w = rho g t.
  constexpr double kYoung = 500e6;  // sags by 0.1 mm: small against the radius
  ShellTissue<double> tissue(make_arch_model(kYoung, 9.81, 31), f64x1());
  const double before = free_edge(tissue).z();
  run_free(tissue, 6);
  const double expected = (kPi * kPi / 16 - 0.25) * 1000 * 9.81 * 0.003 * std::pow(0.06, 4) /
                          (kYoung * std::pow(0.003, 3) / 12);
  EXPECT_NEAR((before - free_edge(tissue).z()) / expected, 1, 0.02);
}

// ---------------------------------------------------------------------------------------------------------------------
// Thickness.

TEST(ThicknessMap, OfOneSlopeIsTheEffectOfThatSlope) {
  ShellCase c;
  c.poisson = 0.3;
  Scene sloped = test::make_shell_scene(c);
  sloped.config.mutable_tissue()->mutable_effects()->mutable_thickness()->set_x_per_m(4);
  Scene mapped = test::make_shell_scene(c);
  ThicknessMap& map = mapped.tissue.thickness_map;
  map = {2, 2, {-0.045, -0.045}, {0.045, 0.045}, {0.82, 0.82, 1.18, 1.18}};
  std::vector<std::string> warnings;
  ShellTissue<double> a(make_shell_model(sloped, 0.02, warnings), f64x1());
  ShellTissue<double> b(make_shell_model(mapped, 0.02, warnings), f64x1());
  run_free(a, 1);
  run_free(b, 1);
  EXPECT_LT(rms_distance(a, 0, b, 0), 1e-9);
  EXPECT_GT(std::fabs(a.position(0, 30).z() - a.position(0, 960).z()), 1e-4);  // the slope is felt
}

TEST(ThicknessMap, TwiceTheThicknessIsASheetTwiceAsThick) {
  ShellCase c;
  Scene mapped = test::make_shell_scene(c);
  mapped.tissue.thickness_map = {2, 2, {-0.045, -0.045}, {0.045, 0.045}, {2, 2, 2, 2}};
  std::vector<std::string> warnings;
  ShellTissue<double> a(make_shell_model(mapped, 0.02, warnings), f64x1());
  c.thickness *= 2;
  ShellTissue<double> b(test::make_shell_sheet(c), f64x1());
  run_free(a, 2);
  run_free(b, 2);
  EXPECT_LT(rms_distance(a, 0, b, 0), 1e-9);
}

}  // namespace
}  // namespace omentum
