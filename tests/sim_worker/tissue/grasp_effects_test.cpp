// Effects of the grasp on a sheet against their known answers (docs/mismatch.md 1), the same law in
// both models.
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

class EffectGrasp : public EffectLaw {
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
  /// Takes the sheet near its free edge and pulls it by `pull`; the tip at the end.
  static Vector3d take(Tissue<double>& tissue, const Vector3d& pull,
                       const Vector3d& from = Vector3d(0, 0.012, 0)) {
    tissue.hold(0, from, 0.005, false);
    const ToolMotion motion{from, from + pull};
    tissue.step({&motion, 1});
    return from + pull;
  }
};

INSTANTIATE_TEST_SUITE_P(Both, EffectGrasp, testing::Values(Model::kElastic, Model::kReference),
                         [](const auto& p) {
                           return p.param == Model::kElastic ? "Elastic" : "Reference";
                         });

TEST_P(EffectGrasp, OffsetTakesThePatchBesideTheTip) {
  EffectCase c = sheet();
  const auto plain = make(c);
  plain->hold(0, Vector3d(0.003, 0.010, 0), 0.005, false);
  c.effects.mutable_grasp_offset()->set_x_m(0.003);
  c.effects.mutable_grasp_offset()->set_y_m(-0.002);
  const auto beside = make(c);
  beside->hold(0, Vector3d(0, 0.012, 0), 0.005, false);
  EXPECT_THAT(beside->held(0), testing::ElementsAreArray(plain->held(0)));
  ASSERT_FALSE(beside->held(0).empty());
  const int particle = beside->held(0)[0];
  const Vector3d before = beside->position(0, particle);
  rest(*beside, 1, Vector3d(0, 0.012, 0));  // it stays where it was taken
  EXPECT_LT((beside->position(0, particle) - before).norm(), 1e-7);
}

TEST_P(EffectGrasp, ComplianceIsASpringInSeries) {
  EffectCase c = sheet();
  const double pull = 0.0005;
  const auto force = [&] {
    const auto tissue = make(c);
    const Vector3d tip = take(*tissue, Vector3d(0, pull, 0));
    rest(*tissue, 3, tip);
    return -tissue->held_force(0).y();
  };
  const double rigid = std::fabs(force());
  c.effects.set_grasp_compliance_m_per_n(0.02);
  EXPECT_NEAR(std::fabs(force()) / (rigid / (1 + 0.02 * rigid / pull)), 1, 0.01);
}

TEST_P(EffectGrasp, SlipRelaxesTheForceAndLossLetsGo) {
  EffectCase c = sheet();
  c.damping = 5;
  const double pull = 0.0005;
  const auto rigid = make(c);
  Vector3d tip = take(*rigid, Vector3d(0, pull, 0));
  rest(*rigid, 0.5, tip);
  const double first = rigid->held_force(0).norm();
  const double k = first / pull;
  const double limit = 0.25 * first;
  const double speed = 1e-4;
  c.effects.mutable_grasp_slip()->set_speed_m_per_s(speed);
  c.effects.mutable_grasp_slip()->set_force_n(limit);
  const auto slipping = make(c);
  tip = take(*slipping, Vector3d(0, pull, 0));
  rest(*slipping, 0.5, tip);
  const double start = slipping->held_force(0).norm();
  rest(*slipping, 1, tip);
  // dF/dt = -k v0 (F/Fs - 1)
  const double expected = limit + (start - limit) * std::exp(-k * speed / limit);
  EXPECT_NEAR(slipping->held_force(0).norm() / expected, 1, 0.03);

  c.effects.mutable_grasp_slip()->set_loss_m(5e-5);
  const auto lost = make(c);
  tip = take(*lost, Vector3d(0, pull, 0));
  EXPECT_FALSE(lost->held(0).empty());
  rest(*lost, 2, tip);
  EXPECT_TRUE(lost->held(0).empty());
}

TEST_P(EffectGrasp, JawTurnsThePatch) {
  EffectCase c = sheet();
  const Vector3d tip(0, 0.006, 0);
  const auto angle = [&]() -> Vector3d {
    const auto tissue = make(c);
    tissue->hold(0, tip, 0.005, false);
    rest(*tissue, 1, tip);
    const auto at = [&](int ix, int iy) { return tissue->position(0, 13 * ix + iy); };
    const Vector3d along = at(7, 8) - at(5, 8);  // across the middle of the patch
    return Vector3d(std::atan2(along.y(), along.x()), std::atan2(along.z(), along.x()),
                    std::atan2((at(6, 9) - at(6, 7)).z(), (at(6, 9) - at(6, 7)).y())) *
           180 / std::numbers::pi;
  };
  c.effects.set_jaw_roll_deg(20);
  // Held are the mean slopes of the patch; its middle turns further, most of all in its plane.
  EXPECT_NEAR(angle()[0], 20, 6);
  c.effects.set_jaw_roll_deg(0);
  c.effects.set_jaw_tilt_deg(20);
  EXPECT_NEAR(angle()[2], 20, 5);
}

}  // namespace
}  // namespace omentum
