// Effects of tissue and clamp against their known answers (docs/mismatch.md 1), the same law in
// both models. Those of Mullins softening and structural damping are in files of their own.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

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

}  // namespace
}  // namespace omentum
