// Effects on a place of the sheet, and what belongs to them, against their known answers
// (docs/mismatch.md 1), the same law in both models: exponential stiffening, several inclusions,
// added mass, local force, adhesion on a place, slip that ends, jaws that lean and turn.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "support/effect_law.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::EffectCase;
using test::EffectLaw;
using test::Model;
using test::rest;

class PlaceEffect : public EffectLaw {
 protected:
  static constexpr double kSection = 0.009 * 0.003;  // of the strip [m^2]
  static constexpr double kPlace = 0.02;             // y_B of the places on it [m]

  static void put_force(EffectCase& c) {
    c.effects.mutable_local_force()->set_strength(1);
    c.effects.mutable_local_force()->set_y_m(kPlace);
    c.effects.mutable_local_force()->set_radius_m(0.006);
  }
  /// Free sheet of 15 mm in the air.
  static EffectCase tile() {
    EffectCase c;
    c.nx = c.ny = 6;
    c.anchor_max_y = -1;
    c.young = 50e3;
    c.damping = 0;
    c.gravity = 0;
    c.ex = c.ey = 2;
    return c;
  }
  static constexpr double kTileMass = 1000 * 0.003 * 0.015 * 0.015;  // [kg]
  static Vector3d centre(const Tissue<double>& tissue) {
    Vector3d sum = Vector3d::Zero();
    for (int i = 0; i < tissue.particles(); ++i) sum += tissue.position(0, i) / tissue.particles();
    return sum;
  }
};

INSTANTIATE_TEST_SUITE_P(Both, PlaceEffect, testing::Values(Model::kElastic, Model::kReference),
                         [](const auto& p) {
                           return p.param == Model::kElastic ? "Elastic" : "Reference";
                         });

TEST_P(PlaceEffect, ExponentialStiffeningFollowsItsStress) {
  EffectCase c = strip(8e3);
  for (const double b : {5.0, 30.0}) {
    c.effects.set_exponential_stiffening(b);
    const double expected = hanging([&](double l) {
      const double e = 0.5 * (l * l - 1);
      return c.young * (l - 1) + l * c.young * std::expm1(2 * b * e * e) * e;  // 2 mu = E
    });
    EXPECT_NEAR(extension(c, 4) / expected, 1, 0.005) << b;
  }
}

TEST_P(PlaceEffect, ExponentialStiffeningIsYeohsAtSmallStrain) {
  EffectCase c = strip(50e3);
  const double plain = extension(c, 3);
  c.effects.set_exponential_stiffening(40);
  const double exponential = extension(c, 3);
  c.effects.set_exponential_stiffening(0);
  c.effects.set_strain_stiffening(10);
  EXPECT_GT(plain - exponential, 1e-6);
  EXPECT_NEAR((plain - extension(c, 3)) / (plain - exponential), 1, 0.03);  // b I / 3 of the next
}

TEST_P(PlaceEffect, InclusionsAtOnePlaceAddUp) {
  EffectCase c = strip(30e3);
  const auto add = [&](double y, double change) {
    pb::Inclusion& inclusion = *c.effects.add_inclusion();
    inclusion.set_y_m(y);
    inclusion.set_radius_m(0.012);
    inclusion.set_stiffness_change(change);
  };
  add(0.02, 0.5);
  const double half = extension(c);
  add(0.02, 1);
  const double sum = extension(c);
  c.effects.clear_inclusion();
  add(0.02, 1.5);
  EXPECT_NEAR(sum / extension(c), 1, 1e-9);
  EXPECT_LT(sum, 0.999 * half);
  // Apart they act each in its place: the one nearer to the clamp carries more.
  c.effects.clear_inclusion();
  add(-0.025, 1.5);
  add(0.02, 1.5);
  EXPECT_LT(extension(c), 0.99 * sum);
}

TEST_P(PlaceEffect, AddedMassHangsWhereItIs) {
  EffectCase c = strip(50e3);
  const double plain = extension(c);
  c.effects.mutable_added_mass()->set_mass_kg(1e-3);
  c.effects.mutable_added_mass()->set_y_m(kPlace);
  c.effects.mutable_added_mass()->set_radius_m(0.006);
  const double expected = 1e-3 * kGravity * (kPlace + 0.045) / (c.young * kSection);
  EXPECT_NEAR((extension(c, 4) - plain) / expected, 1, 0.02);
  // It has inertia too: a free tile with it falls as it does without.
  EffectCase falling = tile();
  falling.gravity = kGravity;
  falling.effects.mutable_added_mass()->set_mass_kg(5 * kTileMass);
  falling.effects.mutable_added_mass()->set_radius_m(0.1);
  const auto tissue = make(falling);
  rest(*tissue, 0.1);
  EXPECT_NEAR(tissue->velocity(0, 0).z() / (-0.1 * kGravity), 1, 1e-6);
}

TEST_P(PlaceEffect, APushStretchesTheStripAsAWeightThere) {
  EffectCase c = strip(50e3);
  c.gravity = 0;
  put_force(c);
  c.effects.mutable_local_force()->set_push_z_n(-0.01);
  const double expected = 0.01 * (kPlace + 0.045) / (c.young * kSection);
  EXPECT_NEAR(extension(c, 4) / expected, 1, 0.02);
  c.effects.mutable_local_force()->set_strength(0.5);
  EXPECT_NEAR(extension(c, 4) / (0.5 * expected), 1, 0.02);
}

TEST_P(PlaceEffect, AStringPullsBeyondItsSlack) {
  EffectCase c = strip(50e3);
  c.gravity = 0;
  put_force(c);
  const double k = 10;
  const double sheet = c.young * kSection / (kPlace + 0.045);
  const double pulled = 0.002;
  auto& force = *c.effects.mutable_local_force();
  force.set_stiffness_n_per_m(k);
  force.set_anchor_z_m(-kPlace - pulled);  // the strip hangs: z_W = -y_B
  for (const double slack : {0.0, 0.0005}) {
    force.set_slack_m(slack);
    EXPECT_NEAR(extension(c, 4) / (k * (pulled - slack) / (k + sheet)), 1, 0.03) << slack;
  }
  force.set_slack_m(2 * pulled);
  EXPECT_NEAR(extension(c, 4), 0, 1e-6);
  // A string 30 times as stiff as the sheet takes it along.
  force.set_slack_m(0);
  force.set_stiffness_n_per_m(30 * sheet);
  EXPECT_NEAR(extension(c, 4) / (pulled * 30 / 31), 1, 0.05);
}

TEST_P(PlaceEffect, ADamperLimitsTheFall) {
  EffectCase c = tile();
  c.gravity = kGravity;
  auto& force = *c.effects.mutable_local_force();
  force.set_strength(1);
  force.set_radius_m(0.1);
  force.set_damper_n_s_per_m(0.05);
  const auto tissue = make(c);
  rest(*tissue, 0.3);
  EXPECT_NEAR(-tissue->velocity(0, 0).z() / (kTileMass * kGravity / 0.05), 1, 0.01);
}

TEST_P(PlaceEffect, APushFades) {
  EffectCase c = tile();
  auto& force = *c.effects.mutable_local_force();
  force.set_strength(1);
  force.set_radius_m(0.1);
  force.set_push_x_n(1e-4);
  force.set_decay_s(0.2);
  const auto tissue = make(c);
  for (const double t : {0.1, 0.2, 0.6}) {
    const auto moved = make(c);
    rest(*moved, t);
    const double expected = 1e-4 * 0.2 / kTileMass * (1 - std::exp(-t / 0.2));
    // The push of a step is that at its end.
    EXPECT_NEAR(moved->velocity(0, 0).x() / expected, 1, 0.06) << t;
  }
  // Not while its clock is stopped.
  tissue->stop_clock(0, true);
  rest(*tissue, 0.4);
  EXPECT_NEAR(tissue->velocity(0, 0).x() / (1e-4 * 0.4 / kTileMass), 1, 1e-6);
}

TEST_P(PlaceEffect, AdhesionOnAPlaceHoldsByItsArea) {
  EffectCase c = tile();
  c.gravity = kGravity;
  c.damping = 20;
  c.young = 2e5;
  c.bodies = {test::make_board(0.0015)};
  auto& adhesion = *c.effects.mutable_adhesion();
  adhesion.set_stiffness_pa_per_m(2e5);
  adhesion.set_break_m(0.01);
  for (const double half : {0.004, 0.005, 0.0062}) {
    adhesion.set_half_x_m(half);
    adhesion.set_half_y_m(0.005);
    const auto tissue = make(c);
    rest(*tissue, 0.3);
    const double start = centre(*tissue).z();
    LaneParameters over;
    over.effects = make_effects(c.effects, c.poisson, {});
    over.effects->tilt_x = std::numbers::pi;
    tissue->set_parameters(0, over);
    rest(*tissue, 2);
    const double expected = kTileMass * kGravity / (2e5 * 4 * half * 0.005);
    EXPECT_NEAR((centre(*tissue).z() - start) / expected, 1, 0.06) << half;
  }
}

TEST_P(PlaceEffect, SlipEndsAfterItsWay) {
  EffectCase c;
  c.nx = c.ny = 13;
  c.anchor_max_y = -0.018;
  c.young = 30e3;
  c.gravity = 0;
  c.damping = 20;
  c.ex = c.ey = 8;
  const double pull = 0.0005;
  const auto force = [&] {
    const auto tissue = make(c);
    const Vector3d from(0, 0.012, 0);
    tissue->hold(0, from, 0.005, false);
    const ToolMotion motion{from, from + Vector3d(0, pull, 0)};
    tissue->step({&motion, 1});
    rest(*tissue, 2, motion.to);
    EXPECT_FALSE(tissue->held(0).empty());
    return tissue->held_force(0).norm();
  };
  const double whole = force();
  c.effects.mutable_grasp_slip()->set_speed_m_per_s(1e-3);
  c.effects.mutable_grasp_slip()->set_force_n(0.01 * whole);
  for (const double total : {0.2 * pull, 0.6 * pull}) {
    c.effects.mutable_grasp_slip()->set_total_m(total);
    EXPECT_NEAR(force() / whole, 1 - total / pull, 0.02) << total;
  }
}

class TurningJaws : public PlaceEffect {
 protected:
  static EffectCase sheet() {
    EffectCase c;
    c.nx = c.ny = 13;
    c.anchor_max_y = -0.018;
    c.young = 30e3;
    c.gravity = 0;
    c.damping = 20;
    c.ex = c.ey = 8;
    return c;
  }
  /// Slopes of the held patch along x_B and y_B, in degrees: about y_W downwards, about x_W
  /// upwards.
  Eigen::Vector2d slopes(const EffectCase& c) const {
    const auto tissue = make(c);
    const Vector3d tip(0, 0.006, 0);
    tissue->hold(0, tip, 0.005, false);
    rest(*tissue, 2, tip);
    const auto at = [&](int ix, int iy) { return tissue->position(0, 13 * ix + iy); };
    const Vector3d along = at(7, 8) - at(5, 8);
    const Vector3d across = at(6, 9) - at(6, 7);
    return Eigen::Vector2d(-std::atan2(along.z(), along.x()), std::atan2(across.z(), across.y())) *
           180 / std::numbers::pi;
  }
};

INSTANTIATE_TEST_SUITE_P(Both, TurningJaws, testing::Values(Model::kElastic, Model::kReference),
                         [](const auto& p) {
                           return p.param == Model::kElastic ? "Elastic" : "Reference";
                         });

TEST_P(TurningJaws, LeanTurnsThePatchAboutY) {
  EffectCase c = sheet();
  c.effects.set_jaw_lean_deg(20);
  EXPECT_NEAR(slopes(c)[0], 20, 5);
  EXPECT_NEAR(slopes(c)[1], 0, 1e-6);
}

TEST_P(TurningJaws, GiveWayByTheirMoment) {
  // Jaws and sheet are springs in series: the angle falls as 1 / (1 + C K).
  EffectCase c = sheet();
  c.effects.set_jaw_lean_deg(3);
  c.effects.set_jaw_tilt_deg(2);
  const Eigen::Vector2d rigid = slopes(c);
  const auto softer = [&](double compliance) -> Eigen::Vector2d {
    c.effects.set_grasp_turn_rad_per_n_m(compliance);
    return rigid.cwiseQuotient(slopes(c)) - Eigen::Vector2d::Ones();
  };
  EXPECT_LT(softer(1e-6).cwiseAbs().maxCoeff(), 1e-6);
  const Eigen::Vector2d once = softer(500);
  const Eigen::Vector2d twice = softer(1000);
  for (int axis = 0; axis < 2; ++axis) {
    EXPECT_GT(once[axis], 0.02) << axis;
    EXPECT_NEAR(twice[axis] / once[axis], 2, 0.1) << axis;
  }
}

}  // namespace
}  // namespace omentum
