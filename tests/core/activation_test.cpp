#include "core/activation.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace omentum {
namespace {

/// Largest error of `ours` against `reference` over an even sweep; `scale` turns a difference into
/// the error judged.
template <typename Ours, typename Reference, typename Scale>
double worst(double from, double to, Ours ours, Reference reference, Scale scale) {
  constexpr int kPoints = 2'000'000;
  double largest = 0;
  for (int i = 0; i <= kPoints; ++i) {
    const auto x = static_cast<float>(from + (to - from) * i / kPoints);
    const double expected = reference(static_cast<double>(x));
    largest =
        std::max(largest, std::abs(static_cast<double>(ours(x)) - expected) / scale(expected));
  }
  return largest;
}

double one(double) { return 1; }
double size(double value) { return std::abs(value); }

// Bounds are the documented ones of core/activation.h: half an ulp of the last operations plus the
// fit.
TEST(Activation, ErrorsAreAsDocumented) {
  const auto exp = [](float x) { return lanes::exp(x); };
  const auto log = [](float x) { return lanes::log(x); };
  EXPECT_LT(worst(
                -87, 88, exp, [](double x) { return std::exp(x); }, size),
            1.2e-7);
  EXPECT_LT(worst(
                -1, 1, exp, [](double x) { return std::exp(x); }, size),
            1.2e-7);
  const auto log_scale = [](double value) { return std::max(std::abs(value), 0.25); };
  EXPECT_LT(worst(
                1e-6, 20, log, [](double x) { return std::log(x); }, log_scale),
            1.2e-7);
  EXPECT_LT(worst(
                1e-30, 1e30, log, [](double x) { return std::log(x); }, log_scale),
            1.2e-7);
  EXPECT_LT(worst(
                -12, 12, [](float x) { return lanes::tanh(x); },
                [](double x) { return std::tanh(x); }, one),
            3e-7);
  const auto sigmoid = [](float x) { return _mm256_cvtss_f32(lanes::sigmoid(lanes::splat(x))); };
  EXPECT_LT(worst(
                -80, 80, sigmoid, [](double x) { return 1 / (1 + std::exp(-x)); }, size),
            3e-7);
}

TEST(Activation, TailsAreSane) {
  EXPECT_EQ(lanes::exp(0.0F), 1.0F);
  EXPECT_EQ(lanes::exp(-1e8F), 0.0F);
  EXPECT_EQ(lanes::exp(-std::numeric_limits<float>::infinity()), 0.0F);
  EXPECT_GT(lanes::exp(1e30F), 1e38F);
  EXPECT_TRUE(std::isnan(lanes::exp(std::numeric_limits<float>::quiet_NaN())));
  EXPECT_EQ(lanes::log(1.0F), 0.0F);
  EXPECT_EQ(lanes::tanh(0.0F), 0.0F);
  EXPECT_LE(lanes::tanh(1e30F), 1.0F);
  EXPECT_GT(lanes::tanh(1e30F), 0.9999996F);
  EXPECT_EQ(lanes::tanh(-3.0F), -lanes::tanh(3.0F));
}

TEST(NormalQuantile, InvertsTheDistribution) {
  for (int i = 0; i < 1'000'000; i += 7) {
    const float p = (static_cast<float>(i) + 0.5F) * 1e-6F;
    const double z = static_cast<double>(lanes::normal_quantile(p));
    const double density = std::exp(-0.5 * z * z) / std::sqrt(2 * M_PI);
    const double cumulative = 0.5 * std::erfc(-z / std::sqrt(2.0));
    // 4e-6 in z: the fit plus the rounding of p itself near 1, where one ulp of p is density * 1e-7
    // wide.
    ASSERT_LT(std::abs(cumulative - static_cast<double>(p)) / density, 4e-6 + 6e-8 / density)
        << "p " << p;
  }
  EXPECT_NEAR(static_cast<double>(lanes::normal_quantile(0x1p-25F)), -5.419983, 1e-5);
}

}  // namespace
}  // namespace omentum
