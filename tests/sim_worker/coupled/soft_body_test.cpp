// A sheet and a deformable body that feel each other: laws that hold whatever the solver
// (docs/decisions/0020).
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <memory>
#include <vector>

#include "core/rng.h"
#include "sim_worker/geometry/surface_search.h"
#include "sim_worker/models.h"
#include "support/coupled_scene.h"
#include "support/elastic_energy.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::CoupledCase;
using test::make_coupled;
using test::on_cushion;
using test::over_dome;

constexpr double kGravity = 9.81;

template <typename Real>
void run_for(CoupledTissue<Real>& tissue, double seconds) {
  const ToolMotion away{Vector3d(0, 0, 1), Vector3d(0, 0, 1)};
  const std::vector<ToolMotion> motion(static_cast<std::size_t>(tissue.lanes()), away);
  for (int k = 0; k < std::lround(seconds / 0.02); ++k) tissue.step(motion);
}

struct Sums {
  Vector3d force = Vector3d::Zero();  ///< of the body on the sheet [N]
  Vector3d momentum = Vector3d::Zero(), of_body = Vector3d::Zero();  ///< of both, of the body
  double sheet_weight = 0, body_weight = 0, fastest = 0;
  int contacts = 0;
};

template <typename Real>
Sums sums_of(CoupledTissue<Real>& tissue, int lane = 0) {
  Sums sums;
  const ShellTissue<Real>& sheet = tissue.sheet();
  for (int i = 0; i < sheet.particles(); ++i) {
    const double mass = sheet.model().structure.mass[static_cast<std::size_t>(i)];
    const Vector3d force = tissue.contact().force(lane, i);
    sums.force += force;
    sums.contacts += force.norm() > 0 ? 1 : 0;
    sums.sheet_weight += mass * kGravity;
    sums.momentum += mass * sheet.velocity(lane, i);
    sums.fastest = std::max(sums.fastest, sheet.velocity(lane, i).norm());
  }
  const SolidTissue<Real>& solid = tissue.solid();
  for (int i = 0; i < solid.particles(); ++i) {
    const double mass = solid.model().mass[static_cast<std::size_t>(i)];
    sums.body_weight += mass * kGravity;
    sums.of_body += mass * solid.velocity(lane, i);
    sums.fastest = std::max(sums.fastest, solid.velocity(lane, i).norm());
  }
  sums.momentum += sums.of_body;
  return sums;
}

TEST(SoftBody, AtRestTheWeightOfTheSheetGoesThroughTheBodyIntoItsAnchor) {
  for (const double young : {2e3, 20e3}) {
    CoupledCase c = on_cushion();
    c.young = young;
    c.edge_length = 0.02;
    CoupledTissue<float> tissue(make_coupled(c), f32x1());
    run_for(tissue, 2);
    const Sums sums = sums_of(tissue);
    EXPECT_NEAR(sums.force.z() / sums.sheet_weight, 1, 0.01) << young;
    EXPECT_LT(sums.force.head<2>().norm() / sums.sheet_weight, 0.01) << young;
    EXPECT_LT(sums.fastest, 0.1e-3) << young;
    EXPECT_GT(sums.contacts, 100);
    const Vector3d anchor = tissue.solid().anchor_force(0);
    const double weight = sums.sheet_weight + sums.body_weight;
    EXPECT_NEAR(-anchor.z() / weight, 1, 0.01) << young;
    EXPECT_LT(anchor.head<2>().norm() / weight, 0.01) << young;
  }
}

TEST(SoftBody, ASheetPressesItDownAndItSpringsBack) {
  CoupledCase c = on_cushion();
  c.young = 1e3;
  c.sheet.thickness = 0.01;  // a heavy one
  const auto model = make_coupled(c);
  const auto top = [](CoupledTissue<double>& tissue) {
    double highest = -1;
    for (int i = 0; i < tissue.solid().particles(); ++i) {
      const Vector3d rest = tissue.solid().model().mesh.nodes[static_cast<std::size_t>(i)];
      if (rest.head<2>().norm() < 0.01 && rest.z() > 0.0099)
        highest = std::max(highest, tissue.solid().position(0, i).z());
    }
    return highest;
  };
  CoupledTissue<double> bare(model, f64x1());
  bare.reset(0, Vector3d(0, 0, 5));  // the sheet is far above
  run_for(bare, 0.8);
  CoupledTissue<double> pressed(model, f64x1());
  run_for(pressed, 2);
  const double down = top(bare) - top(pressed);
  // Column of 20 mm under 10 mm of the sheet's density: p L / M with the modulus of confined
  // compression M from above, E from below.
  const double pressure = 1000 * kGravity * 0.01;
  const double lame = 1e3 * 0.45 / (1.45 * 0.1);
  const double confined = lame + 1e3 / 1.45;
  EXPECT_GT(down, 0.5 * pressure * 0.02 / confined);
  EXPECT_LT(down, pressure * 0.02 / 1e3);
  for (int i = 0; i < pressed.sheet().particles(); ++i)
    pressed.sheet().set_position(0, i, pressed.sheet().position(0, i) + Vector3d(0, 0, 5));
  run_for(pressed, 0.8);
  EXPECT_NEAR(top(pressed), top(bare), 0.02 * down);
}

// Two loose bodies, no gravity: the sheet hits, both go on together or apart.
TEST(SoftBody, ACollisionKeepsTheMomentum) {
  for (const double young : {1e3, 100e3}) {
    CoupledCase c = on_cushion();
    c.sheet.gravity = 0;
    c.sheet.damping = c.damping = 0;
    c.anchor_max_z = -1;
    c.young = young;
    CoupledTissue<double> tissue(make_coupled(c), f64x1());
    for (int i = 0; i < tissue.sheet().particles(); ++i)
      tissue.sheet().set_velocity(0, i, Vector3d(0.05, 0, -0.2));
    const Vector3d before = sums_of(tissue).momentum;
    for (int step = 0; step < 15; ++step) {
      run_for(tissue, 0.02);
      EXPECT_LT((sums_of(tissue).momentum - before).norm(), 1e-4 * before.norm())
          << young << " step " << step;
    }
    EXPECT_GT(sums_of(tissue).of_body.norm(), 0.3 * before.norm());
  }
}

// Nodes that are too far off to touch are passed over; one inside of the body never is.
TEST(SoftBody, ASheetThatBeginsInsideIsPushedOut) {
  CoupledCase c = on_cushion();
  c.sheet.gravity = 0;  // nothing but the contact moves it
  c.sheet.X_WB.translation().z() = 0.01 - 0.003;
  CoupledTissue<double> tissue(make_coupled(c), f64x1());
  run_for(tissue, 1);
  for (int i = 0; i < tissue.sheet().particles(); ++i)
    EXPECT_GT(tissue.sheet().position(0, i).z(), 0.01) << i;
}

TEST(SoftBody, TheNearestPointOfATriangleIsNearerThanAnyOther) {
  std::array<int, 3> features{};  // inside, on an edge, a corner
  for (std::uint32_t k = 0; k < 2000; ++k) {
    std::array<Vector3d, 4> p;  // corners and what is asked for
    for (std::uint32_t i = 0; i < 4; ++i) {
      const PhiloxWords words = philox({k, i, 0, 0}, {3, 4});
      for (std::size_t axis = 0; axis < 3; ++axis)
        p[i][static_cast<Eigen::Index>(axis)] = static_cast<double>(words[axis]) * 0x1p-32;
    }
    const TrianglePoint found = nearest_on_triangle(p[3], p[0], p[1], p[2]);
    EXPECT_NEAR(found.share.sum(), 1, 1e-14);
    EXPECT_GT(found.share.minCoeff(), -1e-14);
    const auto squared = [&](const Vector3d& share) {
      return (share[0] * p[0] + share[1] * p[1] + share[2] * p[2] - p[3]).squaredNorm();
    };
    EXPECT_NEAR(found.squared, squared(found.share), 1e-12);
    for (int a = 0; a <= 20; ++a) {
      for (int b = 0; a + b <= 20; ++b)
        EXPECT_LT(found.squared, squared({0.05 * a, 0.05 * b, 1 - 0.05 * (a + b)}) + 1e-12);
    }
    ++features[static_cast<std::size_t>((found.share.array() == 0).count())];
  }
  for (const int n : features) EXPECT_GT(n, 200);
}

// At the tip and at the edges of a spike a point before one triangle is behind the plane of
// another.
TEST(SoftBody, BehindASurfaceIsInsideOfItHoweverSharpItIs) {
  const std::vector<Vector3d> corners = {
      {0.010, 0, 0}, {-0.005, 0.004, 0}, {-0.004, -0.006, 0}, {0.002, 0.001, 0.04}};
  const std::vector<Eigen::Vector3i> faces = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {2, 0, 3}};
  SurfaceSearch search(faces, corners);
  search.fit(corners);
  std::array<int, 2> count{};
  std::array<int, 3> features{};  // nearest to a face, an edge, a corner
  for (std::uint32_t k = 0; k < 4000; ++k) {
    const PhiloxWords words = philox({k, 0, 0, 0}, {1, 2});
    const auto between = [&](std::size_t i, double min, double max) {
      return min + (max - min) * static_cast<double>(words[i]) * 0x1p-32;
    };
    const Vector3d q(between(0, -0.01, 0.014), between(1, -0.01, 0.01), between(2, -0.005, 0.05));
    bool inside = true;
    for (const Eigen::Vector3i& face : faces) {
      const Vector3d& a = corners[static_cast<std::size_t>(face[0])];
      const Vector3d area = (corners[static_cast<std::size_t>(face[1])] - a)
                                .cross(corners[static_cast<std::size_t>(face[2])] - a);
      inside = inside && area.dot(q - a) < 0;
    }
    const TrianglePoint point = search.find(q, corners, 1);
    EXPECT_EQ(search.is_behind(q, corners, point), inside) << q.transpose();
    ++count[inside ? 1 : 0];
    ++features[static_cast<std::size_t>((point.share.array() == 0).count())];
  }
  EXPECT_GT(count[1], 100);
  for (const int n : features) EXPECT_GT(n, 500);
}

// What the contact of the sheet reckons with. Turned, as the mesh is in a frame of its own.
TEST(SoftBody, AnAnchoredBodyAnswersASmallPushAsItThenMoves) {
  CoupledCase c = over_dome();
  c.sheet.gravity = 0;
  c.X_WB.rotate(Eigen::AngleAxisd(0.7, Vector3d(1, 2, 0.5).normalized()));
  const auto model = make_soft_body_model(test::make_coupled_scene(c), 0.02);
  const std::vector<ToolMotion> away{{Vector3d(0, 0, 1), Vector3d(0, 0, 1)}};
  SolidTissue<double> answers(model, f64x1());
  SolidTissue<double> moves(model, f64x1());
  std::vector<double> push(3 * model->mesh.nodes.size());
  for (std::size_t k = 0; k < push.size(); ++k)
    push[k] = model->body.fixed[k / 3] != 0 ? 0 : 1e-6 * std::sin(static_cast<double>(k * k));
  for (auto* tissue : {&answers, &moves}) {
    tissue->begin_step(away);
    tissue->begin_substep(away, 0);
  }
  double work = 0;
  double unused = 0;
  const double none = 0;
  const double whole = 1;
  answers.response(push.data(), &work, &unused);
  answers.take_response(&none, &whole, 1);
  moves.set_load(push.data());
  moves.solve_substep();
  double off = 0;
  double size = 0;
  for (int k = 0; k < answers.substep_displacements().in_lane(); ++k) {
    const double moved = moves.substep_displacements().lane_value(k, 0);
    off += std::pow(answers.substep_displacements().lane_value(k, 0) - moved, 2);
    size += moved * moved;
  }
  EXPECT_LT(std::sqrt(off / size), 1e-3);
}

TEST(SoftBody, AVeryStiffBodyIsTheRigidShapeOfTheSameMesh) {
  CoupledCase c = over_dome();
  c.young = 1e8;
  c.sheet.gravity = kGravity;
  const Scene soft = test::make_coupled_scene(c);
  CoupledTissue<double> tissue(make_coupled(c), f64x1());
  test::ShellCase rigid_case = c.sheet;
  RigidShape rigid;
  rigid.kind = RigidShape::Kind::kMesh;
  rigid.X_WS = c.X_WB;
  rigid.surface = {soft.soft_body->mesh.nodes, soft.soft_body->mesh.surface};
  rigid.sdf = std::make_shared<SdfGrid>(make_sdf_grid(rigid.surface, 160, 0.01));
  rigid_case.bodies = {rigid};
  ShellTissue<double> other(test::make_shell_sheet(rigid_case), f64x1());
  const ToolMotion away{Vector3d(0, 0, 1), Vector3d(0, 0, 1)};
  for (int k = 0; k < 150; ++k) other.step(std::vector<ToolMotion>{away});
  // From the rest on the rigid shape: what differs then is the contact, not the way there.
  for (int i = 0; i < other.particles(); ++i)
    tissue.sheet().set_position(0, i, other.position(0, i));
  run_for(tissue, 1);
  EXPECT_GT(sums_of(tissue).contacts, 50);
  EXPECT_LT(test::rms_distance(tissue.sheet(), 0, other, 0), 0.05e-3);
}

TEST(SoftBody, WhatIsSymmetricStaysSymmetric) {
  // The mesher cuts the box as it likes: symmetric within the asymmetry of that mesh.
  CoupledCase c = on_cushion();
  c.sheet.nx = 17;
  c.sheet.ny = 17;
  c.young = 3e3;
  c.edge_length = 0.01;
  CoupledTissue<double> tissue(make_coupled(c), f64x1());
  run_for(tissue, 1);
  Vector3d middle = Vector3d::Zero();
  for (int i = 0; i < tissue.sheet().particles(); ++i) middle += tissue.sheet().position(0, i);
  middle /= tissue.sheet().particles();
  EXPECT_LT(middle.head<2>().norm(), 0.02e-3);
  for (int ix = 0; ix < 8; ++ix) {
    for (int iy = 0; iy < 17; ++iy) {
      const Vector3d left = tissue.sheet().position(0, 17 * ix + iy);
      const Vector3d right = tissue.sheet().position(0, 17 * (16 - ix) + iy);
      EXPECT_NEAR(left.z(), right.z(), 0.05e-3) << ix << " " << iy;
    }
  }
}

double energy_of(CoupledTissue<double>& tissue) {
  const ShellTissueModel& sheet = tissue.sheet().model();
  const SolidTissueModel& solid = tissue.solid().model();
  double energy = 0;
  const auto add = [&](const auto& part, const std::vector<double>& mass) {
    std::vector<Vector3d> p;
    for (int i = 0; i < part.particles(); ++i) {
      const double m = mass[static_cast<std::size_t>(i)];
      p.push_back(part.position(0, i));
      energy += m * (0.5 * part.velocity(0, i).squaredNorm() + kGravity * p.back().z());
    }
    return p;
  };
  const ShellEnergy of_sheet = shell_energy(sheet, add(tissue.sheet(), sheet.structure.mass));
  energy += of_sheet.membrane + of_sheet.bending;
  return energy + solid_energy(solid, add(tissue.solid(), solid.mass));
}

TEST(SoftBody, WithoutDampingTheEnergyNeverGrows) {
  CoupledCase c = over_dome();
  c.sheet.damping = c.damping = 0;
  CoupledTissue<double> tissue(make_coupled(c), f64x1());
  const double scale = sums_of(tissue).sheet_weight * 0.09 / 2;  // m g L / 2
  double least = energy_of(tissue);
  for (int k = 0; k < 100; ++k) {
    run_for(tissue, 0.02);
    const double energy = energy_of(tissue);
    EXPECT_LT(energy - least, 0.01 * scale) << k;
    least = std::min(least, energy);
  }
}

TEST(SoftBody, ALaneOfABatchEqualsARunAloneBitForBit) {
  const auto model = make_coupled(over_dome());
  const auto start = [](CoupledTissue<float>& tissue, int lane, int k) {
    tissue.set_parameters(lane, {.stiffness_scale = 0.4 + 0.2 * k,
                                 .gravity_scale = 1 - 0.02 * k,
                                 .friction_scale = 0.3 * k});
    tissue.reset(lane, Vector3d(0.002 * k, 0, 0.001 * k));
  };
  const auto play = [](CoupledTissue<float>& tissue, int count) {
    const auto W = static_cast<std::size_t>(tissue.lanes());
    std::vector<ToolMotion> motion(W);
    for (int step = 0; step < 15; ++step) {
      for (std::size_t l = 0; l < W; ++l) {
        const Vector3d tip(-0.03, 0.04, 0.001 * step);
        if (step == 5 && count > 0) tissue.hold(static_cast<int>(l), tip, 0.02, false);
        motion[l] = {tip, tip + Vector3d(0, 0, 0.001)};
      }
      tissue.step(motion);
    }
  };
  std::vector<std::uint64_t> alone;
  for (const int k : {0, 3, 7}) {
    CoupledTissue<float> tissue(model, f32x1());
    start(tissue, 0, k);
    play(tissue, 1);
    ASSERT_TRUE(tissue.healthy(0));
    EXPECT_GT(sums_of(tissue).contacts, 20);
    alone.push_back(tissue.hash(0));
  }
  for (const unsigned width : {8U, 16U}) {
    if (width == 16 && __builtin_cpu_supports("avx512f") == 0) continue;
    CoupledTissue<float> tissue(model, choose_kernel(width));
    for (int lane = 0; lane < tissue.lanes(); ++lane) start(tissue, lane, lane % 8);
    play(tissue, 1);
    EXPECT_EQ(tissue.hash(0), alone[0]) << width;
    EXPECT_EQ(tissue.hash(3), alone[1]) << width;
    EXPECT_EQ(tissue.hash(7), alone[2]) << width;
  }
}

TEST(SoftBody, ASavedStateContinuesBitForBitAndABrokenOneChangesNothing) {
  const auto model = make_coupled(over_dome());
  CoupledTissue<float> a(model, f32x1());
  run_for(a, 0.4);
  ASSERT_GT(sums_of(a).contacts, 20);
  Bytes state;
  a.save(0, state);
  CoupledTissue<float> b(model, f32x1());
  const auto loaded = b.load(0, state);
  ASSERT_TRUE(loaded.has_value());
  EXPECT_EQ(loaded.value(), state.size());
  run_for(a, 0.2);
  run_for(b, 0.2);
  EXPECT_EQ(a.hash(0), b.hash(0));
  const std::uint64_t before = b.hash(0);
  EXPECT_FALSE(b.load(0, std::span(state).first(state.size() - 1)));
  Bytes broken = state;
  const float nan = std::nanf("");
  Bytes sheet;
  a.sheet().save(0, sheet);
  std::memcpy(broken.data() + sheet.size(), &nan, sizeof nan);
  EXPECT_FALSE(b.load(0, broken));
  EXPECT_EQ(b.hash(0), before);
}

}  // namespace
}  // namespace omentum
