// Effect structural_damping is the loss factor it says, over two decades of frequency, in both
// models.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <numbers>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "sim_worker/models.h"
#include "sim_worker/tissue/effect_laws.h"
#include "support/effect_law.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::EffectCase;
using test::EffectLaw;

/// E(s) / E of a linear material with these branches, s = i w for a lasting vibration.
std::complex<double> modulus_of(const std::array<double, 3>& share, std::complex<double> s) {
  constexpr std::array<double, 3> kTimes = {0.5, 0.05, 0.005};
  std::complex<double> sum = 1;
  for (std::size_t k = 0; k < share.size(); ++k)
    sum += share[k] * s * kTimes[k] / (1.0 + s * kTimes[k]);
  return sum;
}

double loss_factor_at(double eta, double frequency) {
  const std::complex<double> E =
      modulus_of(loss_branches(eta), {0, 2 * std::numbers::pi * frequency});
  return E.imag() / E.real();
}

TEST(StructuralDamping, LossFactorIsFlatOverTwoDecadesUpToTheRippleOfThreeBranches) {
  // Of endless branches a decade apart it is 2 / cosh(pi^2 / ln 10) about the mean: 5.5 %.
  const double ripple = 2 / std::cosh(std::numbers::pi * std::numbers::pi / std::log(10));
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
    EXPECT_NEAR(loss_factor_at(0.3, 1 / (2 * std::numbers::pi * frequency)) / 0.3, 1.055, 1e-12);
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
      const double phase = 2 * std::numbers::pi * n / cycle;
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
  return half_cycle / std::hypot(half_cycle, std::numbers::pi);
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
    const double w0 = std::numbers::pi / (2 * kLength) * std::sqrt(young / kDensity);
    std::complex<double> s(0, w0);
    for (int k = 0; k < 50; ++k)
      s = std::complex<double>(0, w0) * std::sqrt(modulus_of(loss_branches(kEta), s));
    constexpr int kSamples = 64;
    const double period = 2 * std::numbers::pi / s.imag();
    std::vector<std::string> warnings;
    const auto tissue =
        make_tissue_model(make_effect_scene(c, GetParam()), period / kSamples, warnings)
            ->make_tissue(f64x1());
    for (int i = 0; i < tissue->particles(); ++i) {
      const double along = (tissue->position(0, i).y() + 0.045) / kLength;
      tissue->set_velocity(
          0, i, Vector3d(0, 1e-3 * w0 * kLength * std::sin(std::numbers::pi / 2 * along), 0));
    }
    std::vector<double> x;
    const ToolMotion away{Vector3d(0, 0, 1), Vector3d(0, 0, 1)};
    for (int k = 0; k < 5 * kSamples; ++k) {
      tissue->step({&away, 1});
      x.push_back(edge(c, *tissue).y());
    }
    found.push_back(damping_ratio(x));
    frequency.push_back(s.imag() / (2 * std::numbers::pi));
    EXPECT_NEAR(found.back() / (-s.real() / std::abs(s)), 1, 0.02) << young;
    EXPECT_NEAR(found.back() / (kEta / 2), 1, 0.1) << young;  // ripple at this loss factor
  }
  EXPECT_GT(frequency[1] / frequency[0], 10);
  EXPECT_NEAR(found[1] / found[0], 1, 0.1);
}

}  // namespace
}  // namespace omentum
