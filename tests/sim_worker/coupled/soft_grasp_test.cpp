// Jaws that hold a sheet, the deformable body under it, or both: laws that hold whatever the solver
// (docs/decisions/0020).
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "sim_worker/models.h"
#include "support/coupled_scene.h"
#include "support/elastic_energy.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::CoupledCase;
using test::make_coupled;
using test::move_tool;

constexpr double kPatch = 0.005;             // radius of the grasp
const Vector3d kTop(0.004, 0.006, -0.0055);  // in the lying sheet, 1.5 mm above the dome

/// A sheet with one anchored edge over a dome.
CoupledCase held_over_dome() {
  CoupledCase c = test::over_dome();
  c.edge_length = 0.014;
  return c;
}

/// Sum of masses times gravity, of the fixed nodes too [N].
Vector3d weight_of(CoupledTissue<double>& tissue) {
  double mass = 0;
  for (const double m : tissue.sheet().model().structure.mass) mass += m;
  for (const double m : tissue.solid().model().mass) mass += m;
  return mass * tissue.solid().model().surroundings.gravity;
}

/// Force of the sheet on its clamp [N]: how its energy falls when the clamp moves, and the weight
/// of what the clamp holds.
Vector3d clamp_force(CoupledTissue<double>& tissue) {
  const ShellTissueModel& model = tissue.sheet().model();
  const auto energy_at = [&](const Vector3d& shift) {
    std::vector<Vector3d> p;
    for (int i = 0; i < tissue.sheet().particles(); ++i) {
      p.push_back(tissue.sheet().position(0, i));
      if (model.body.fixed[static_cast<std::size_t>(i)] != 0) p.back() += shift;
    }
    const ShellEnergy energy = shell_energy(model, p);
    return energy.membrane + energy.bending;
  };
  Vector3d force = Vector3d::Zero();
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3d step = 1e-7 * Vector3d::Unit(axis);
    force[axis] = (energy_at(-step) - energy_at(step)) / 2e-7;
  }
  for (std::size_t i = 0; i < model.structure.mass.size(); ++i) {
    if (model.body.fixed[i] != 0) force += model.structure.mass[i] * model.surroundings.gravity;
  }
  return force;
}

/// Takes hold of sheet and body at the tip.
template <typename Real>
void hold_both(CoupledTissue<Real>& tissue, int lane, const Vector3d& tip) {
  tissue.hold(lane, tip, kPatch, false);
  tissue.hold_body(lane, tip, kPatch, false);
}

template <typename Real>
double fastest(const CoupledTissue<Real>& tissue, int lane = 0) {
  double speed = 0;
  for (int i = 0; i < tissue.particles(); ++i)
    speed = std::max(speed, tissue.velocity(lane, i).norm());
  return speed;
}

TEST(SoftGrasp, TheDistanceToABodyIsThatToItsSurfaceAsItIs) {
  CoupledCase c;
  c.sheet.gravity = 0;
  CoupledTissue<double> tissue(make_coupled(c), f64x1());
  EXPECT_NEAR(tissue.distance_to_body(0, {0.003, 0.004, 0.012}), 0.002, 1e-9);
  EXPECT_NEAR(tissue.distance_to_body(0, {0.033, 0.034, 0.002}), 0.005, 1e-9);  // from an edge
  EXPECT_EQ(tissue.distance_to_body(0, {0.003, 0.004, 0.008}), 0);
  EXPECT_EQ(tissue.distance_to_body(0, {0, 0, 0}), 0);
  for (int i = 0; i < tissue.solid().particles(); ++i)
    tissue.solid().set_position(0, i, tissue.solid().position(0, i) + Vector3d(0, 0, 0.001));
  EXPECT_NEAR(tissue.distance_to_body(0, {0.003, 0.004, 0.012}), 0.001, 1e-9);
  ShellTissue<double> sheet(test::make_shell_sheet({}), f64x1());
  EXPECT_EQ(sheet.distance_to_body(0, Vector3d::Zero()), std::numeric_limits<double>::infinity());
}

// The sheet is far away: no rounding between the two.
TEST(SoftGrasp, PullingABodyBesideASheetIsPullingItAlone) {
  const CoupledCase c = held_over_dome();
  CoupledTissue<float> both(make_coupled(c), f32x1());
  SolidTissue<float> alone(make_soft_body_model(test::make_coupled_scene(c), 0.02), f32x1());
  both.reset(0, Vector3d(0, 0, 5));
  both.hold_body(0, kTop, kPatch, false);
  alone.hold(0, kTop, kPatch, false);
  ASSERT_FALSE(alone.held(0).empty());
  for (Tissue<float>* tissue :
       {static_cast<Tissue<float>*>(&both), static_cast<Tissue<float>*>(&alone)})
    move_tool(*tissue, kTop, kTop + Vector3d(0.004, 0, 0.012), 30);
  EXPECT_GT(alone.held_force(0).norm(), 0.05);
  EXPECT_EQ(both.held_force(0), alone.held_force(0));
  for (int i = 0; i < alone.particles(); ++i)
    EXPECT_EQ(both.solid().position(0, i), alone.position(0, i)) << i;
}

// What the tool bears is what is missing from clamp and anchor.
TEST(SoftGrasp, TheForceOnTheToolIsTheChangeOfTheLoadsOfClampAndAnchor) {
  CoupledTissue<double> tissue(make_coupled(held_over_dome()), f64x1());
  const Vector3d away(0, 0, 1);
  move_tool(tissue, away, away, 100);
  const Vector3d before = clamp_force(tissue) + tissue.solid().anchor_force(0);
  const Vector3d weight = weight_of(tissue);
  EXPECT_LT((before - weight).norm(), 0.01 * weight.norm());
  hold_both(tissue, 0, kTop);
  ASSERT_FALSE(tissue.sheet().held(0).empty());
  ASSERT_FALSE(tissue.solid().held(0).empty());
  const Vector3d to = kTop + Vector3d(0.004, -0.003, 0.012);
  move_tool(tissue, kTop, to, 30);
  move_tool(tissue, to, to, 150);
  EXPECT_LT(fastest(tissue), 1e-4);
  const Vector3d after = clamp_force(tissue) + tissue.solid().anchor_force(0);
  const Vector3d tool = tissue.held_force(0);
  EXPECT_GT(tool.norm(), 0.3 * weight.norm());
  EXPECT_LT((tool + after - before).norm(), 0.01 * tool.norm());
  EXPECT_EQ(tool, tissue.sheet().held_force(0) + tissue.solid().held_force(0));
  EXPECT_GT(tissue.sheet().held_force(0).norm(), 0.05 * tool.norm());
}

TEST(SoftGrasp, WhatIsHeldGoesWithTheJawsAndTheRestFollows) {
  CoupledTissue<double> tissue(make_coupled(held_over_dome()), f64x1());
  const Vector3d away(0, 0, 1);
  move_tool(tissue, away, away, 50);
  EXPECT_LT(tissue.distance_to_body(0, kTop), 0.002);
  tissue.hold(0, kTop, kPatch, false);
  tissue.hold_body(0, kTop, 0.008, false);
  const auto held = tissue.held(0);
  const std::vector<std::int32_t> nodes(held.begin(), held.end());
  EXPECT_TRUE(std::is_sorted(nodes.begin(), nodes.end()));
  EXPECT_LT(nodes.front(), tissue.sheet().particles());
  EXPECT_GE(nodes.back(), tissue.sheet().particles());
  // A node that the jaws cover wholly goes with them; others hang on springs.
  const auto top = *std::min_element(nodes.begin(), nodes.end(), [&](int a, int b) {
    return a >= tissue.sheet().particles() &&
           (b < tissue.sheet().particles() || (tissue.position(0, a) - kTop).squaredNorm() <
                                                  (tissue.position(0, b) - kTop).squaredNorm());
  });
  const Vector3d from = tissue.position(0, top);
  const Vector3d way(0.002, 0, 0.01);
  move_tool(tissue, kTop, kTop + way, 25);
  EXPECT_LT((tissue.position(0, top) - from - way).norm(), 1e-9);
  const Vector3d slip(0, 0, -0.002);
  tissue.shift_held(0, slip);
  move_tool(tissue, kTop + way, kTop + way, 100);
  EXPECT_LT((tissue.position(0, top) - from - way - slip).norm(), 1e-9);
  std::vector<Nearest> nearest(1);
  tissue.find_nearest(std::vector<Vector3d>{kTop + way + slip}, nearest);
  EXPECT_LT(nearest[0].distance, 0.002);  // the sheet is still over it
  tissue.release(0);
  EXPECT_TRUE(tissue.held(0).empty());
  EXPECT_EQ(tissue.held_force(0), Vector3d::Zero());
  // hold() begins anew.
  hold_both(tissue, 0, kTop);
  tissue.hold(0, away, kPatch, false);
  EXPECT_TRUE(tissue.held(0).empty());
}

TEST(SoftGrasp, ReleaseGivesBackTheFreeMotion) {
  const auto model = make_coupled(held_over_dome());
  const Vector3d away(0, 0, 1);
  // Without a step in between nothing has happened.
  CoupledTissue<float> held(model, f32x1());
  CoupledTissue<float> never(model, f32x1());
  move_tool(held, away, away, 20);
  move_tool(never, away, away, 20);
  hold_both(held, 0, kTop);
  held.release(0);
  EXPECT_EQ(held.hash(0), never.hash(0));
  move_tool(held, away, away, 5);
  move_tool(never, away, away, 5);
  EXPECT_EQ(held.hash(0), never.hash(0));
  // Pulled and let go, both come back to rest, the body where it was.
  hold_both(held, 0, kTop);
  move_tool(held, kTop, kTop + Vector3d(0, 0, 0.012), 30);
  const double pulled = test::rms_distance(held.solid(), 0, never.solid(), 0);
  EXPECT_GT(pulled, 1e-3);
  held.release(0);
  move_tool(held, away, away, 150);
  move_tool(never, away, away, 180);
  EXPECT_LT(fastest(held), 1e-4);
  // Friction lets the sheet lie otherwise than before.
  EXPECT_LT(test::rms_distance(held.solid(), 0, never.solid(), 0), 0.1 * pulled);
}

// The jaws slip on the load of both, whichever they hold, and lose both at once.
TEST(SoftGrasp, SheetAndBodySlipAsOne) {
  constexpr double kLimit = 0.05;
  CoupledTissue<float> tissue(make_coupled(held_over_dome()), f32x8());
  // Lanes: both, the body alone; then the same where tissue is lost after 1 mm.
  for (int lane = 0; lane < 4; ++lane) {
    LaneParameters parameters;
    EffectValues& effects = parameters.effects.emplace();
    effects.slip_speed = 0.01;
    effects.slip_force = kLimit;
    effects.slip_loss = lane < 2 ? 0 : 1e-3;
    tissue.set_parameters(lane, parameters);
  }
  move_tool(tissue, kTop, kTop, 25);
  for (int lane = 0; lane < 4; ++lane) {
    if (lane % 2 == 0) tissue.hold(lane, kTop, kPatch, false);
    tissue.hold_body(lane, kTop, kPatch, false);
  }
  const auto apart = [&] {  // mean of the held nodes of the sheet from that of the body's
    Vector3d sheet = Vector3d::Zero();
    Vector3d body = Vector3d::Zero();
    for (const std::int32_t i : tissue.sheet().held(0)) sheet += tissue.sheet().position(0, i);
    for (const std::int32_t i : tissue.solid().held(0)) body += tissue.solid().position(0, i);
    return Vector3d(sheet / static_cast<double>(tissue.sheet().held(0).size()) -
                    body / static_cast<double>(tissue.solid().held(0).size()));
  };
  const Vector3d at_first = apart();
  const Vector3d to = kTop + Vector3d(0, 0, 0.012);
  move_tool(tissue, kTop, to, 30);
  move_tool(tissue, to, to, 200);
  EXPECT_LT((apart() - at_first).norm(), 0.2e-3);
  for (int lane = 0; lane < 2; ++lane) {
    EXPECT_EQ(tissue.sheet().held(lane).empty(), lane == 1);
    EXPECT_FALSE(tissue.solid().held(lane).empty());
    EXPECT_NEAR(tissue.held_force(lane).norm(), kLimit, 0.05 * kLimit) << lane;
    EXPECT_TRUE(tissue.held(lane + 2).empty()) << lane;
  }
}

/// Every lane takes something else at another time, and lets go of it.
void play_role(CoupledTissue<float>& tissue, int lane, int role, int step,
               std::vector<ToolMotion>& motion) {
  const Vector3d tip = kTop + Vector3d(0.001 * role, 0, 0.0005 * step);
  if (step == 4 + role % 3) {
    if (role % 3 != 1) tissue.hold(lane, tip, kPatch, false);
    if (role % 3 != 0) tissue.hold_body(lane, tip, kPatch, false);
  }
  if (step == 12 + role % 2) tissue.release(lane);
  motion[static_cast<std::size_t>(lane)] = {tip, tip + Vector3d(0, 0, 0.0005)};
}

TEST(SoftGrasp, ALaneOfABatchEqualsARunAloneBitForBit) {
  const auto model = make_coupled(held_over_dome());
  constexpr int kRoles = 6;
  std::vector<std::uint64_t> alone;
  for (int role = 0; role < kRoles; ++role) {
    CoupledTissue<float> tissue(model, f32x1());
    std::vector<ToolMotion> motion(1);
    std::size_t most = 0;
    for (int step = 0; step < 15; ++step) {
      play_role(tissue, 0, role, step, motion);
      tissue.step(motion);
      most = std::max(most, tissue.held(0).size());
    }
    ASSERT_TRUE(tissue.healthy(0));
    EXPECT_GT(most, 0U) << role;
    alone.push_back(tissue.hash(0));
  }
  for (const unsigned width : {8U, 16U}) {
    if (width == 16 && __builtin_cpu_supports("avx512f") == 0) continue;
    CoupledTissue<float> tissue(model, choose_kernel(width));
    std::vector<ToolMotion> motion(width);
    for (int step = 0; step < 15; ++step) {
      for (int lane = 0; lane < tissue.lanes(); ++lane)
        play_role(tissue, lane, lane % kRoles, step, motion);
      tissue.step(motion);
    }
    for (int lane = 0; lane < tissue.lanes(); ++lane)
      EXPECT_EQ(tissue.hash(lane), alone[static_cast<std::size_t>(lane % kRoles)])
          << "width " << width << " lane " << lane;
  }
}

TEST(SoftGrasp, ASavedGraspContinuesBitForBitAndABrokenOneChangesNothing) {
  const auto model = make_coupled(held_over_dome());
  CoupledTissue<float> a(model, f32x1());
  const Vector3d to = kTop + Vector3d(0, 0, 0.005);
  move_tool(a, kTop, kTop, 20);
  hold_both(a, 0, kTop);
  move_tool(a, kTop, to, 10);
  Bytes state;
  a.save(0, state);
  CoupledTissue<float> b(model, f32x1());
  const auto loaded = b.load(0, state);
  ASSERT_TRUE(loaded.has_value());
  EXPECT_EQ(loaded.value(), state.size());
  EXPECT_TRUE(std::ranges::equal(b.held(0), a.held(0)));
  EXPECT_EQ(b.held_force(0), a.held_force(0));
  move_tool(a, to, to + Vector3d(0, 0, 0.002), 5);
  move_tool(b, to, to + Vector3d(0, 0, 0.002), 5);
  EXPECT_EQ(a.hash(0), b.hash(0));
  const std::uint64_t before = b.hash(0);
  // The last number is the weight of a node of the body, within (0, 1].
  const float two = 2;
  std::memcpy(state.data() + state.size() - sizeof two, &two, sizeof two);
  EXPECT_FALSE(b.load(0, state));
  EXPECT_EQ(b.hash(0), before);
}

}  // namespace
}  // namespace omentum
