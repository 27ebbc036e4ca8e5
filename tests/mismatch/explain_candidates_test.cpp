// Effects that explain asks for: the numbers with which each is refitted, and the steps of that.
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "core/config.h"
#include "mismatch/explain/base_fit.h"
#include "mismatch/explain/candidates.h"

namespace omentum {
namespace {

double left_end_of(const Scene& scene) {
  double left = 0;
  for (const Eigen::Vector3d& p : scene.tissue.particles) left = std::min(left, p.x());
  return left;
}

TEST(ExplainCandidates, ADetachedCornerStaysAtTheCornerAsItBecomesShorter) {
  const Scene scene =
      make_scene(load_scene(deploy_dir() + "/scenes/omentum_elastic.txtpb", {}), {});
  const double left = left_end_of(scene), length = 0.02;
  Candidate corner;
  corner.effect = "anchor_detachment";
  corner.secant = length;
  corner.place = Eigen::Vector2d(left + length / 2, 0);
  const std::vector<EffectNumber> numbers =
      effect_numbers(corner, {corner}, {length}, corner.place, scene);
  ASSERT_EQ(numbers.size(), 2U);
  std::vector<double> values = {numbers[0].start, numbers[1].start};
  EXPECT_NEAR(values[0], left, 1e-12);
  EXPECT_NEAR(values[1] - values[0], length, 1e-12);
  values[1] -= 0.008;  // as a search steps it
  const NamedEffect shorter = effect_of(corner, numbers, values, scene);
  EXPECT_NEAR(shorter.find("from")->value, left, 1e-12);
  EXPECT_NEAR(derived_values(shorter)[0].value, length - 0.008, 1e-12);
  std::swap(values[0], values[1]);  // a search may cross its ends
  EXPECT_NEAR(derived_values(effect_of(corner, numbers, values, scene))[0].value, length - 0.008,
              1e-12);
}

TEST(ExplainCandidates, OneSidedEffectsAreKnownAsThat) {
  const Scene scene =
      make_scene(load_scene(deploy_dir() + "/scenes/omentum_elastic.txtpb", {}), {});
  for (const Candidate& c : candidates_of(scene, {})) {
    const bool signed_effect = c.effect == "inclusion" || c.effect == "strain_stiffening" ||
                               c.effect == "grasp_offset" || c.effect == "jaw_orientation" ||
                               c.effect == "rest_shape" || c.effect == "thickness";
    EXPECT_EQ(c.one_sided, !signed_effect) << c.key;
  }
}

// What a step gains by its share: the slope that linear surfaces foretell, and a bend.
double gain_at(double share, double foretold, double bend) {
  return 2 * foretold * share - bend * share * share;
}

TEST(ExplainStepLength, AfterOneRefusalTheTopOfAParabolaIsMet) {
  constexpr double kForetold = 10, kBend = 50;
  StepLength length;
  length.aim(kForetold);
  EXPECT_EQ(length.share(), 1);
  EXPECT_FALSE(length.accept(gain_at(1, kForetold, kBend)));
  EXPECT_NEAR(length.share(), kForetold / kBend, 1e-12);
  EXPECT_TRUE(length.accept(gain_at(length.share(), kForetold, kBend)));
  EXPECT_FALSE(length.settled());
}

TEST(ExplainStepLength, WhatCanGainNothingIsNotSimulated) {
  StepLength length;
  length.aim(0.1);
  EXPECT_TRUE(length.settled());
  length.aim(10);
  EXPECT_FALSE(length.settled());
  length.aim(1);
  length.accept(-7);  // its parabola gains 0.11 at most
  EXPECT_TRUE(length.settled());
}

TEST(ExplainStepLength, ACliffIsNoParabola) {
  StepLength length;
  length.aim(10);
  EXPECT_FALSE(length.accept(-1e6));
  EXPECT_FALSE(length.settled());
  EXPECT_NEAR(length.share(), 0.1, 1e-12);
}

TEST(ExplainStepLength, AStepThatCannotBeSimulatedIsShortenedTwice) {
  StepLength length;
  length.aim(10);
  for (int k = 0; k < 3; ++k) {
    EXPECT_FALSE(length.settled());
    const double before = length.share();
    EXPECT_FALSE(length.accept(-std::numeric_limits<double>::infinity()));
    EXPECT_LT(length.share(), before);
  }
  EXPECT_TRUE(length.settled());
}

}  // namespace
}  // namespace omentum
