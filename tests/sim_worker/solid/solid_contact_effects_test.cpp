// Effects of what the elastic solid touches, board and air, against their known answers
// (docs/mismatch.md 1), and those that only a sheet has.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <string>

#include "core/check.h"
#include "core/constants.h"
#include "support/effect_scene.h"
#include "support/solid_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::make_solid;
using test::NamedEffect;
using test::rest;
using test::SolidCase;
using test::weight_of;

using Solid = SolidTissue<double>;

constexpr double kTile = 0.006;  // height of the tile below [m]

/// Free tile of 20 x 20 x 6 mm whose lower face is `gap` above a board.
SolidCase tile(double gap) {
  SolidCase c;
  c.size = {0.02, 0.02, kTile};
  c.edge_length = 0.01;
  static const SolidMesh mesh = fill_mesh(make_box_mesh(0.5 * c.size), "box", c.edge_length);
  c.mesh = mesh;
  c.anchor_max_y = -1;
  c.young = 50e3;
  c.bodies = {test::make_board(0.5 * kTile + 0.0015 + gap)};
  return c;
}

Vector3d centre(const Solid& tissue) {
  Vector3d sum = Vector3d::Zero();
  for (int i = 0; i < tissue.particles(); ++i)
    sum += tissue.model().mass[static_cast<std::size_t>(i)] * tissue.position(0, i);
  return 9.81 * sum / weight_of(tissue);
}

/// From now on it would fall upwards.
void turn_over(const SolidCase& c, Solid& tissue) {
  LaneParameters parameters;
  parameters.effects = make_effects(c.effects, c.poisson, {});
  parameters.effects->tilt_x = std::numbers::pi;
  tissue.set_parameters(0, parameters);
}

TEST(SolidContactEffect, AdhesionHoldsUpToHalfItsReach) {
  SolidCase c = tile(0);
  c.damping = 20;
  c.effects.mutable_adhesion()->set_stiffness_pa_per_m(1e5);
  const double give = c.density * kTile * 9.81 / 1e5;
  for (const bool holds : {true, false}) {
    c.effects.mutable_adhesion()->set_break_m(holds ? 8 * give : 1.2 * give);
    Solid tissue(make_solid(c), f64x1());
    rest(tissue, 0.3);
    const double start = centre(tissue).z();
    turn_over(c, tissue);
    rest(tissue, 1.5);
    const double rise = centre(tissue).z() - start;
    if (holds) {
      EXPECT_NEAR(rise / give, 1, 0.03);
    } else {
      EXPECT_GT(rise, 0.01);
    }
  }
}

TEST(SolidContactEffect, SuctionLetsGoAtTheSpeedOfItsFilm) {
  const double drag = 1e5;
  const double reach = 0.001;
  const double gap = 5e-5;
  SolidCase c = tile(gap);
  c.effects.mutable_suction()->set_drag_pa_s_per_m(drag);
  c.effects.mutable_suction()->set_reach_m(reach);
  // z' = (p / c) (1 + z / r)^3, z the gap
  const double p = c.density * kTile * 9.81;
  const double u = std::pow(1 + gap / reach, -2) - 2 * p * 0.4 / (drag * reach);
  const double expected = reach * (1 / std::sqrt(u) - 1) - gap;
  for (const auto integrator : {pb::INTEGRATOR_BDF2, pb::INTEGRATOR_BACKWARD_EULER}) {
    c.integrator = integrator;
    Solid tissue(make_solid(c), f64x1());
    turn_over(c, tissue);
    rest(tissue, 0.4);
    EXPECT_NEAR(centre(tissue).z() / expected, 1, 0.05) << integrator;
  }
}

TEST(SolidContactEffect, AirDragLimitsTheFall) {
  SolidCase c = tile(0);
  c.bodies.clear();
  c.effects.set_air_drag(40);
  Solid tissue(make_solid(c), f64x1());
  const double limit = std::sqrt(2 * c.density * kTile * 9.81 / (kAirDensity * 40));
  // The drag of a substep is that of the speed at its start.
  for (int k = 1; k <= 10; ++k) {
    rest(tissue, 0.02);
    const double expected = limit * std::tanh(9.81 * 0.02 * k / limit);
    EXPECT_NEAR(-tissue.velocity(0, 0).z() / expected, 1, 0.02) << k;
  }
}

TEST(SolidEffectInput, WhatOnlyASheetHasIsRefusedInOneLine) {
  const auto message = [](auto set) -> std::string {
    SolidCase c = tile(0);
    c.bodies.clear();
    set(c.effects);
    try {
      make_solid(c);
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  };
  using E = pb::TissueEffects;
  const auto refused = [](const char* name) {
    return testing::AllOf(testing::StartsWith(std::string("scene.tissue.effects.") + name + ": "),
                          testing::HasSubstr("with a volume"),
                          testing::Not(testing::HasSubstr("\n")));
  };
  EXPECT_THAT(message([](E& e) { e.set_bending_change(1); }), refused("bending_change"));
  EXPECT_THAT(message([](E& e) { e.mutable_rest_shape()->set_curvature_x_per_m(1); }),
              refused("rest_shape"));
  EXPECT_THAT(message([](E& e) { e.mutable_thickness()->set_x_per_m(1); }), refused("thickness"));
  EXPECT_THAT(message([](E& e) { e.mutable_adhesion()->set_stiffness_pa_per_m(1e5); }),
              testing::HasSubstr("needs a scene.rigid_body"));
  EXPECT_THAT(message([](E& e) { e.set_poisson_change(0.3); }),
              testing::HasSubstr("allowed 0 ... 0.49"));
}

TEST(SolidEffectInput, BesideASheetItTakesWhatIsNotTheSheetsOwn) {
  pb::TissueEffects effects;
  for (const NamedEffect& effect : test::all_effects()) effect.set(effects, 1);
  const EffectValues all = make_effects(effects, 0.4, {});
  SolidTissueModel model;
  EXPECT_EQ(model.own_effects(all), all);
  model.beside_sheet = true;
  const EffectValues own = model.own_effects(all);
  EXPECT_EQ(own.tilt_x, all.tilt_x);
  EXPECT_EQ(own.friction_change, all.friction_change);
  EXPECT_EQ(own.grasp_x, all.grasp_x);
  EXPECT_EQ(own.slip_speed, 0);  // the sheet's slip takes the body along
  EXPECT_EQ(own.jaw_tilt, all.jaw_tilt);
  EXPECT_EQ(own.grasp_compliance, all.grasp_compliance);
  EXPECT_FALSE(own.has_memory());
  EXPECT_FALSE(own.moves_anchor());
  EXPECT_TRUE(own.same_structure({}));
  EXPECT_EQ(own.stiffening + own.density_change + own.adhesion + own.suction + own.air_drag, 0);
}

}  // namespace
}  // namespace omentum
