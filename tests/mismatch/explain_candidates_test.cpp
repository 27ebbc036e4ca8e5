// Effects that explain asks for: the numbers with which each is refitted.
#include <gtest/gtest.h>

#include <algorithm>

#include "core/config.h"
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

}  // namespace
}  // namespace omentum
