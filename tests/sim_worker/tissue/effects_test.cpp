// Effects of tissue, clamp and grasp against their known answers (docs/mismatch.md 1), the same law
// in both models. Those of Mullins softening and structural damping are in files of their own.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/constants.h"
#include "sim_worker/tissue/effect_laws.h"
#include "support/effect_law.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::EffectCase;
using test::EffectLaw;
using test::Model;
using test::rest;
using test::upright;

INSTANTIATE_TEST_SUITE_P(Both, EffectLaw, testing::Values(Model::kElastic, Model::kReference),
                         [](const auto& p) {
                           return p.param == Model::kElastic ? "Elastic" : "Reference";
                         });

TEST_P(EffectLaw, DensityScalesTheWeight) {
  EffectCase c = strip(50e3);
  c.effects.set_density_change(0.4);
  const double expected = 1.4 * kDensity * kGravity * kLength * kLength / (2 * c.young);
  EXPECT_NEAR(extension(c) / expected, 1, 0.003);
}

TEST_P(EffectLaw, TiltTurnsGravity) {
  EffectCase c = strip(50e3);
  c.X_WB = Eigen::Isometry3d::Identity();
  c.effects.set_gravity_tilt_x_deg(90);
  const auto tissue = make(c);
  rest(*tissue, 2);
  const double expected = kDensity * kGravity * kLength * kLength / (2 * c.young);
  EXPECT_NEAR((edge(c, *tissue).y() - 0.045) / expected, 1, 0.003);
}

TEST_P(EffectLaw, PoissonContractsAcross) {
  EffectCase c = strip(20e3);
  c.effects.set_poisson_change(0.3);
  const auto tissue = make(c);
  rest(*tissue, 2);
  const int middle = 15;
  const double width = (tissue->position(0, 3 * 31 + middle) - tissue->position(0, middle)).norm();
  const double strain = kDensity * kGravity * 0.5 * kLength / c.young;
  EXPECT_NEAR((0.009 - width) / (0.3 * strain * 0.009), 1, 0.04);  // second order in 2 % strain
}

TEST_P(EffectLaw, BendingChangeScalesThePlateAlone) {
  // Small drop of a cantilever: inversely as its bending stiffness.
  EffectCase c = cantilever();
  const double plain = drop(c);
  c.effects.set_bending_change(2);
  EXPECT_NEAR(plain / drop(c), 3, 0.03);
  c.X_WB = upright();
  c.gravity = kGravity;
  c.young = 50e3;
  const double bent = extension(c);
  c.effects.clear_bending_change();
  EXPECT_NEAR(bent / extension(c), 1, 0.02);
}

TEST_P(EffectLaw, RestStretchLowersACantileverAsItsLengthToTheFourth) {
  // Energy counts per volume before the growth g: drop of q L^4 / (8 D), D (w'' / g^2)^2 / 2.
  EffectCase c = cantilever();
  const double plain = drop(c);
  c.effects.mutable_rest_shape()->set_stretch(0.05);
  EXPECT_NEAR(drop(c) / plain, std::pow(1.05, 4), 0.012);
}

TEST_P(EffectLaw, InclusionOverEverythingIsAnotherModulus) {
  EffectCase c = strip(30e3);
  test::inclusion_of(c.effects)->set_radius_m(0.5);
  test::inclusion_of(c.effects)->set_stiffness_change(1);
  const double expected = kDensity * kGravity * kLength * kLength / (2 * 2 * c.young);
  EXPECT_NEAR(extension(c) / expected, 1, 0.004);
}

TEST_P(EffectLaw, SoftSpotStretchesWhereItIs) {
  EffectCase c = strip(50e3);
  const double plain = extension(c);
  test::inclusion_of(c.effects)->set_y_m(0.02);
  test::inclusion_of(c.effects)->set_radius_m(0.012);
  test::inclusion_of(c.effects)->set_stiffness_change(-0.5);
  const auto tissue = make(c);
  rest(*tissue, 2);
  const double soft = -0.045 - edge(c, *tissue).z();
  // Series of slices: 1/E is larger by share/(1 - share) of w there.
  double expected = 0;
  for (int k = 0; k < 900; ++k) {
    const double y = -0.045 + (k + 0.5) * 1e-4;
    const double t = std::clamp((1.25 - std::fabs(y - 0.02) / 0.012) / 0.5, 0.0, 1.0);
    const double w = t * t * (3 - 2 * t);
    const double carried = kDensity * kGravity * (0.045 - y);
    expected += carried / c.young * (1 / (1 - 0.5 * w) - 1) * 1e-4;
  }
  EXPECT_NEAR((soft - plain) / expected, 1, 0.06);  // the disc is 24 mm, the strip 9 mm wide
}

TEST_P(EffectLaw, ThicknessGradientFollowsTheIntegral) {
  EffectCase c = strip(50e3);
  c.effects.mutable_thickness()->set_y_per_m(6);
  double expected = 0;
  for (int k = 0; k < 900; ++k) {
    const double y = -0.045 + (k + 0.5) * 1e-4;
    const double below = (0.045 - y) + 3 * (0.045 * 0.045 - y * y);
    expected += kDensity * kGravity * below / (c.young * (1 + 6 * y)) * 1e-4;
  }
  EXPECT_NEAR(extension(c) / expected, 1, 0.006);
}

TEST_P(EffectLaw, RestStretchLengthensAndCurvatureCurls) {
  EffectCase c = strip(50e3);
  c.gravity = 0;
  c.effects.mutable_rest_shape()->set_stretch(0.05);
  EXPECT_NEAR(extension(c) / (0.05 * kLength), 1, 0.02);

  c.effects.mutable_rest_shape()->set_stretch(0);
  c.effects.mutable_rest_shape()->set_curvature_y_per_m(10);
  c.X_WB = Eigen::Isometry3d::Identity();
  c.anchor_max_y = -0.042;
  c.damping = 10;
  c.young = 1e6;
  const auto tissue = make(c);
  rest(*tissue, 4);
  const auto slope = [&](int iy) {
    const Vector3d along = tissue->position(0, 31 + iy + 1) - tissue->position(0, 31 + iy);
    return std::atan2(along.z(), along.y());
  };
  EXPECT_NEAR((slope(27) - slope(5)) / (22 * 0.003 * 10), 1, 0.02);
}

TEST_P(EffectLaw, StrainStiffeningFollowsItsStress) {
  for (const double c2 : {6.0, -0.3}) {
    EffectCase c = strip(8e3);
    c.effects.set_strain_stiffening(c2);
    const double mu = c.young / 2;
    const double expected = hanging([&](double l) {
      const double e = 0.5 * (l * l - 1);
      return c.young * (l - 1) + l * 8 * c2 * mu * 2 * e * e * e;
    });
    EXPECT_NEAR(extension(c, 4) / expected, 1, 0.005) << c2;
  }
}

TEST_P(EffectLaw, FibresPullAlongThemselvesOnly) {
  EffectCase c = strip(20e3);
  c.effects.mutable_anisotropy()->set_fibre_ratio(1.5);
  c.effects.mutable_anisotropy()->set_angle_deg(90);
  const auto taut = [](double l) {
    const double e = 0.5 * (l * l - 1);
    return 0.5 * (e + std::sqrt(e * e + 1e-6) - 1e-3);
  };
  const double expected =
      hanging([&](double l) { return c.young * (l - 1) + l * 1.5 * c.young * taut(l); });
  EXPECT_NEAR(extension(c) / expected, 1, 0.005);
  c.effects.mutable_anisotropy()->set_angle_deg(0);
  const double across = hanging([&](double l) { return c.young * (l - 1); });
  EXPECT_NEAR(extension(c) / across, 1, 0.005);
}

TEST_P(EffectLaw, ViscoelasticCreepsWithTheRetardationTime) {
  // One branch of share 1: J(t) E = 1 - 1/2 exp(-t / (2 tau)).
  for (const auto integrator : {pb::INTEGRATOR_BACKWARD_EULER, pb::INTEGRATOR_BDF2}) {
    EffectCase c = strip(100e3);
    c.integrator = integrator;
    auto* branch = c.effects.add_viscoelastic();
    branch->set_share(1);
    branch->set_time_s(0.5);
    const auto tissue = make(c);
    const double slow = kDensity * kGravity * kLength * kLength / (2 * c.young);
    double seconds = 0;
    for (const double t : {0.6, 1.2, 2.4}) {
      rest(*tissue, t - seconds);
      seconds = t;
      const double expected = slow * (1 - 0.5 * std::exp(-t / 1.0));
      EXPECT_NEAR((-0.045 - edge(c, *tissue).z()) / expected, 1, 0.012) << t << " " << integrator;
    }
  }
}

TEST_P(EffectLaw, PlasticSetStaysAfterUnloading) {
  EffectCase c = strip(100e3);
  c.effects.mutable_plastic_set()->set_modulus_ratio(0.2);
  c.effects.mutable_plastic_set()->set_yield_strain(0.004);
  const auto tissue = make(c);
  const auto load = [&](double share) {  // slowly: a sudden load would swing to twice the strain
    LaneParameters parameters;
    parameters.gravity_scale = share;
    tissue->set_parameters(0, parameters);
    rest(*tissue, 0.06);
  };
  for (int k = 0; k <= 40; ++k) load(k / 40.0);
  rest(*tissue, 1);
  for (int k = 0; k <= 40; ++k) load(1 - k / 40.0);
  rest(*tissue, 1);
  // Loaded: E e + Ep min(e, ey) = s; the slider sits at e - ey. Unloaded: E e + Ep (e - seat) = 0.
  double expected = 0;
  for (int k = 0; k < 1000; ++k) {
    const double s = kDensity * kGravity * kLength * (k + 0.5) / 1000;
    const double e = (s - 0.2 * c.young * 0.004) / c.young;
    if (e > 0.004) expected += 0.2 / 1.2 * (e - 0.004) * kLength / 1000;
  }
  EXPECT_NEAR((-0.045 - edge(c, *tissue).z()) / expected, 1, 0.04);
}

TEST_P(EffectLaw, AnchorSpringsCarryTheWeight) {
  EffectCase c = strip(50e3);
  const double rigid = extension(c);
  c.effects.mutable_anchor()->set_compliance_m2_per_n(1e-3);
  const double sag = 1e-3 * kDensity * kGravity * 0.003 * kLength;  // [m]
  EXPECT_NEAR((extension(c, 3) - rigid) / sag, 1, 0.01);
  c.effects.mutable_anchor()->set_compliance_m2_per_n(1e-8);
  EXPECT_NEAR(extension(c), rigid, 1e-7);

  // Springs hold up to half the breaking stretch, then let go.
  c.effects.mutable_anchor()->set_compliance_m2_per_n(1e-3);
  c.effects.mutable_anchor()->set_break_m(4 * sag);
  EXPECT_LT(extension(c, 1), rigid + 2.2 * sag);
  c.effects.mutable_anchor()->set_break_m(0.5 * sag);
  EXPECT_GT(extension(c, 0.5), 0.05);
}

TEST_P(EffectLaw, ABedTurnsByItsWidthAndThickness) {
  // A short strip, level, in little gravity: about the middle of the clamped strip, of width w, the
  // bed has the stiffness K (w^2 + t^2) / 12, whatever the pitch. The rigid clamp's drop is
  // subtracted. The shell's iteration turns a sheet slowly, so it takes its time.
  constexpr double kStrip = 0.03;
  constexpr double kWidth = 0.003;
  constexpr double kBed = 100;  // K [N/m^2]
  for (const unsigned finer : {1U, 2U}) {
    for (const double thickness : {0.003, 0.006}) {
      EffectCase c = cantilever();
      c.pitch = kWidth / finer;
      c.nx = 3 * finer + 1;
      c.ny = 10 * finer + 1;
      c.ey = 10;
      c.thickness = thickness;
      c.anchor_max_y = -0.012;
      c.gravity = 0.001;
      c.young = 1e5;
      c.damping = 5;
      const auto dropped = [&] {
        const auto tissue = make(c);
        rest(*tissue, 40);
        return -edge(c, *tissue).z();
      };
      const double rigid = dropped();
      c.effects.mutable_anchor()->set_compliance_m2_per_n(1 / kBed);
      const double weight = kDensity * thickness * c.gravity * kStrip;  // [N/m]
      const double turn = weight * 0.5 * (kStrip - kWidth) /
                          (kBed * (kWidth * kWidth + thickness * thickness) / 12);
      const double expected = weight / kBed + turn * (kStrip - 0.5 * kWidth);
      EXPECT_NEAR((dropped() - rigid) / expected, 1, 0.01) << finer << " " << thickness;
    }
  }
}

TEST_P(EffectLaw, DetachedPieceHangsAndTheRestHolds) {
  EffectCase c = strip(50e3);
  const double whole = extension(c);
  c.effects.mutable_anchor()->set_free_from_m(-0.9);
  c.effects.mutable_anchor()->set_free_to_m(-0.5);  // beside the sheet
  EXPECT_NEAR(extension(c), whole, 1e-9);
  c.effects.mutable_anchor()->set_free_from_m(0);
  c.effects.mutable_anchor()->set_free_to_m(0.5);
  const auto tissue = make(c);
  rest(*tissue, 2);
  EXPECT_LT(tissue->position(0, 3 * 31).z(), 0.0448);  // outer corner of the free piece
  EXPECT_NEAR(tissue->position(0, 0).z(), 0.045, 1e-6);
  c.effects.mutable_anchor()->set_free_from_m(-0.5);
  try {
    make(c);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("scene.tissue.effects.anchor"));
  }
}

// ---- grasp --------------------------------------------------------------------------------------

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

// ---- surroundings -------------------------------------------------------------------------------

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
