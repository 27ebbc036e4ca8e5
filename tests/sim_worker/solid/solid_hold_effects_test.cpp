// Effects of what holds the elastic solid, its clamp and the jaws, against their known answers
// (docs/mismatch.md 1).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <numbers>

#include "core/check.h"
#include "support/effect_scene.h"
#include "support/solid_scene.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using test::clamped_bar;
using test::make_solid;
using test::rest;
using test::SolidCase;
using test::tip_of;

using Solid = SolidTissue<double>;

// ---- clamp --------------------------------------------------------------------------------------

/// Bar that hangs from its clamp along y; how far its end is below the unloaded place.
SolidCase hanging_bar() {
  SolidCase c = clamped_bar();
  c.poisson = 0;
  c.young = 100e3;
  c.gravity = Vector3d(0, 9.81, 0);
  static const SolidMesh mesh = fill_mesh(make_box_mesh(0.5 * c.size), "box", c.edge_length);
  c.mesh = mesh;
  return c;
}

double extension(const SolidCase& c, double seconds) {
  Solid tissue(make_solid(c), f64x1());
  rest(tissue, seconds);
  return tip_of(tissue).y() - 0.06;
}

TEST(SolidAnchorEffect, SpringsCarryTheWeightAndBreak) {
  SolidCase c = hanging_bar();
  c.young = 1e6;
  const double rigid = extension(c, 1);
  c.effects.mutable_anchor()->set_compliance_m2_per_n(1e-4);
  const double weight = 1000 * 12e-6 * 9.81;
  const double sag = 1e-4 * weight / 0.01;  // [m], clamp of 10 mm
  EXPECT_NEAR((extension(c, 2) - rigid) / sag, 1, 0.01);
  {
    Solid tissue(make_solid(c), f64x1());
    rest(tissue, 2);
    EXPECT_NEAR(tissue.anchor_force(0).y() / weight, 1, 1e-3);
  }
  c.effects.mutable_anchor()->set_compliance_m2_per_n(1e-8);
  EXPECT_NEAR(extension(c, 1), rigid, 1e-6);

  // Springs hold up to half the breaking stretch, then let go.
  c.effects.mutable_anchor()->set_compliance_m2_per_n(1e-4);
  c.effects.mutable_anchor()->set_break_m(4 * sag);
  EXPECT_LT(extension(c, 1), rigid + 2.2 * sag);
  c.effects.mutable_anchor()->set_break_m(0.5 * sag);
  EXPECT_GT(extension(c, 0.5), 0.05);
}

TEST(SolidAnchorEffect, DetachedPieceHangsAndTheRestHolds) {
  SolidCase c = hanging_bar();
  const double whole = extension(c, 1);
  c.effects.mutable_anchor()->set_free_from_m(-0.9);
  c.effects.mutable_anchor()->set_free_to_m(-0.5);  // beside the bar
  EXPECT_NEAR(extension(c, 1), whole, 1e-9);
  c.effects.mutable_anchor()->set_free_from_m(0.001);
  c.effects.mutable_anchor()->set_free_to_m(0.5);
  Solid tissue(make_solid(c), f64x1());
  rest(tissue, 1);
  for (int i = 0; i < tissue.particles(); ++i) {
    const Vector3d p = tissue.model().mesh.nodes[static_cast<std::size_t>(i)];
    if (p.y() > -0.06 + 1e-6) continue;
    const double moved = (tissue.position(0, i) - p).norm();
    EXPECT_TRUE(p.x() < 0.004 || moved > 1e-4) << p.x() << " moved " << moved;
    EXPECT_TRUE(p.x() > -0.004 || moved == 0) << p.x() << " moved " << moved;
  }
  c.effects.mutable_anchor()->set_free_from_m(-0.5);
  try {
    make_solid(c);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("scene.tissue.effects.anchor"));
  }
}

// ---- grasp --------------------------------------------------------------------------------------

const Vector3d kEnd(0, 0.06, 0);  // where the bar is taken

/// Takes the bar's end and pulls it by `pull` within a control step; the tip afterwards.
Vector3d take(Solid& tissue, const Vector3d& pull) {
  tissue.hold(0, kEnd, 0.009, false);
  const ToolMotion motion{kEnd, kEnd + pull};
  tissue.step({&motion, 1});
  return kEnd + pull;
}

TEST(SolidGraspEffect, OffsetTakesThePatchBesideTheTip) {
  SolidCase c = clamped_bar();
  Solid plain(make_solid(c), f64x1());
  plain.hold(0, kEnd + Vector3d(0.003, -0.002, 0), 0.006, false);
  c.effects.mutable_grasp_offset()->set_x_m(0.003);
  c.effects.mutable_grasp_offset()->set_y_m(-0.002);
  c.effects.mutable_grasp_offset()->set_radius_m(0.001);
  Solid beside(make_solid(c), f64x1());
  beside.hold(0, kEnd, 0.005, false);
  EXPECT_THAT(beside.held(0), testing::ElementsAreArray(plain.held(0)));
  ASSERT_FALSE(beside.held(0).empty());
  const int node = beside.held(0)[0];
  const Vector3d before = beside.position(0, node);
  rest(beside, 0.1, kEnd);  // it stays where it was taken
  EXPECT_LT((beside.position(0, node) - before).norm(), 1e-9);
}

TEST(SolidGraspEffect, ComplianceIsASpringInSeriesAndThePatchKeepsItsShape) {
  for (const double radius : {0.009, 0.004}) {  // the whole end; one node firmly, some partly
    SolidCase c = clamped_bar();
    const double pull = 0.001;
    const auto pulled = [&] {
      auto tissue = std::make_unique<Solid>(make_solid(c), f64x1());
      tissue->hold(0, kEnd, radius, false);
      const ToolMotion motion{kEnd, kEnd + Vector3d(0, pull, 0)};
      tissue->step({&motion, 1});
      rest(*tissue, 2, motion.to);
      return tissue;
    };
    const auto stiff = pulled();
    const double rigid = -stiff->held_force(0).y();
    c.effects.set_grasp_compliance_m_per_n(0.01);
    const auto soft = pulled();
    EXPECT_NEAR(-soft->held_force(0).y() / (rigid / (1 + 0.01 * rigid / pull)), 1, 0.002) << radius;
    EXPECT_NEAR(soft->anchor_force(0).y() / -soft->held_force(0).y(), 1, 1e-3) << radius;
    // Scaled by the force the patch moved as a whole.
    const auto held = soft->held(0);
    const double share = soft->held_force(0).y() / stiff->held_force(0).y();
    for (const std::int32_t i : held) {
      const Vector3d at = soft->model().mesh.nodes[static_cast<std::size_t>(i)];
      const Vector3d expected = share * (stiff->position(0, i) - at);
      EXPECT_LT((soft->position(0, i) - at - expected).norm(), 0.005 * pull) << radius;
    }
  }
}

TEST(SolidGraspEffect, SlipRelaxesTheForceAndLossLetsGo) {
  SolidCase c = clamped_bar();
  const double pull = 0.001;
  Solid rigid(make_solid(c), f64x1());
  Vector3d tip = take(rigid, Vector3d(0, pull, 0));
  rest(rigid, 0.5, tip);
  const double first = rigid.held_force(0).norm();
  const double k = first / pull;
  const double limit = 0.25 * first;
  const double speed = 1e-4;
  c.effects.mutable_grasp_slip()->set_speed_m_per_s(speed);
  c.effects.mutable_grasp_slip()->set_force_n(limit);
  Solid slipping(make_solid(c), f64x1());
  tip = take(slipping, Vector3d(0, pull, 0));
  rest(slipping, 0.5, tip);
  const double start = slipping.held_force(0).norm();
  rest(slipping, 1, tip);
  // dF/dt = -k v0 (F/Fs - 1)
  const double expected = limit + (start - limit) * std::exp(-k * speed / limit);
  EXPECT_NEAR(slipping.held_force(0).norm() / expected, 1, 0.03);

  c.effects.mutable_grasp_slip()->set_loss_m(1e-4);
  Solid lost(make_solid(c), f64x1());
  tip = take(lost, Vector3d(0, pull, 0));
  EXPECT_FALSE(lost.held(0).empty());
  rest(lost, 2, tip);
  EXPECT_TRUE(lost.held(0).empty());
}

TEST(SolidGraspEffect, JawsTurnWhatTheyHold) {
  SolidCase c = clamped_bar();
  c.effects.set_jaw_roll_deg(20);
  c.effects.set_jaw_tilt_deg(-10);
  const auto model = make_solid(c);
  Solid tissue(model, f64x1());
  tissue.hold(0, kEnd, 0.009, false);
  rest(tissue, 0.1, kEnd);
  const double degree = std::numbers::pi / 180;
  const Matrix3d turn = (Eigen::AngleAxisd(-10 * degree, Vector3d::UnitX()) *
                         Eigen::AngleAxisd(20 * degree, model->surroundings.shaft_axis))
                            .toRotationMatrix();
  int firm = 0;
  for (const std::int32_t i : tissue.held(0)) {
    const Vector3d from = model->mesh.nodes[static_cast<std::size_t>(i)] - kEnd;
    if (from.norm() > 0.009 - 0.5 * model->spacing) continue;
    EXPECT_LT((tissue.position(0, i) - kEnd - turn * from).norm(), 1e-12) << i;
    ++firm;
  }
  EXPECT_GT(firm, 5);
}

}  // namespace
}  // namespace omentum
