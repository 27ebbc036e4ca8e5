// How far pinches scatter, learned from drawn evidence (docs/mismatch.md 5.6).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "mismatch/explain/scatter.h"

namespace omentum {
namespace {

constexpr double kBelieved = 1.5e-3;  // [m]
const Scatter kPinches{"pinch.", "grasp_offset", 2e-4};

/// Recordings that each see the place of their pinch to `noise` along x_B and y_B: `mean` displaced
/// alike in all, and scattered by `scatter` [m].
std::vector<Evidence> drawn(unsigned seed, std::size_t count, double mean, double scatter,
                            double noise) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Evidence> recordings;
  for (std::size_t r = 0; r < count; ++r) {
    Evidence& e = recordings.emplace_back();
    e.name = "r" + std::to_string(r);
    e.numbers = {{"pinch.x", e.name, NumberRole::kNuisance, 0, kBelieved, "m"},
                 {"pinch.y", e.name, NumberRole::kNuisance, 0, kBelieved, "m"},
                 {"grasp_offset.x", "", NumberRole::kAtom, 0, 0.02, "m", 0, "grasp_offset"},
                 {"grasp_offset.y", "", NumberRole::kAtom, 0, 0.02, "m", 0, "grasp_offset"}};
    const double information = 1 / (noise * noise);
    e.A = Eigen::MatrixXd::Zero(4, 4);
    e.b = Eigen::VectorXd::Zero(4);
    for (int axis = 0; axis < 2; ++axis) {
      const double seen = mean + scatter * normal(random) + noise * normal(random);
      for (const int i : {axis, axis + 2}) {
        e.b[i] = information * seen;
        for (const int j : {axis, axis + 2}) e.A(i, j) = information;
      }
    }
  }
  return recordings;
}

TEST(LearnedScatter, IsFoundWithinAFactorWhateverAllRecordingsAreDisplacedBy) {
  int inside = 0, all = 0;
  for (const double scatter : {3e-4, 6e-4, 2e-3}) {
    for (const double mean : {0.0, 5e-3}) {
      for (unsigned seed = 1; seed <= 20; ++seed) {
        const double found =
            learned_scatter(drawn(seed, 7, mean, scatter, 1e-4), kPinches, kBelieved).value();
        inside += std::fabs(std::log(found / scatter)) < std::log(1.6) ? 1 : 0;
        ++all;
      }
    }
  }
  EXPECT_GE(inside, 0.9 * all);
}

TEST(LearnedScatter, StaysAsBelievedWhereRecordingsSayNothingOfIt) {
  EXPECT_EQ(learned_scatter(drawn(1, 4, 0, 5e-4, 1e-4), kPinches, kBelieved).value(), kBelieved);
  const double blind = learned_scatter(drawn(1, 7, 0, 5e-4, 1.0), kPinches, kBelieved).value();
  EXPECT_NEAR(std::log(blind / kBelieved), 0, std::log(1.25));
}

TEST(LearnedScatter, IsBelievedOfWhatScattersAlone) {
  std::vector<Evidence> recordings = drawn(1, 2, 0, 5e-4, 1e-4);
  set_scatter(kPinches, 7e-4, recordings);
  for (const Evidence& e : recordings) {
    for (const Number& number : e.numbers)
      EXPECT_EQ(number.sd, number.owner.empty() ? 0.02 : 7e-4) << number.name();
  }
}

}  // namespace
}  // namespace omentum
