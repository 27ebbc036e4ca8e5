// Effects of the elastic solid's material against their known answers (docs/mismatch.md 1).
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include "core/rng.h"
#include "sim_worker/tissue/effect_laws.h"
#include "support/effect_scene.h"
#include "support/elastic_energy.h"
#include "support/solid_scene.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using test::clamped_bar;
using test::free_bar;
using test::make_solid;
using test::rest;
using test::SolidCase;
using test::tip_of;
using test::weight_of;

using Solid = SolidTissue<double>;

void deform(Solid& tissue, const Matrix3d& F) {
  for (int i = 0; i < tissue.particles(); ++i)
    tissue.set_position(0, i, F * tissue.model().mesh.nodes[static_cast<std::size_t>(i)]);
}

/// First Piola-Kirchhoff stress of a bar in a homogeneous deformation, from the forces on its
/// nodes: their moment about the nodes at rest is the mean stress times the volume.
Matrix3d stress_of(Solid& tissue) {
  const auto gradient = tissue.elastic_gradient(0);
  Matrix3d sum = Matrix3d::Zero();
  for (std::size_t i = 0; i < gradient.size(); ++i)
    sum += gradient[i] * tissue.model().mesh.nodes[i].transpose();
  return sum / 12e-6;
}

// ---- density, stiffness, Poisson ----------------------------------------------------------------

TEST(SolidEffect, DensityScalesTheWeight) {
  SolidCase c = clamped_bar();
  c.gravity = Vector3d(0, 9.81, 0);
  c.effects.set_density_change(0.4);
  Solid tissue(make_solid(c), f64x1());
  rest(tissue, 2);
  EXPECT_NEAR(tissue.anchor_force(0).y() / (1.4 * weight_of(tissue)), 1, 1e-4);
}

TEST(SolidEffect, PoissonChangeContractsAcrossAndKeepsYoungsModulus) {
  for (const double change : {-0.3, 0.1, 0.19}) {
    SolidCase c = free_bar();
    c.effects.set_poisson_change(change);
    Solid tissue(make_solid(c), f64x1());
    const double e = 1e-6;
    const double across = 1 - (c.poisson + change) * e;
    deform(tissue, Vector3d(across, 1 + e, across).asDiagonal());
    Matrix3d expected = Matrix3d::Zero();  // nothing pulls at the sides
    expected(1, 1) = c.young * e;
    EXPECT_LT((stress_of(tissue) - expected).norm(), 1e-4 * expected.norm()) << change;
  }
}

TEST(SolidEffect, InclusionOverEverythingIsAnotherModulus) {
  SolidCase c = free_bar();
  c.poisson = 0.45;
  const Matrix3d F = (Matrix3d() << 1.02, 0.1, 0, -0.05, 1.1, 0.02, 0, 0.1, 0.97).finished();
  Solid plain(make_solid(c), f64x1());
  test::inclusion_of(c.effects)->set_radius_m(0.5);
  test::inclusion_of(c.effects)->set_stiffness_change(1);
  Solid stiff(make_solid(c), f64x1());
  deform(plain, F);
  deform(stiff, F);
  EXPECT_LT((stress_of(stiff) - 2 * stress_of(plain)).norm(), 1e-12 * stress_of(plain).norm());
}

TEST(SolidEffect, SoftSpotThroughTheSectionStretchesAsSlicesInSeries) {
  SolidCase c = clamped_bar();
  c.poisson = 0;
  c.gravity = Vector3d(0, 9.81, 0);
  c.young = 1e6;
  c.edge_length = 0.008;
  const auto end = [&] {
    Solid tissue(make_solid(c), f64x1());
    rest(tissue, 1);
    return tip_of(tissue).y();
  };
  const double plain = end();
  test::inclusion_of(c.effects)->set_y_m(-0.02);
  test::inclusion_of(c.effects)->set_radius_m(0.025);
  test::inclusion_of(c.effects)->set_stiffness_change(-0.5);
  double expected = 0;
  for (int k = 0; k < 1200; ++k) {
    const double y = -0.06 + (k + 0.5) * 1e-4;
    const double t = std::clamp((1.25 - std::fabs(y + 0.02) / 0.025) / 0.5, 0.0, 1.0);
    const double w = t * t * (3 - 2 * t);
    const double carried = c.density * 9.81 * (0.06 - y);
    expected += carried / c.young * (1 / (1 - 0.5 * w) - 1) * 1e-4;
  }
  EXPECT_NEAR((end() - plain) / expected, 1, 0.02);
}

// ---- material -----------------------------------------------------------------------------------

/// Bar that is held in homogeneous deformations F; its stress P, with what the effects remember.
class HeldBar {
 public:
  explicit HeldBar(const pb::TissueEffects& effects) : tissue_(make(effects), f64x1()) {}

  /// Deforms it at once and waits.
  Matrix3d stress(const Matrix3d& F, double seconds) {
    hold(F);
    rest(tissue_, seconds, Vector3d::Zero());
    return stress_of(tissue_);
  }
  /// At once, before anything is remembered.
  Matrix3d stress(const Matrix3d& F) {
    hold(F);
    return stress_of(tissue_);
  }
  double energy_density(const Matrix3d& F) const {
    std::vector<Vector3d> p = tissue_.model().mesh.nodes;
    for (Vector3d& x : p) x = F * x;
    return solid_energy(tissue_.model(), p) / 12e-6;
  }
  Solid& tissue() { return tissue_; }
  static constexpr double kYoung = 20e3;
  static constexpr double kPoisson = 0.45;

 private:
  static std::shared_ptr<const SolidTissueModel> make(const pb::TissueEffects& effects) {
    SolidCase c = free_bar();
    static const SolidMesh mesh = fill_mesh(make_box_mesh(0.5 * c.size), "box", c.edge_length);
    c.mesh = mesh;
    c.young = kYoung;
    c.poisson = kPoisson;
    c.effects = effects;
    return make_solid(c);
  }
  void hold(const Matrix3d& F) {
    tissue_.release(0);
    deform(tissue_, F);
    tissue_.hold(0, Vector3d::Zero(), 1, false);
  }
  Solid tissue_;
};

Matrix3d stretched() {
  return (Matrix3d() << 0.97, 0.1, 0, -0.05, 1.12, 0.02, 0, 0.1, 0.98).finished();
}

Matrix3d strain_of(const Matrix3d& F) { return 0.5 * (F.transpose() * F - Matrix3d::Identity()); }

void expect_near(const Matrix3d& stress, const Matrix3d& expected, double tolerance = 1e-9) {
  EXPECT_LT((stress - expected).norm(), tolerance * expected.norm())
      << stress << " instead of " << expected;
}

TEST(SolidMaterialEffect, StrainStiffeningAddsItsStress) {
  for (const double c2 : {5.0, -0.4}) {
    pb::TissueEffects effects;
    effects.set_strain_stiffening(c2);
    const Matrix3d E = strain_of(stretched());
    const double mu = HeldBar::kYoung / (2 * (1 + HeldBar::kPoisson));
    const Matrix3d S = 16 * c2 * mu * E.squaredNorm() * E;
    expect_near(HeldBar(effects).stress(stretched()),
                HeldBar({}).stress(stretched()) + stretched() * S);
  }
}

TEST(SolidMaterialEffect, FibresPullAlongThemselvesOnly) {
  pb::TissueEffects effects;
  effects.mutable_anisotropy()->set_fibre_ratio(1.5);
  effects.mutable_anisotropy()->set_angle_deg(60);
  const Vector3d a(0.5, std::sqrt(0.75), 0);
  for (const Matrix3d& F : {stretched(), Matrix3d(stretched().inverse())}) {
    const double along = a.dot(strain_of(F) * a);
    const double taut = 0.5 * (along + std::sqrt(along * along + 1e-6) - 1e-3);
    const Matrix3d S = 1.5 * HeldBar::kYoung * taut * a * a.transpose();
    expect_near(HeldBar(effects).stress(F), HeldBar({}).stress(F) + F * S);
  }
}

TEST(SolidMaterialEffect, ABranchRelaxesInAHeldBar) {
  pb::TissueEffects effects;
  effects.add_viscoelastic()->set_share(0.5);
  effects.mutable_viscoelastic(0)->set_time_s(0.3);
  effects.add_viscoelastic()->set_share(0.2);
  effects.mutable_viscoelastic(1)->set_time_s(0.02);
  HeldBar bar(effects);
  const Matrix3d slow = HeldBar({}).stress(stretched());
  constexpr double h = 0.004;  // substep, within which it was stretched
  const auto expected = [&](double t) {
    double sum = 1;
    for (const auto& branch : effects.viscoelastic()) {
      const double x = h / branch.time_s();
      sum += branch.share() * (1 - std::exp(-x)) / x * std::exp(-(t - h) / branch.time_s());
    }
    return Matrix3d(sum * slow);
  };
  // What the solver uses is the stress one substep on.
  expect_near(bar.stress(stretched()), expected(h));
  expect_near(bar.stress(stretched(), 0.02), expected(0.02 + h));
  expect_near(bar.stress(stretched(), 0.4), expected(0.42 + h));
}

TEST(SolidMaterialEffect, StructuralDampingIsItsThreeBranches) {
  pb::TissueEffects damped;
  damped.set_structural_damping(0.2);
  pb::TissueEffects branches;
  const std::array<double, 3> shares = loss_branches(0.2);
  const std::array<double, 3> times = {0.5, 0.05, 0.005};
  for (std::size_t k = 0; k < 3; ++k) {
    auto* branch = branches.add_viscoelastic();
    branch->set_share(shares[k]);
    branch->set_time_s(times[k]);
  }
  HeldBar a(damped);
  HeldBar b(branches);
  expect_near(a.stress(stretched(), 0.06), b.stress(stretched(), 0.06), 1e-12);
  EXPECT_GT(a.stress(stretched()).norm(), 1.05 * HeldBar({}).stress(stretched()).norm());
}

TEST(SolidMaterialEffect, PlasticSetStaysAfterUnloading) {
  pb::TissueEffects effects;
  effects.mutable_plastic_set()->set_modulus_ratio(0.2);
  effects.mutable_plastic_set()->set_yield_strain(0.08);
  HeldBar bar(effects);
  const Matrix3d little = Vector3d(1, 1.05, 1).asDiagonal();
  const Matrix3d far = Vector3d(1, 1.12, 1).asDiagonal();
  const double modulus = 0.2 * HeldBar::kYoung;
  const auto beside = [&](const Matrix3d& F, double strain) {
    Matrix3d S = Matrix3d::Zero();
    S(1, 1) = modulus * strain;
    return Matrix3d(HeldBar({}).stress(F) + F * S);
  };
  expect_near(bar.stress(little, 0.02), beside(little, strain_of(little)(1, 1)));
  expect_near(bar.stress(far, 0.02), beside(far, 0.08));
  const double seat = strain_of(far)(1, 1) - 0.08;
  Matrix3d left = Matrix3d::Zero();
  left(1, 1) = -modulus * seat;
  expect_near(bar.stress(Matrix3d::Identity(), 0.02), left);
}

TEST(SolidMaterialEffect, SoftenedMaterialIsSofterUntilItIsStretchedFurther) {
  pb::TissueEffects effects;
  effects.mutable_mullins()->set_softening(0.6);
  effects.mutable_mullins()->set_strain(0.03);
  HeldBar bar(effects);
  const auto part = [](double share) {
    return Matrix3d(Matrix3d::Identity() + share * (stretched() - Matrix3d::Identity()));
  };
  const auto law = [](const Matrix3d& F) { return HeldBar({}).stress(F); };
  expect_near(bar.stress(part(0.5), 0.02), law(part(0.5)));  // first loading
  expect_near(bar.stress(part(0.9), 0.02), law(part(0.9)));
  const double peak = bar.energy_density(part(0.9));
  const double m = 0.5 * HeldBar::kYoung * 0.03 * 0.03;
  for (const double share : {0.8, 0.3}) {
    const Matrix3d F = part(share);
    const double v = (peak - bar.energy_density(F)) / (m + peak);
    const double s = v / std::sqrt(1 + v * v);
    expect_near(bar.stress(F, 0.02), (1 - 0.6 * s * (3 - s * s) / 2) * law(F), 1e-7);
  }
  expect_near(bar.stress(stretched(), 0.02), law(stretched()));
}

/// Small reproducible displacements.
std::vector<Vector3d> jitter(int count, double size, std::uint32_t seed) {
  std::vector<Vector3d> all;
  for (int i = 0; i < count; ++i) {
    const PhiloxWords words = philox({static_cast<std::uint32_t>(i), seed, 0, 0}, {1, 2});
    all.emplace_back();
    for (int k = 0; k < 3; ++k) {
      all.back()[k] =
          size * (2 * static_cast<double>(uniform_24(words[static_cast<std::size_t>(k)])) - 1);
    }
  }
  return all;
}

TEST(SolidMaterialEffect, TheHessianIsTheDerivativeOfTheGradient) {
  pb::TissueEffects none;
  pb::TissueEffects all;
  all.set_strain_stiffening(3);
  all.mutable_anisotropy()->set_fibre_ratio(1);
  all.mutable_anisotropy()->set_angle_deg(40);
  all.add_viscoelastic()->set_share(0.5);
  all.mutable_plastic_set()->set_modulus_ratio(0.4);
  all.mutable_plastic_set()->set_yield_strain(0.05);
  test::inclusion_of(all)->set_stiffness_change(2);
  test::inclusion_of(all)->set_radius_m(0.03);
  all.mutable_mullins()->set_softening(0.5);
  all.mutable_mullins()->set_strain(0.05);
  for (const pb::TissueEffects& effects : {none, all}) {
    HeldBar bar(effects);
    Solid& tissue = bar.tissue();
    bar.stress(1.05 * stretched(), 0.02);  // leaves memory
    tissue.release(0);
    const auto noise = jitter(tissue.particles(), 1e-4, 1);
    const auto direction = jitter(tissue.particles(), 1, 2);
    const auto gradient = [&](double step) {
      for (int i = 0; i < tissue.particles(); ++i) {
        const auto k = static_cast<std::size_t>(i);
        tissue.set_position(
            0, i, stretched() * tissue.model().mesh.nodes[k] + noise[k] + step * direction[k]);
      }
      return tissue.elastic_gradient(0);
    };
    constexpr double kStep = 1e-8;
    const auto up = gradient(kStep);
    const auto down = gradient(-kStep);
    gradient(0);
    const auto change = tissue.elastic_change(0, direction);
    double largest = 0;
    double worst = 0;
    for (std::size_t i = 0; i < change.size(); ++i) {
      largest = std::max(largest, change[i].norm());
      worst = std::max(worst, (change[i] - (up[i] - down[i]) / (2 * kStep)).norm());
    }
    EXPECT_LT(worst, 1e-6 * largest);
  }
}

TEST(SolidMaterialEffect, APulledBarRelaxesAsItsBranch) {
  SolidCase c = clamped_bar();
  c.effects.add_viscoelastic()->set_share(0.5);
  c.effects.mutable_viscoelastic(0)->set_time_s(0.3);
  Solid tissue(make_solid(c), f64x1());
  const Vector3d from(0, 0.06, 0);
  const ToolMotion motion{from, from + Vector3d(0, 0.002, 0)};
  tissue.hold(0, from, 0.009, false);
  tissue.step({&motion, 1});
  std::vector<double> force;
  for (const double seconds : {0.28, 0.3, 5.0}) {
    rest(tissue, seconds, motion.to);
    force.push_back(tissue.held_force(0).norm());
  }
  const double x = 0.02 / 0.3;  // pulled within this part of its time
  for (std::size_t k = 0; k < 2; ++k) {
    const double t = k == 0 ? 0.30 : 0.60;
    const double expected = 1 + 0.5 * (1 - std::exp(-x)) / x * std::exp(-(t - 0.02) / 0.3);
    EXPECT_NEAR(force[k] / force[2], expected, 0.003) << t;
  }
}

}  // namespace
}  // namespace omentum
