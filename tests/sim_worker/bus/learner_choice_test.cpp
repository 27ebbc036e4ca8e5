#include "sim_worker/bus/learner_choice.h"

#include <gtest/gtest.h>

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;

RunManifest manifest_of(std::uint32_t epoch) {
  RunManifest manifest;
  manifest.run_id = "x";
  manifest.learner_epoch = epoch;
  return manifest;
}

TEST(LearnerChoice, ALearnerHasAManifestAndSpeaks) {
  LearnerChoice choice;
  choice.spoke(1, 7, kS);  // says it is a learner, offers nothing
  EXPECT_EQ(choice.choose(kS), nullptr);
  choice.offered(2, manifest_of(9));  // offers something, never speaks
  EXPECT_EQ(choice.choose(kS), nullptr);
  choice.spoke(2, 8, kS);  // of another epoch than it offers
  EXPECT_EQ(choice.choose(kS), nullptr);
  choice.spoke(2, 9, kS);
  ASSERT_NE(choice.choose(kS), nullptr);
  EXPECT_EQ(choice.choose(kS)->participant, 2u);
}

TEST(LearnerChoice, TheHighestEpochThatSpeaksIsFollowed) {
  LearnerChoice choice;
  choice.offered(1, manifest_of(5));
  choice.offered(2, manifest_of(6));
  choice.spoke(1, 5, 10 * kS);
  choice.spoke(2, 6, 10 * kS);
  EXPECT_EQ(choice.choose(10 * kS)->participant, 2u);
  // The newer one falls silent: the older one goes on with its workers.
  choice.spoke(1, 5, 20 * kS);
  EXPECT_EQ(choice.choose(20 * kS)->participant, 1u);
  // When nobody speaks nothing changes hands.
  EXPECT_EQ(choice.choose(60 * kS)->participant, 2u);
}

TEST(LearnerChoice, ManifestsOfStrangersAreNotKeptWithoutEnd) {
  LearnerChoice choice;
  choice.offered(1, manifest_of(1));
  choice.spoke(1, 1, kS);
  for (std::uint64_t stranger = 2; stranger < 1000; ++stranger)
    choice.offered(stranger, manifest_of(2));
  ASSERT_NE(choice.choose(kS), nullptr);
  EXPECT_EQ(choice.choose(kS)->participant, 1u);
}

}  // namespace
}  // namespace omentum
