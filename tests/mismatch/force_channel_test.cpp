#include "mismatch/explain/force_channel.h"

#include <gtest/gtest.h>

#include <cmath>

namespace omentum {
namespace {

using Eigen::Vector3d;

/// Five lifts of 20 frames: what was seen is a parabola of the lift; the base foretells a line, the
/// model the parabola but for what a sensor adds.
std::vector<std::vector<ForceRow>> lifts() {
  std::vector<std::vector<ForceRow>> recordings(5);
  for (std::size_t r = 0; r < recordings.size(); ++r) {
    for (int f = 0; f < 20; ++f) {
      const double s = f / 19.0, wave = 1e-3 * std::sin(7.0 * f + static_cast<double>(r));
      const Vector3d seen(0, 0.02 * s * s, -0.2 * s * s);
      recordings[r].push_back({seen, seen * (s > 0 ? 1 / s : 1), seen + Vector3d::Constant(wave)});
    }
  }
  return recordings;
}

TEST(ForceChannel, AModelThatForetellsTheForceGainsAndTheOtherWayRoundContradicts) {
  auto recordings = lifts();
  const ForceChannel right = *compare_forces(recordings);
  EXPECT_EQ(right.rows, 100U);
  EXPECT_GT(right.base, 5 * right.model);
  EXPECT_GT(right.gain, 5);
  EXPECT_FALSE(right.contradicts);
  for (auto& rows : recordings) {
    for (ForceRow& row : rows) std::swap(row.base, row.model);
  }
  const ForceChannel wrong = *compare_forces(recordings);
  EXPECT_NEAR(wrong.gain, -right.gain, 1e-9);
  EXPECT_TRUE(wrong.contradicts);
}

TEST(ForceChannel, OneFactorOnAllForcesOfAFitCountsLittle) {
  auto recordings = lifts();
  const double before = compare_forces(recordings)->model;
  for (auto& rows : recordings) {
    for (ForceRow& row : rows) row.model *= 1.3;
  }
  EXPECT_LT(compare_forces(recordings)->model, 1.5 * before);
  EXPECT_FALSE(compare_forces(recordings)->contradicts);
}

TEST(ForceChannel, OneRecordingThatContradictsIsTrimmed) {
  auto recordings = lifts();
  for (auto& rows : recordings) {
    for (ForceRow& row : rows) row.base = row.model;
  }
  for (ForceRow& row : recordings[2]) row.model *= -1;
  EXPECT_FALSE(compare_forces(recordings)->contradicts);
  for (ForceRow& row : recordings[3]) row.model *= -1;
  EXPECT_TRUE(compare_forces(recordings)->contradicts);
}

TEST(ForceChannel, FewerThanTwoRecordingsSayNothing) {
  auto recordings = lifts();
  recordings.resize(1);
  EXPECT_FALSE(compare_forces(recordings).has_value());
  EXPECT_FALSE(compare_forces({}).has_value());
}

}  // namespace
}  // namespace omentum
