// Contact, grasp, state and mesh of the converged solid (docs/tissue.md 12, 13).

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>

#include "sim_worker/geometry/mesh.h"
#include "sim_worker/geometry/rigid_gap.h"
#include "sim_worker/models.h"
#include "support/reference_scene.h"

namespace omentum {
namespace {

using namespace test;  // NOLINT(google-build-using-namespace)

// ---- contact ------------------------------------------------------------------------------------

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
  c.bodies = {make_board(degrees)};
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

// ---- grasp --------------------------------------------------------------------------------------

ReferenceCase free_sheet() {
  ReferenceCase c;
  c.nx = c.ny = 11;
  c.anchor = -1;
  c.ex = c.ey = 5;
  c.young = 3e4;
  c.poisson = 0.4;
  c.damping = 20;
  return c;
}

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

// ---- state
// ------------------------------------------------------------------------------------------

TEST(ReferenceState, RoundTripContinuesBitForBit) {
  ReferenceCase c = free_sheet();
  c.bodies = {make_board(0)};
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

TEST(ReferenceMesh, SceneChoosesTheModelAndVolumesAreRefused) {
  std::vector<std::string> warnings;
  Scene scene = make_reference_scene(free_sheet());
  const auto model = make_tissue_model(scene, 0.02, warnings);
  EXPECT_NE(dynamic_cast<const ReferenceTissueModel*>(model.get()), nullptr);
  EXPECT_EQ(model->substeps(), 1U);
  scene.tissue.surface_is_particles = false;
  EXPECT_THROW(static_cast<void>(make_tissue_model(scene, 0.02, warnings)), Error);
}

TEST(ReferenceState, LanesOfSinglePrecisionAreRefused) {
  const auto model = make_model(free_sheet());
  EXPECT_THROW(static_cast<void>(model->make_tissue(f32x1())), Error);
  EXPECT_EQ(model->make_tissue(f64x1())->lanes(), 1);
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
        c.bodies = {make_board(0, Vector3d(0, 0, -c.thickness / 2))};
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
