// Effects of what a sheet touches, board and air, against their known answers (docs/mismatch.md 1),
// the same law in both models.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/constants.h"
#include "support/effect_law.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::EffectCase;
using test::EffectLaw;
using test::Model;
using test::rest;

class EffectContact : public EffectLaw {
 protected:
  /// Free sheet of 15 mm that lies on a board.
  static EffectCase tile() {
    EffectCase c;
    c.nx = c.ny = 6;
    c.anchor_max_y = -1;
    c.young = 50e3;
    c.damping = 0;
    c.bodies = {test::make_board(0.0015)};
    c.ex = c.ey = 2;
    return c;
  }
  static Vector3d centre(const Tissue<double>& tissue) {
    Vector3d sum = Vector3d::Zero();
    for (int i = 0; i < tissue.particles(); ++i) sum += tissue.position(0, i) / tissue.particles();
    return sum;
  }
  void turn_over(const EffectCase& c, Tissue<double>& tissue) const {
    LaneParameters parameters;
    parameters.effects = make_effects(c.effects, c.poisson, {});
    parameters.effects->tilt_x = std::numbers::pi;
    tissue.set_parameters(0, parameters);
  }
};

INSTANTIATE_TEST_SUITE_P(Both, EffectContact, testing::Values(Model::kElastic, Model::kReference),
                         [](const auto& p) {
                           return p.param == Model::kElastic ? "Elastic" : "Reference";
                         });

TEST_P(EffectContact, AdhesionHoldsUpToHalfItsReach) {
  const double pressure = kDensity * 0.003 * kGravity;  // weight per area
  EffectCase c = tile();
  c.damping = 20;
  c.effects.mutable_adhesion()->set_stiffness_pa_per_m(1e5);
  const double give = pressure / 1e5;
  for (const bool holds : {true, false}) {
    c.effects.mutable_adhesion()->set_break_m(holds ? 8 * give : 1.2 * give);
    const auto tissue = make(c);
    rest(*tissue, 0.3);
    const double start = centre(*tissue).z();
    turn_over(c, *tissue);
    rest(*tissue, 1.5);
    const double rise = centre(*tissue).z() - start;
    if (holds) {
      EXPECT_NEAR(rise / give, 1, 0.04);
    } else {
      EXPECT_GT(rise, 0.01);
    }
  }
}

TEST_P(EffectContact, SuctionLetsGoAtTheSpeedOfItsFilm) {
  EffectCase c = tile();
  const double drag = 1e5;
  const double reach = 0.001;
  const double gap = 5e-5;
  c.bodies = {test::make_board(0.0015 + gap)};
  c.effects.mutable_suction()->set_drag_pa_s_per_m(drag);
  c.effects.mutable_suction()->set_reach_m(reach);
  // z' = (p / c) (1 + z / r)^3, z the gap
  const double u =
      std::pow(1 + gap / reach, -2) - 2 * kDensity * 0.003 * kGravity * 0.5 / (drag * reach);
  const double expected = reach * (1 / std::sqrt(u) - 1) - gap;
  for (const auto integrator : {pb::INTEGRATOR_BDF2, pb::INTEGRATOR_BACKWARD_EULER}) {
    c.integrator = integrator;
    const auto tissue = make(c);
    turn_over(c, *tissue);
    rest(*tissue, 0.5);
    EXPECT_NEAR(centre(*tissue).z() / expected, 1, 0.05) << integrator;
  }

  // The same from the board, pressed on it by its weight before.
  c.bodies = {test::make_board(0.0015)};
  const auto pressed = make(c);
  rest(*pressed, 0.3);
  const double start = centre(*pressed).z();
  turn_over(c, *pressed);
  rest(*pressed, 0.5);
  const double w = 1 - 2 * kDensity * 0.003 * kGravity * 0.5 / (drag * reach);
  EXPECT_NEAR((centre(*pressed).z() - start) / (reach * (1 / std::sqrt(w) - 1)), 1, 0.08);
}

TEST_P(EffectContact, FrictionHoldsOnASteeperSlope) {
  for (const double more : {0.0, 1.0}) {
    EffectCase c = tile();
    c.static_friction = c.dynamic_friction = 0.3;
    c.effects.set_friction_change(more);
    c.effects.set_gravity_tilt_x_deg(20);  // tan 20 deg = 0.36
    const auto tissue = make(c);
    rest(*tissue, 1);
    const double slid = std::fabs(centre(*tissue).y());
    if (more > 0) {
      EXPECT_LT(slid, 2e-4);
    } else {
      const double a = kGravity * (std::sin(20 * std::numbers::pi / 180) -
                                   0.3 * std::cos(20 * std::numbers::pi / 180));
      EXPECT_NEAR(slid / (0.5 * a), 1, 0.1);
    }
  }
}

TEST_P(EffectContact, AirDragLimitsTheFall) {
  EffectCase c = tile();
  c.bodies.clear();
  c.effects.set_air_drag(40);
  const auto tissue = make(c);
  const double limit = std::sqrt(2 * kDensity * 0.003 * kGravity / (kAirDensity * 40));
  // The drag of a step is that of the speed at its start: 5 % at 20 ms.
  for (int k = 1; k <= 10; ++k) {
    rest(*tissue, 0.02);
    const double expected = limit * std::tanh(kGravity * 0.02 * k / limit);
    EXPECT_NEAR(-tissue->velocity(0, 0).z() / expected, 1, 0.05) << k;
  }
}

}  // namespace
}  // namespace omentum
