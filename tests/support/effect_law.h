#pragma once

// The strip whose closed forms the effects of both elastic models must meet.

#include <gtest/gtest.h>

#include <memory>

#include "support/effect_scene.h"

namespace omentum::test {

class EffectLaw : public testing::TestWithParam<Model> {
 protected:
  static constexpr double kLength = 0.09;  // [m]
  static constexpr double kGravity = 9.81;
  static constexpr double kDensity = 1000;

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
  /// The same strip, level and stiff, in little gravity: it drops by little.
  static EffectCase cantilever() {
    EffectCase c = strip(1e6);
    c.X_WB = Eigen::Isometry3d::Identity();
    c.gravity = 0.1;
    c.anchor_max_y = -0.042;
    c.damping = 10;
    return c;
  }
  std::unique_ptr<Tissue<double>> make(const EffectCase& c) const {
    return make_effect_tissue(c, GetParam());
  }
  /// Mean of the positions of the free edge.
  static Eigen::Vector3d edge(const EffectCase& c, const Tissue<double>& tissue) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (unsigned ix = 0; ix < c.nx; ++ix)
      sum += tissue.position(0, static_cast<int>(c.ny * ix + c.ny - 1)) / c.nx;
    return sum;
  }
  /// Of the free edge of a level strip at rest [m].
  double drop(const EffectCase& c) const {
    const auto tissue = make(c);
    rest(*tissue, 3);
    return -edge(c, *tissue).z();
  }
  /// Extension of a strip that hangs along -z.
  double extension(const EffectCase& c, double seconds = 2) const {
    const auto tissue = make(c);
    rest(*tissue, seconds);
    return -0.045 - edge(c, *tissue).z();
  }
  /// Extension of a strip whose stress at stretch l is P(l), by 1000 slices.
  template <typename Stress>
  static double hanging(Stress&& stress) {
    constexpr int kSlices = 1000;
    double sum = 0;
    for (int k = 0; k < kSlices; ++k) {
      const double carried = kDensity * kGravity * kLength * (k + 0.5) / kSlices;
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

}  // namespace omentum::test
