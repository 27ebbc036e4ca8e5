// Effects of tissue, clamp and grasp against their known answers (mismatch.md 5.1), the same law in
// both models.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <complex>

#include "sim_worker/hexahedron.h"
#include "support/effect_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::EffectCase;
using test::make_effect_tissue;
using test::Model;
using test::rest;

constexpr double kPi = 3.14159265358979323846;
constexpr double kLength = 0.09;
constexpr double kGravity = 9.81;
constexpr double kDensity = 1000;

Eigen::Isometry3d upright() {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.linear() = Eigen::AngleAxisd(-kPi / 2, Vector3d::UnitX()).toRotationMatrix();
  return X;
}

class EffectLaw : public testing::TestWithParam<Model> {
 protected:
  /// Strip of 9 x 90 mm, hanging from its clamped edge; nu = 0.
  static EffectCase strip(double young) {
    EffectCase c;
    c.nx = 4;
    c.ny = 31;
    c.anchor_max_y = -0.045;
    c.young = young;
    c.damping = 20;
    c.X_WB = upright();
    c.ex = 1;
    c.ey = 30;
    return c;
  }
  std::unique_ptr<Tissue<double>> make(const EffectCase& c) const {
    return make_effect_tissue(c, GetParam());
  }
  /// Mean of the positions of the free edge.
  static Vector3d edge(const EffectCase& c, const Tissue<double>& tissue) {
    Vector3d sum = Vector3d::Zero();
    for (unsigned ix = 0; ix < c.nx; ++ix)
      sum += tissue.position(0, static_cast<int>(c.ny * ix + c.ny - 1)) / c.nx;
    return sum;
  }
  /// Extension of a strip that hangs along -z.
  double extension(const EffectCase& c, double seconds = 2) const {
    const auto tissue = make(c);
    rest(*tissue, seconds);
    return -0.045 - edge(c, *tissue).z();
  }
  /// Extension of a strip whose stress at stretch l is P(l), by 1000 slices.
  template <typename Stress>
  static double hanging(Stress&& stress, double gravity = kGravity) {
    constexpr int kSlices = 1000;
    double sum = 0;
    for (int k = 0; k < kSlices; ++k) {
      const double carried = kDensity * gravity * kLength * (k + 0.5) / kSlices;
      sum += (stretch_under(carried, stress) - 1) * kLength / kSlices;
    }
    return sum;
  }
  /// Stretch at which the stress is P.
  template <typename Stress>
  static double stretch_under(double P, Stress&& stress) {
    double low = 0.5;
    double high = 1.5;
    for (int i = 0; i < 60; ++i) {
      const double middle = 0.5 * (low + high);
      (stress(middle) < P ? low : high) = middle;
    }
    return low;
  }
};

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
  EffectCase c = strip(1e6);
  c.X_WB = Eigen::Isometry3d::Identity();
  c.gravity = 0.1;
  c.anchor_max_y = -0.042;
  c.damping = 10;
  const auto drop = [&] {
    const auto tissue = make(c);
    rest(*tissue, 3);
    return -edge(c, *tissue).z();
  };
  const double plain = drop();
  c.effects.set_bending_change(2);
  EXPECT_NEAR(plain / drop(), 3, 0.03);
  c.X_WB = upright();
  c.gravity = kGravity;
  c.young = 50e3;
  const double bent = extension(c);
  c.effects.clear_bending_change();
  EXPECT_NEAR(bent / extension(c), 1, 0.02);
}

TEST_P(EffectLaw, InclusionOverEverythingIsAnotherModulus) {
  EffectCase c = strip(30e3);
  c.effects.mutable_inclusion()->set_radius_m(0.5);
  c.effects.mutable_inclusion()->set_stiffness_change(1);
  const double expected = kDensity * kGravity * kLength * kLength / (2 * 2 * c.young);
  EXPECT_NEAR(extension(c) / expected, 1, 0.004);
}

TEST_P(EffectLaw, SoftSpotStretchesWhereItIs) {
  EffectCase c = strip(50e3);
  const double plain = extension(c);
  c.effects.mutable_inclusion()->set_y_m(0.02);
  c.effects.mutable_inclusion()->set_radius_m(0.012);
  c.effects.mutable_inclusion()->set_stiffness_change(-0.5);
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

/// Softening of the tests: shares and energies as in proto/tissue_effects.proto, m / E = strain^2
/// / 2.
struct Softening {
  double share, strain;

  double left(double W, double W_max, double E) const {
    const double v = std::max(0.0, W_max - W) / (0.5 * E * strain * strain + W_max);
    const double s = v / std::sqrt(1 + v * v);
    return 1 - share * s * (3 - s * s) / 2;
  }
  /// Energy per volume that a cycle up to W_max costs: the integral of 1 - left.
  double loss(double W_max, double E) const {
    const double m = 0.5 * E * strain * strain + W_max;
    const double q = std::sqrt(1 + W_max / m * W_max / m);
    return share * m * (q - 0.5 / q - 0.5);
  }
};

TEST(Softening, IsTheErrorFunctionToWithinAThirtieth) {
  const Softening whole{1, 0};
  for (int k = 0; k <= 100; ++k) {
    const double v = 0.01 * k;
    EXPECT_NEAR(1 - whole.left(1 - v, 1, 1), std::erf(1.2 * v), 0.033) << v;
  }
}

TEST_P(EffectLaw, MullinsSoftensBelowTheLargestStretchOnly) {
  EffectCase c = strip(20e3);
  const double virgin = extension(c, 3);
  const Softening law{0.5, 0.01};
  c.effects.mutable_mullins()->set_softening(law.share);
  c.effects.mutable_mullins()->set_strain(law.strain);
  const auto tissue = make(c);
  double share = 0;
  const auto load_to = [&](double to) {  // slowly: a swing beyond the load would count
    for (int k = 1; k <= 40; ++k) {
      const double u = k / 40.0;
      LaneParameters parameters;
      parameters.gravity_scale = share + (to - share) * u * u * (3 - 2 * u);
      tissue->set_parameters(0, parameters);
      rest(*tissue, 0.04);
    }
    share = to;
    rest(*tissue, 0.6);
    return -0.045 - edge(c, *tissue).z();
  };
  // Where the strip once carried s it was stretched by s / E, and now carries `share` of it.
  const auto expected = [&](double part) {
    double sum = 0;
    for (int k = 0; k < 300; ++k) {
      const double s = kDensity * kGravity * kLength * (k + 0.5) / 300;
      const double W_max = 0.5 * s * s / c.young;
      const auto stress = [&](double l) {
        const double W = 0.5 * c.young * (l - 1) * (l - 1);
        return law.left(W, W_max, c.young) * c.young * (l - 1);
      };
      sum += (stretch_under(part * s, stress) - 1) * kLength / 300;
    }
    return sum;
  };
  EXPECT_NEAR(load_to(1) / virgin, 1, 0.002);
  for (const double part : {0.4, 0.1, 0.4, 0.8}) {
    EXPECT_NEAR(load_to(part) / expected(part), 1, 0.006) << part;
    EXPECT_GT(expected(part), 1.1 * part * virgin);
  }
  EXPECT_NEAR(load_to(1) / virgin, 1, 0.002);
  EXPECT_NEAR(load_to(1.3) / (1.3 * virgin), 1, 0.002);  // the virgin curve goes on
}

/// Positions X + e A X, A symmetric: U = I + e A.
Eigen::Matrix3d stretch_of(double e) {
  Eigen::Matrix3d U;
  U << 0.3, 0.2, 0, 0.2, 1, 0, 0, 0, 0;
  return Eigen::Matrix3d::Identity() + e * U;
}

TEST(Mullins, ShellFollowsTheClosedFormAndLosesTheAreaOfTheLoop) {
  EffectCase c;
  c.nx = c.ny = 5;
  c.anchor_max_y = -1;
  c.gravity = 0;
  c.damping = 0;
  c.poisson = 0.4;
  c.young = 1e-6;  // so heavy beside it that it stays where it is put
  std::vector<std::string> warnings;
  const auto make = [&] {
    return ElasticTissue<double>(
        make_elastic_model(make_effect_scene(c, Model::kElastic), 0.02, warnings), kKernelF64x1);
  };
  ElasticTissue<double> plain = make();
  const Softening law{0.7, 0.05};
  c.effects.mutable_mullins()->set_softening(law.share);
  c.effects.mutable_mullins()->set_strain(law.strain);
  ElasticTissue<double> soft = make();

  const Eigen::Matrix3d A = stretch_of(1) - Eigen::Matrix3d::Identity();
  const double modulus =
      c.young / (1 + c.poisson) *
      (A.squaredNorm() + c.poisson / (1 - c.poisson) * A.trace() * A.trace());  // d2W / de2
  const double volume = std::pow(4 * c.pitch, 2) * c.thickness;
  const ToolMotion away{Vector3d(0, 0, 1), Vector3d(0, 0, 1)};
  // dW / de of the sheet as it is now, remembered.
  const auto slope = [&](ElasticTissue<double>& tissue, double e) {
    const auto& rest = tissue.model().body.particles;
    const auto put = [&] {
      for (int i = 0; i < tissue.particles(); ++i) {
        tissue.set_position(0, i, stretch_of(e) * rest[static_cast<std::size_t>(i)]);
        tissue.set_velocity(0, i, Vector3d::Zero());
      }
    };
    put();
    tissue.step({&away, 1});
    put();
    const auto gradient = tissue.elastic_gradient(0);
    double sum = 0;
    for (std::size_t i = 0; i < gradient.size(); ++i) sum += gradient[i].dot(A * rest[i]);
    return sum / volume;
  };
  constexpr double kFar = 0.2;
  constexpr int kSteps = 200;
  const auto W = [&](double e) { return 0.5 * modulus * e * e; };
  double work = 0;
  double before = 0;
  for (int k = 1; k <= kSteps; ++k) {
    const double e = kFar * k / kSteps;
    const double now = slope(soft, e);
    EXPECT_NEAR(now / slope(plain, e), 1, 1e-12);
    EXPECT_NEAR(now / (modulus * e), 1, 1e-7);
    work += 0.5 * (before + now) * kFar / kSteps;
    before = now;
  }
  for (int k = kSteps - 1; k >= 0; --k) {
    const double e = kFar * k / kSteps;
    const double now = slope(soft, e);
    const double expected = law.left(W(e), W(kFar), c.young) * modulus * e;
    EXPECT_NEAR(now, expected, 1e-7 * modulus * kFar) << e;
    work -= 0.5 * (before + now) * kFar / kSteps;
    before = now;
  }
  EXPECT_NEAR(work / law.loss(W(kFar), c.young), 1, 1e-4);
  EXPECT_GT(work, 0.2 * W(kFar));
  for (const double e : {0.1, 0.15}) {  // reloading takes the way it came
    EXPECT_NEAR(slope(soft, e), law.left(W(e), W(kFar), c.young) * modulus * e,
                1e-7 * modulus * kFar);
  }
  EXPECT_NEAR(slope(soft, 0.3) / (modulus * 0.3), 1, 1e-7);
}

TEST(Mullins, BrickFollowsTheSameLawWithEnergyForceAndTangentOfOnePotential) {
  constexpr double kSize = 0.003;
  const Softening law{0.7, 0.05};
  const double E = 2e4;
  const double nu = 0.3;
  const Lame lame = make_lame(E, nu);
  auto memory = std::make_unique<HexMemory>();
  HexEffects effects;
  effects.softening = law.share;
  effects.softening_energy = (1 + nu) * law.strain * law.strain;
  effects.memory = memory.get();
  const auto shape_at = [&](const Eigen::Matrix3d& F) {
    HexShape shape;
    for (int a = 0; a < kHexNodes; ++a) {
      const Vector3d X(kSize * (a & 1), kSize * (a >> 1 & 1), kSize * (a >> 2 & 1));
      for (int i = 0; i < 3; ++i) shape.x[3 * a + i] = Pack((F * X)[i]);
    }
    shape.size.fill(Pack(kSize));
    shape.bubble.fill(Pack(0.0));
    shape.mu = Pack(lame.mu);
    shape.lambda = Pack(lame.lambda);
    shape.effects = &effects;
    return shape;
  };
  const auto force_at = [](const HexShape& shape) {
    HexForce force;
    hex_force(pb::LAW_COROTATED, shape, force);
    return force;
  };
  const Eigen::Matrix3d A = stretch_of(1) - Eigen::Matrix3d::Identity();
  const double modulus = 2 * lame.mu * A.squaredNorm() + lame.lambda * A.trace() * A.trace();
  const auto slope = [&](double e) {
    const HexForce force = force_at(shape_at(stretch_of(e)));
    double sum = 0;
    for (int a = 0; a < kHexNodes; ++a) {
      const Vector3d X(kSize * (a & 1), kSize * (a >> 1 & 1), kSize * (a >> 2 & 1));
      for (int i = 0; i < 3; ++i) sum += force.force[3 * a + i].lane(0) * (A * X)[i];
    }
    return sum / std::pow(kSize, 3);
  };
  const auto W = [&](double e) { return 0.5 * modulus * e * e; };
  EXPECT_NEAR(slope(0.2) / (modulus * 0.2), 1, 1e-12);
  hex_remember(pb::LAW_COROTATED, shape_at(stretch_of(0.2)), {}, *memory);
  hex_remember(pb::LAW_COROTATED, shape_at(stretch_of(0.1)), {}, *memory);
  for (const double e : {0.02, 0.1, 0.15, 0.19}) {
    EXPECT_NEAR(slope(e) / (law.left(W(e), W(0.2), E) * modulus * e), 1, 1e-9) << e;
  }
  EXPECT_NEAR(slope(0.25) / (modulus * 0.25), 1, 1e-12);
  const auto energy = [&](double e) {
    return force_at(shape_at(stretch_of(e))).energy.lane(0) / std::pow(kSize, 3);
  };
  EXPECT_NEAR(W(0.2) - energy(0.2) + energy(0), law.loss(W(0.2), E), 1e-9 * W(0.2));

  // Any shape below the largest energy: derivatives by central differences.
  HexShape shape = shape_at(stretch_of(0.12));
  for (int k = 0; k < 24; ++k) shape.x[k] = shape.x[k] + Pack(2e-5 * std::sin(5.0 * k));
  HexTangent tangent;
  hex_tangent(pb::LAW_COROTATED, shape, tangent);
  const HexForce at = force_at(shape);
  constexpr double kStep = 1e-8;
  for (int k = 0; k < 24; ++k) {
    HexShape low = shape;
    HexShape high = shape;
    low.x[k] = low.x[k] - Pack(kStep);
    high.x[k] = high.x[k] + Pack(kStep);
    const HexForce below = force_at(low);
    const HexForce above = force_at(high);
    EXPECT_NEAR((above.energy.lane(0) - below.energy.lane(0)) / (2 * kStep), at.force[k].lane(0),
                1e-7 * E * kSize * kSize);
    // Parabolas eliminated: K_xx - coupling^T coupling, so compare with them at rest, K_xx.
    for (int row = 0; row < 24; ++row) {
      double condensed = 0;
      for (int r = 0; r < 9; ++r) {
        condensed += tangent.inner.coupling[24 * r + row].lane(0) *
                     tangent.inner.coupling[24 * r + k].lane(0);
      }
      const int a = std::max(row / 3, k / 3);
      const int b = std::min(row / 3, k / 3);
      const int i = row / 3 == a ? row % 3 : k % 3;
      const int j = row / 3 == a ? k % 3 : row % 3;
      const double block =
          tangent.stiffness[9 * (a * (a + 1) / 2 + b) + 3 * i + j].lane(0) + condensed;
      EXPECT_NEAR((above.force[row].lane(0) - below.force[row].lane(0)) / (2 * kStep), block,
                  1e-5 * E * kSize);
    }
  }
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
           180 / kPi;
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
    parameters.effects->tilt_x = kPi;
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
      const double a = kGravity * (std::sin(20 * kPi / 180) - 0.3 * std::cos(20 * kPi / 180));
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

// ---- structural damping
// ---------------------------------------------------------------------------

/// E(s) / E of a linear material with these branches, s = i w for a lasting vibration.
std::complex<double> modulus_of(const std::array<double, 3>& share, std::complex<double> s) {
  constexpr std::array<double, 3> kTimes = {0.5, 0.05, 0.005};
  std::complex<double> sum = 1;
  for (std::size_t k = 0; k < share.size(); ++k)
    sum += share[k] * s * kTimes[k] / (1.0 + s * kTimes[k]);
  return sum;
}

double loss_factor_at(double eta, double frequency) {
  const std::complex<double> E = modulus_of(loss_shares(eta), {0, 2 * kPi * frequency});
  return E.imag() / E.real();
}

TEST(StructuralDamping, LossFactorIsFlatOverTwoDecadesUpToTheRippleOfThreeBranches) {
  // Of endless branches a decade apart it is 2 / cosh(pi^2 / ln 10) about the mean: 5.5 %.
  const double ripple = 2 / std::cosh(kPi * kPi / std::log(10));
  EXPECT_NEAR(ripple, 0.055, 1e-4);
  const auto range = [](double eta) {
    double least = 1e9;
    double most = 0;
    for (int k = 0; k <= 100; ++k) {
      const double share = loss_factor_at(eta, 0.3 * std::pow(10, 0.02 * k)) / eta;
      least = std::min(least, share);
      most = std::max(most, share);
    }
    return std::pair(least, most);
  };
  const auto [least, most] = range(0.01);
  EXPECT_GT(least, 1 - ripple);
  EXPECT_LT(most, 1 + 1.5 * ripple);  // ends of the row: the outer branches stand in for the rest
  for (const auto& [eta, low, high] : {std::tuple{0.2, 0.95, 1.12}, {0.4, 0.92, 1.22}}) {
    EXPECT_GT(range(eta).first, low) << eta;
    EXPECT_LT(range(eta).second, high) << eta;
  }
  for (const double frequency : {0.5, 0.05, 0.005}) {  // where it is made to fit
    EXPECT_NEAR(loss_factor_at(0.3, 1 / (2 * kPi * frequency)) / 0.3, 1.055, 1e-12);
  }
}

TEST(StructuralDamping, StepsOfTheBranchesHaveTheLossFactorOfTheirClosedForm) {
  EffectValues effects;
  effects.loss_factor = 0.1;
  const double h = 1e-4;
  const PronyStep prony = make_prony(effects, h);
  for (const double f : {0.4, 5.0, 25.0}) {
    std::array<double, kMaxBranches> H{};
    double in_phase = 0;
    double across = 0;
    double before = 0;
    const int cycle = static_cast<int>(1 / (f * h));
    for (int n = 1; n <= 12 * cycle; ++n) {
      const double phase = 2 * kPi * n / cycle;
      const double s = std::sin(phase);
      double sum = s;
      for (std::size_t k = 0; k < static_cast<std::size_t>(prony.branches); ++k) {
        H[k] = prony.keep[k] * H[k] + prony.gain[k] * (s - before);
        sum += H[k];
      }
      before = s;
      if (n <= 8 * cycle) continue;
      in_phase += sum * std::sin(phase);
      across += sum * std::cos(phase);
    }
    EXPECT_NEAR(across / in_phase / loss_factor_at(0.1, f), 1, 0.01) << f;
  }
}

/// Damping ratio of a free vibration of exponential envelope: share of the critical damping, from
/// the swings between successive extremes, which do not see what creeps slowly beside it.
double damping_ratio(const std::vector<double>& x) {
  std::vector<double> extremes;
  for (std::size_t k = 1; k + 1 < x.size(); ++k) {
    const double left = x[k] - x[k - 1];
    const double right = x[k + 1] - x[k];
    if (left * right > 0) continue;
    const double bend = right - left;
    extremes.push_back(x[k] - (left + right) * (left + right) / (8 * bend));  // of a parabola
  }
  if (extremes.size() < 9) return -1;
  const auto swing = [&](std::size_t k) { return std::fabs(extremes[k + 1] - extremes[k]); };
  const double half_cycle = std::log(swing(3) / swing(7)) / 4;
  return half_cycle / std::hypot(half_cycle, kPi);
}

TEST_P(EffectLaw, StructuralDampingRingsDownAlikeADecadeApart) {
  // The strip swings along its length, a quarter wave: w0 = pi / (2 L) sqrt(E / rho), then
  // s^2 + w0^2 E(s) / E = 0. Backward Euler alone would damp by w h / 2 (0.025 here), stiffness-
  // proportional damping ten times as much at the higher frequency.
  constexpr double kEta = 0.1;
  std::vector<double> found;
  std::vector<double> frequency;
  for (const double young : {100.0, 1e4}) {
    EffectCase c = strip(young);
    c.gravity = 0;
    c.damping = 0;
    c.ny = 16;
    c.nx = 2;
    c.pitch = 0.006;
    c.ex = 1;
    c.ey = 10;
    c.X_WB = Eigen::Isometry3d::Identity();
    c.integrator = pb::INTEGRATOR_BDF2;
    c.substeps = 2;
    c.iterations = 4;
    c.effects.set_structural_damping(kEta);
    const double w0 = kPi / (2 * kLength) * std::sqrt(young / kDensity);
    std::complex<double> s(0, w0);
    for (int k = 0; k < 50; ++k)
      s = std::complex<double>(0, w0) * std::sqrt(modulus_of(loss_shares(kEta), s));
    constexpr int kSamples = 64;
    const double period = 2 * kPi / s.imag();
    std::vector<std::string> warnings;
    const auto tissue =
        make_tissue_model(make_effect_scene(c, GetParam()), period / kSamples, warnings)
            ->make_tissue(kKernelF64x1);
    for (int i = 0; i < tissue->particles(); ++i) {
      const double along = (tissue->position(0, i).y() + 0.045) / kLength;
      tissue->set_velocity(0, i, Vector3d(0, 1e-3 * w0 * kLength * std::sin(kPi / 2 * along), 0));
    }
    std::vector<double> x;
    const ToolMotion away{Vector3d(0, 0, 1), Vector3d(0, 0, 1)};
    for (int k = 0; k < 5 * kSamples; ++k) {
      tissue->step({&away, 1});
      x.push_back(edge(c, *tissue).y());
    }
    found.push_back(damping_ratio(x));
    frequency.push_back(s.imag() / (2 * kPi));
    EXPECT_NEAR(found.back() / (-s.real() / std::abs(s)), 1, 0.02) << young;
    EXPECT_NEAR(found.back() / (kEta / 2), 1, 0.1) << young;  // ripple at this loss factor
  }
  EXPECT_GT(frequency[1] / frequency[0], 10);
  EXPECT_NEAR(found[1] / found[0], 1, 0.1);
}

}  // namespace
}  // namespace omentum
