// How much more recordings disagree than their rows say (docs/mismatch.md 5.6), on drawn evidence.
#include "mismatch/explain/dispersion.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "mismatch/explain/left_out_gains.h"
#include "mismatch/linear_world.h"

namespace omentum {
namespace {

/// The median over drawn worlds, whose rows are worth `stated` times what they say.
double median_dispersion(double stated) {
  std::vector<double> found;
  for (unsigned seed = 1; seed <= 15; ++seed) {
    LinearWorld world = draw_world(seed, {0, 0, 0}, {.recordings = 7});
    disperse(1 / stated, world.recordings);
    found.push_back(learned_dispersion(world.recordings, {}).value());
  }
  std::ranges::sort(found);
  return found[found.size() / 2];
}

TEST(LearnedDispersion, FollowsHowMuchTooSureRowsAre) {
  EXPECT_LT(median_dispersion(1), 2);
  for (const double stated : {4.0, 16.0})
    EXPECT_NEAR(std::log(median_dispersion(stated) / stated), 0, std::log(2.0));
}

TEST(LearnedDispersion, IsNotLearnedFromFourRecordings) {
  LinearWorld world = draw_world(1, {0, 0, 0}, {.recordings = 4});
  disperse(1e-2, world.recordings);
  EXPECT_EQ(learned_dispersion(world.recordings, {}).value(), 1);
}

TEST(LearnedDispersion, DividesWhatAnAtomGainsWhereThresholdsSaySo) {
  LinearWorld world = draw_world(3, {2, 0, 0}, {.recordings = 7});
  disperse(0.1, world.recordings);
  const FoldEvidence folds = make_folds(world.recordings).value();
  Thresholds thresholds;
  for (const bool by_dispersion : {false, true}) {
    thresholds.by_dispersion = by_dispersion;
    const std::vector<AtomGains> gains = left_out_gains(folds, {}, thresholds).value();
    for (const AtomGains& atom : gains) {
      EXPECT_GE(atom.dispersion, 1);
      EXPECT_EQ(atom.agreed, by_dispersion ? atom.trimmed / atom.dispersion : atom.trimmed);
      EXPECT_EQ(atom.claimed, atom.agreed > thresholds.gain) << atom.atom;
    }
  }
}

}  // namespace
}  // namespace omentum
