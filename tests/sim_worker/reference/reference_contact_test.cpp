// Contact of the converged solid (docs/tissue.md 12, 13).

#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "sim_worker/geometry/mesh.h"
#include "sim_worker/geometry/rigid_gap.h"
#include "support/reference_scene.h"

namespace omentum {
namespace {

using namespace test;  // NOLINT(google-build-using-namespace)

TEST(ReferenceContact, GapOfAnEllipsoidIsADistance) {
  RigidShape body;
  body.kind = RigidShape::Kind::kEllipsoid;
  body.size = Vector3d(0.024, 0.031, 0.054);
  body.X_WS = turned(30, Vector3d(1, 2, 3).normalized());
  body.X_WS.translation() = Vector3d(0.01, 0.02, 0.03);
  Random random;
  for (int sample = 0; sample < 50; ++sample) {
    // A point of the surface moved along its normal by d is d away.
    const Vector3d u = Vector3d(random.next(), random.next(), random.next()).normalized();
    const Vector3d normal = u.cwiseQuotient(body.size).normalized();
    const double d = sample % 2 == 0 ? 0.01 * random.next() + 0.011 : -0.002;
    const Gap gap = rigid_gap(body, body.X_WS * Vector3d(u.cwiseProduct(body.size) + d * normal));
    EXPECT_NEAR(gap.distance, d, 1e-12);
    EXPECT_LT((gap.normal - body.X_WS.linear() * normal).norm(), 1e-9);
  }
}

/// Distance grid of a plane through the origin, whose interpolation is exact.
std::shared_ptr<SdfGrid> make_plane_grid(const Vector3d& normal) {
  auto grid = std::make_shared<SdfGrid>();
  grid->pitch = 0.004;
  grid->count = Eigen::Vector3i(21, 23, 25);
  grid->origin = -0.5 * grid->pitch * (grid->count.cast<double>() - Vector3d::Ones());
  for (int k = 0; k < grid->count.z(); ++k) {
    for (int j = 0; j < grid->count.y(); ++j) {
      for (int i = 0; i < grid->count.x(); ++i) {
        const Vector3d p = grid->origin + grid->pitch * Vector3d(i, j, k);
        grid->value.push_back(static_cast<float>(normal.dot(p)));
      }
    }
  }
  return grid;
}

RigidShape make_grid_body(std::shared_ptr<const SdfGrid> grid) {
  RigidShape body;
  body.kind = RigidShape::Kind::kMesh;
  body.sdf = std::move(grid);
  return body;
}

TEST(ReferenceContact, GapOfADistanceGridIsItsInterpolation) {
  const Vector3d normal = Vector3d(1, -2, 4).normalized();
  RigidShape body = make_grid_body(make_plane_grid(normal));
  body.X_WS = turned(40, Vector3d(3, 1, 2).normalized());
  body.X_WS.translation() = Vector3d(0.01, -0.02, 0.03);
  Random random;
  for (int sample = 0; sample < 50; ++sample) {
    const Vector3d p = 0.039 * Vector3d(random.next(), random.next(), random.next());
    const Gap gap = rigid_gap(body, body.X_WS * p);
    EXPECT_NEAR(gap.distance, normal.dot(p), 1e-8);  // node values are floats
    EXPECT_LT((gap.normal - body.X_WS.linear() * normal).norm(), 1e-5);
  }
  EXPECT_GT(rigid_gap(body, body.X_WS * Vector3d(0.1, 0, 0)).distance, 0.5);  // outside: far away
}

TEST(ReferenceContact, GapOfACapsuleIsTheDistanceToItsAxis) {
  const Vector3d a(0.01, 0.02, 0.03);
  const Vector3d axis = Vector3d(1, 2, -1).normalized();
  const Vector3d across = axis.cross(Vector3d::UnitX()).normalized();
  const Vector3d b = a + 0.05 * axis;
  // Beside the axis, past either end, inside, and with an axis of no length.
  EXPECT_NEAR(capsule_gap(a, b, 0.004, a + 0.02 * axis + 0.01 * across).distance, 0.006, 1e-15);
  EXPECT_NEAR(capsule_gap(a, b, 0.004, b + 0.01 * axis).distance, 0.006, 1e-15);
  EXPECT_NEAR(capsule_gap(a, b, 0.004, a - 0.003 * axis + 0.004 * across).distance, 0.001, 1e-15);
  EXPECT_NEAR(capsule_gap(a, b, 0.004, a + 0.03 * axis + 0.001 * across).distance, -0.003, 1e-15);
  EXPECT_NEAR(capsule_gap(a, a, 0.004, a + 0.01 * axis).distance, 0.006, 1e-15);
  const Gap beside = capsule_gap(a, b, 0.004, a + 0.02 * axis + 0.01 * across);
  EXPECT_LT((beside.normal - across).norm(), 1e-12);
}

ReferenceCase on_board(double degrees, double friction) {
  ReferenceCase c;
  c.nx = c.ny = 9;
  c.anchor = -1;
  c.ex = c.ey = 4;
  c.young = 2e4;
  c.poisson = 0.45;
  c.static_friction = c.dynamic_friction = friction;
  c.bodies = {make_slope(degrees)};
  c.X_WB = turned(degrees, Vector3d::UnitX());
  c.X_WB.translation() = c.X_WB.linear() * Vector3d(0, 0, 0.0015);
  return c;
}

TEST(ReferenceContact, SheetOnABoardPressesWithItsWeight) {
  ReferenceCase c = on_board(0, 0.3);
  c.damping = 5;
  ReferenceTissue tissue(make_model(c));
  run(tissue, 50);
  const Vector3d weight(0, 0, tissue.model().total_mass * kGravity);
  EXPECT_LT((tissue.contact_forces()[0] - weight).norm(), 1e-4 * weight.z());
  EXPECT_LT(tissue.penetration(), 1e-5);
}

TEST(ReferenceContact, AMeshOfThePlaneCarriesLikeThePlane) {
  // Half-space and distance grid of the same plane: the same motion up to the floats of the grid.
  std::array<Vector3d, 2> end;
  for (const bool mesh : {false, true}) {
    ReferenceCase c = on_board(20, 0.5);
    c.substeps = 4;
    if (mesh) {
      c.bodies[0].kind = RigidShape::Kind::kMesh;
      c.bodies[0].sdf = make_plane_grid(Vector3d::UnitZ());
    }
    ReferenceTissue tissue(make_model(c));
    run(tissue, 5);
    EXPECT_GT(tissue.contact_forces()[0].z(), 0);
    end[mesh ? 1 : 0] = tissue.position(0, 40);
  }
  EXPECT_LT((end[0] - end[1]).norm(), 1e-7);
}

TEST(ReferenceContact, ShaftPushesTheSheetAside) {
  // The shaft sweeps into the side of a free sheet without gravity: the sheet ends clear of the
  // capsule and moves at least as fast as the shaft (nearly: waves go on inside).
  ReferenceCase c = on_board(0, 0);
  c.bodies.clear();
  c.gravity = 0;
  c.tool_contact = true;
  c.substeps = 4;
  const auto model = make_model(c);
  ReferenceTissue tissue(model);
  const double half = 0.012;  // of the sheet [m]
  // The tip below the sheet, so that the shaft, straight up, passes the sheet's height.
  const Vector3d depth(
      0, 0, 0.0015 - model->surroundings.tool_start - 0.5 * model->surroundings.tool_length);
  const auto at = [&](int step) {
    return Vector3d(depth -
                    Vector3d(half + model->surroundings.tool_radius + 0.001 - 0.0005 * step, 0, 0));
  };
  for (int step = 0; step < 20; ++step) {
    const ToolMotion motion{at(step), at(step + 1)};
    tissue.step({&motion, 1});
    ASSERT_TRUE(tissue.healthy(0)) << tissue.failure(0);
  }
  double gap = 1;
  Vector3d momentum = Vector3d::Zero();
  for (std::size_t i = 0; i < model->nodes.size(); ++i) {
    const Vector3d tip = at(20) + model->surroundings.tool_start * Vector3d::UnitZ();
    gap = std::min(gap, capsule_gap(tip, tip + model->surroundings.tool_length * Vector3d::UnitZ(),
                                    model->surroundings.tool_radius, tissue.node_positions()[i])
                            .distance);
    momentum += model->mass[i] * tissue.node_velocities()[i];
  }
  EXPECT_GT(gap, -1e-5);
  EXPECT_GE(momentum.x() / model->total_mass, 0.02);  // the shaft moves at 25 mm/s
  EXPECT_LT(std::fabs(momentum.y()), 0.05 * momentum.x());
}

TEST(ReferenceContact, FrictionHoldsBelowMuAndSlidesAbove) {
  constexpr double kDegrees = 20;  // tan 20 deg = 0.364
  const Vector3d downhill = turned(kDegrees, Vector3d::UnitX()).linear() * -Vector3d::UnitY();
  const auto travel = [&](double mu) {
    ReferenceCase c = on_board(kDegrees, mu);
    c.substeps = 4;
    ReferenceTissue tissue(make_model(c));
    const Vector3d before = tissue.position(0, 40);
    run(tissue, 50);
    return (tissue.position(0, 40) - before).dot(downhill);
  };
  EXPECT_LT(std::fabs(travel(0.5)), 3e-5);  // 1 s: elastic shear and a creep of 5 um at most
  const double expected =
      0.5 * kGravity * (std::sin(kDegrees * kPi / 180) - 0.2 * std::cos(kDegrees * kPi / 180));
  EXPECT_NEAR(travel(0.2) / expected, 1, 0.03);
}

TEST(ReferenceContact, SlidingSheetKeepsCoulombsLawFromTheFirstStepOn) {
  // Whatever the board does to stop the fall, friction takes mu times its impulse while the sheet
  // slides: the speed downhill is g (sin a - mu cos a) t, on the board from the start or dropped.
  constexpr double kDegrees = 20;
  constexpr double kMu = 0.2;
  const Eigen::Isometry3d X_WS = turned(kDegrees, Vector3d::UnitX());
  const double expected =
      kGravity * (std::sin(kDegrees * kPi / 180) - kMu * std::cos(kDegrees * kPi / 180));
  for (const double height : {0.0, 1e-4, 2e-3}) {
    for (const unsigned substeps : {1U, 4U}) {
      ReferenceCase c = on_board(kDegrees, kMu);
      c.X_WB.translation() += X_WS.linear() * Vector3d(0, 0, height);
      c.substeps = substeps;
      const auto model = make_model(c);
      ReferenceTissue tissue(model);
      for (int step = 1; step <= 10; ++step) {
        run(tissue, 1);
        if (height > 0 && step < 9) continue;  // it may still fall or bounce
        Vector3d momentum = Vector3d::Zero();
        for (std::size_t i = 0; i < model->nodes.size(); ++i)
          momentum += model->mass[i] * tissue.node_velocities()[i];
        const double speed = (X_WS.linear().transpose() * momentum).y() / -model->total_mass;
        EXPECT_NEAR(speed / (expected * 0.02 * step), 1, 0.01)
            << height << " m, " << substeps << " steps, after " << step;
      }
    }
  }
}

TEST(ReferenceContact, DrapeOverSphereLeavesNoOverlapAndCarriesTheWeight) {
  ReferenceCase c;
  c.nx = c.ny = 21;
  c.anchor = -1;
  c.ex = c.ey = 10;
  c.young = 3e4;
  c.poisson = 0.45;
  c.damping = 10;
  c.static_friction = c.dynamic_friction = 0.5;
  RigidShape sphere;
  sphere.kind = RigidShape::Kind::kSphere;
  sphere.size = Vector3d::Constant(0.03);
  sphere.X_WS.translation() = Vector3d(0, 0, -0.0315);
  c.bodies = {sphere};
  ReferenceTissue tissue(make_model(c));
  run(tissue, 100);
  const double weight = tissue.model().total_mass * kGravity;
  EXPECT_NEAR(tissue.contact_forces()[0].z() / weight, 1, 0.01);
  EXPECT_LT(tissue.penetration(), 1e-5);
  EXPECT_LT(tissue.position(0, 0).z(), -0.005);  // the corners hang down
}

TEST(ReferenceContact, ACoarseSheetComesToRestOnABoardUnderSharpFriction) {
  // Large cells chatter between sticking and slipping: with sharp friction alone some of these
  // fail before the first command.
  for (const double young : {20e3, 60e3}) {
    for (const unsigned cells : {3U, 4U, 5U, 6U}) {
      for (const double friction : {0.1, 0.3, 0.6}) {
        ReferenceCase c;
        c.nx = c.ny = 16;
        c.anchor = -0.0195;
        c.ex = c.ey = cells;
        c.young = young;
        c.poisson = 0.45;
        c.damping = 5;
        c.law = pb::LAW_NEO_HOOKE;
        c.static_friction = c.dynamic_friction = friction;
        c.bodies = {make_slope(0, Vector3d(0, 0, -c.thickness / 2))};
        ReferenceTissue tissue(make_model(c));
        EXPECT_LT(tissue.settle(Vector3d(0, 0, 1)), 1e-4);
        EXPECT_TRUE(tissue.healthy(0))
            << young << " " << cells << " " << friction << ": " << tissue.failure(0);
      }
    }
  }
}

}  // namespace
}  // namespace omentum
