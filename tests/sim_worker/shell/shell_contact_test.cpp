// Contact of the elastic shell with many nodes at once: laws that hold whatever the solver
// (docs/decisions/0012).
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "sim_worker/shell/shell_tissue.h"
#include "support/shell_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::make_shell_sheet;
using test::over_sphere;
using test::rms_distance;
using test::run_free;
using test::ShellCase;

constexpr double kGravity = 9.81;
constexpr double kNodeRadius = 0.0015;  // contact distance of a node

RigidShape sloped_board(double slope = 0) {
  RigidShape board;
  board.kind = RigidShape::Kind::kHalfSpace;
  board.X_WS.linear() = Eigen::AngleAxisd(slope, Vector3d::UnitX()).toRotationMatrix();
  return board;
}

/// A loose sheet, flat, `height` above contact with a board of this slope.
ShellCase on_board(double height, double friction, double slope = 0) {
  ShellCase c;
  c.young = 5e3;
  c.poisson = 0.45;
  c.anchor_max_y = -1;
  c.static_friction = c.dynamic_friction = friction;
  c.bodies = {sloped_board(slope)};
  c.X_WB.linear() = c.bodies[0].X_WS.linear();
  c.X_WB.translation() = c.X_WB.linear() * Vector3d(0, 0, kNodeRadius + height);
  return c;
}

/// A sheet with one anchored edge over a mound on a board: more than 200 contacts with two bodies.
ShellCase over_mound(double friction) {
  ShellCase c = on_board(0.0205, friction);
  c.anchor_max_y = -0.0449;
  c.bodies.push_back(test::make_sphere(Vector3d::Zero(), 0.02));
  return c;
}

struct Sums {
  Vector3d force = Vector3d::Zero();     ///< of the surroundings on the sheet [N]
  Vector3d momentum = Vector3d::Zero();  ///< [kg m/s]
  double weight = 0, fastest = 0;        ///< [N], [m/s]
  int contacts = 0;
};

template <typename Real>
Sums sums_of(const ShellTissue<Real>& tissue, int lane = 0) {
  Sums sums;
  for (int i = 0; i < tissue.particles(); ++i) {
    const double mass = tissue.model().structure.mass[static_cast<std::size_t>(i)];
    const Vector3d force = tissue.contact_force(lane, i);
    sums.force += force;
    sums.momentum += mass * tissue.velocity(lane, i);
    sums.weight += mass * kGravity;
    sums.fastest = std::max(sums.fastest, tissue.velocity(lane, i).norm());
    sums.contacts += force.norm() > 0 ? 1 : 0;
  }
  return sums;
}

TEST(ShellContact, BoardCarriesTheWeightOfASheetAtRest) {
  for (const double young : {5e3, 30e3, 300e3}) {
    for (const double friction : {0.0, 0.3}) {
      ShellCase c = on_board(0.001, friction);
      c.young = young;
      ShellTissue<float> tissue(make_shell_sheet(c), f32x1());
      run_free(tissue, 3);
      const Sums sums = sums_of(tissue);
      EXPECT_NEAR(sums.force.z() / sums.weight, 1, 0.01) << young << " " << friction;
      EXPECT_LT(sums.force.head<2>().norm() / sums.weight, 0.01) << young << " " << friction;
      EXPECT_LT(sums.fastest, 0.1e-3) << young << " " << friction;
      EXPECT_GT(sums.contacts, 500);
      for (int i = 0; i < tissue.particles(); ++i) {
        ASSERT_NEAR(tissue.position(0, i).z(), kNodeRadius, 0.02e-3) << i;
      }
    }
  }
}

// Internal forces sum to zero, so the contact forces alone and the weight change the momentum, also
// in a landing, where they change most.
TEST(ShellContact, OverASphereRestIsExactAtTheShippedStep) {
  ShellCase c = over_sphere();
  ShellTissue<float> tissue(make_shell_sheet(c), f32x1());
  run_free(tissue, 6);
  c.substeps = 20;
  ShellTissue<double> fine(make_shell_sheet(c), f64x1());
  run_free(fine, 6);
  EXPECT_LT(rms_distance(tissue, 0, fine, 0), 0.1e-3);
  EXPECT_LT(sums_of(tissue).fastest, 0.1e-3);  // at rest, docs/tissue.md 12
  double force = 0;
  double penetration = 0;
  for (int i = 0; i < tissue.particles(); ++i) {
    force += tissue.contact_force(0, i).z();
    const double distance = (tissue.position(0, i) - Vector3d(0, -0.010, -0.043)).norm();
    penetration = std::max(penetration, 0.040 - distance);
  }
  EXPECT_NEAR(force, 0.189, 0.004);
  EXPECT_LT(penetration, 0.05e-3);
}

TEST(ShellContact, FrictionHoldsASheetOnASlopeBelowItsAngleOnly) {
  // A free sheet on a half-space of slope 0.2.
  const auto slide = [](double friction) {
    ShellCase c;
    c.nx = c.ny = 9;
    c.young = 30e3;
    c.anchor_max_y = -1;
    c.static_friction = c.dynamic_friction = friction;
    RigidShape slope;
    slope.kind = RigidShape::Kind::kHalfSpace;
    slope.X_WS.linear() = Eigen::AngleAxisd(std::atan(0.2), Vector3d::UnitX()).toRotationMatrix();
    c.bodies = {slope};
    c.X_WB.linear() = slope.X_WS.linear();
    c.X_WB.translation() = slope.X_WS.linear() * Vector3d(0, 0, 0.0015);
    ShellTissue<float> tissue(make_shell_sheet(c), f32x1());
    const Vector3d start = tissue.position(0, 40);
    run_free(tissue, 0.5);
    return (tissue.position(0, 40) - start).norm();
  };
  EXPECT_LT(slide(0.3), 0.1e-3);
  // g (sin - mu cos) over 0.5 s with damping 5/s.
  const double angle = std::atan(0.2);
  const double pull = 9.81 * (std::sin(angle) - 0.1 * std::cos(angle));
  const double expected = pull / 5 * (0.5 - (1 - std::exp(-2.5)) / 5);
  EXPECT_NEAR(slide(0.1) / expected, 1.0, 0.05);
}

TEST(ShellContact, ForcesAreWhatChangesTheMomentum) {
  ShellCase c = over_mound(0.3);
  c.anchor_max_y = -1;
  c.damping = 0;
  c.substeps = 1;
  ShellTissue<double> tissue(make_shell_sheet(c), f64x1());
  double largest = 0;
  for (int step = 0; step < 50; ++step) {
    const Vector3d before = sums_of(tissue).momentum;
    run_free(tissue, 0.02);
    const Sums now = sums_of(tissue);
    const Vector3d impulse = 0.02 * (now.force - Vector3d(0, 0, now.weight));
    EXPECT_LT((now.momentum - before - impulse).norm(), 1e-9 * now.weight) << step;
    largest = std::max(largest, now.force.norm() / now.weight);
  }
  EXPECT_GT(largest, 1.2);  // it landed
}

// A soft sheet has many states of rest on a mound, with its folds here or there; but a rest of the
// shipped step must be one of every step.
TEST(ShellContact, RestIsOneOfFineSteps) {
  for (const double friction : {0.0, 0.3}) {
    ShellTissue<float> tissue(make_shell_sheet(over_mound(friction)), f32x1());
    ShellCase c = over_mound(friction);
    c.substeps = 20;
    c.iterations = 2;
    ShellTissue<double> fine(make_shell_sheet(c), f64x1());
    run_free(tissue, 5);
    EXPECT_GT(sums_of(tissue).contacts, 100) << friction;
    EXPECT_LT(sums_of(tissue).fastest, 0.1e-3) << friction;
    for (int i = 0; i < fine.particles(); ++i) fine.set_position(0, i, tissue.position(0, i));
    run_free(fine, 1);
    EXPECT_LT(test::rms_distance(tissue, 0, fine, 0), 0.1e-3) << friction;
    EXPECT_NEAR(sums_of(fine).force.z(), sums_of(tissue).force.z(), 0.01 * sums_of(fine).weight);
  }
}

TEST(ShellContact, FrictionHoldsBelowItsAngleAndIsMuTimesTheNormalForceAbove) {
  const double slope = std::atan(0.2);
  const Vector3d down(0, -std::cos(slope), -std::sin(slope));
  const Vector3d normal(0, -std::sin(slope), std::cos(slope));
  const auto slide = [&](double friction) {
    auto tissue = std::make_unique<ShellTissue<float>>(
        make_shell_sheet(on_board(0, friction, slope)), f32x1());
    run_free(*tissue, 0.5);
    return tissue;
  };
  const auto held = slide(0.3);
  EXPECT_LT(sums_of(*held).fastest, 0.1e-3);
  EXPECT_NEAR(-sums_of(*held).force.dot(down) / sums_of(*held).weight, std::sin(slope), 0.002);
  const auto sliding = slide(0.1);
  const Sums sums = sums_of(*sliding);
  EXPECT_GT(sums.momentum.dot(down), 0.1 * sums.weight / kGravity);  // faster than 0.1 m/s
  EXPECT_NEAR(sums.force.dot(normal) / sums.weight, std::cos(slope), 0.01);
  EXPECT_NEAR(-sums.force.dot(down) / sums.force.dot(normal), 0.1, 0.002);
}

// The sheet rubs with its lower face: friction turns it about its nodes by half its thickness, and
// the forces that do so are no force on the sheet as a whole.
TEST(ShellContact, FrictionHasTheLeverOfHalfTheThickness) {
  for (const bool turned : {false, true}) {  // the same with its normal towards the board
    ShellCase c = on_board(0, 0.3);
    if (turned) c.X_WB.linear() = Eigen::AngleAxisd(M_PI, Vector3d::UnitX()).toRotationMatrix();
    ShellTissue<double> tissue(make_shell_sheet(c), f64x1());
    for (int i = 0; i < tissue.particles(); ++i) tissue.set_velocity(0, i, Vector3d(0.5, 0, 0));
    run_free(tissue, 0.02);
    const std::vector<Vector3d> gradient = tissue.elastic_gradient(0);
    Vector3d force = Vector3d::Zero();
    Vector3d couple = Vector3d::Zero();
    for (int i = 0; i < tissue.particles(); ++i) {
      force -= gradient[static_cast<std::size_t>(i)];
      couple -= tissue.position(0, i).cross(gradient[static_cast<std::size_t>(i)]);
    }
    const Sums sums = sums_of(tissue);
    EXPECT_NEAR(sums.force.x() / sums.force.z(), -0.3, 1e-3);
    const Vector3d expected = Vector3d(0, 0, -kNodeRadius).cross(sums.force);
    EXPECT_LT((couple - expected).norm(), 1e-2 * expected.norm()) << turned;
    EXPECT_LT(force.norm(), 1e-9 * sums.weight) << turned;
  }
}

TEST(ShellContact, LanesThatLandAtDifferentTimesAreThoseAlone) {
  const auto model = make_shell_sheet(over_mound(0.3));
  const auto start = [](ShellTissue<float>& tissue, int lane, int k) {
    tissue.set_parameters(lane, {.stiffness_scale = 0.3 * std::pow(10.0, k / 7.0),
                                 .gravity_scale = 1 - 0.02 * k,
                                 .friction_scale = 0.2 * k});
    tissue.reset(lane, Vector3d(0, 0, 0.002 * k));
  };
  ShellTissue<float> batch(model, f32x8());
  for (int lane = 0; lane < 8; ++lane) start(batch, lane, lane);
  run_free(batch, 1.5);
  for (const int k : {0, 3, 7}) {
    ShellTissue<float> alone(model, f32x1());
    start(alone, 0, k);
    run_free(alone, 1.5);
    EXPECT_GT(sums_of(alone).contacts, 100);
    EXPECT_EQ(alone.hash(0), batch.hash(k)) << k;
  }
}

}  // namespace
}  // namespace omentum
