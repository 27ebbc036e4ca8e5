// The weights after 20,000 steps of training of every preset, real learner and worker, against
// stored hashes. A change here is a change of results: CHANGELOG tag [BITS].
// OMENTUM_WRITE_GOLDEN=1 writes the file anew.
#include <gtest/gtest.h>

#include <cstdlib>
#include <map>

#include "tests/integration/programs.h"

namespace omentum {
namespace {

class GoldenWeights : public testing::TestWithParam<const char*> {};

INSTANTIATE_TEST_SUITE_P(Presets, GoldenWeights,
                         testing::Values("omentum", "paper", "paper_literal", "paper_swapped",
                                         "derived", "derived_head", "omentum_elastic",
                                         "omentum_soft", "omentum_robust", "omentum_oriented"),
                         [](const auto& p) { return std::string(p.param); });

/// Trains with one worker and compares the weights with those stored under `key`.
void check_weights(const std::string& key, const std::string& preset, const test::Strings& sets) {
  const std::string path = OMENTUM_GOLDEN_DIR "/weights.txt";
  std::map<std::string, std::string> hashes;
  {
    std::ifstream file(path);
    for (std::string name, hash; file >> name >> hash;) hashes[name] = hash;
  }
  test::Programs programs;
  test::Process worker = programs.worker("golden");
  test::Process learner = programs.learner(
      "golden", test::operator+({"evaluation.enabled=false"}, sets), {"--preset", preset});
  ASSERT_EQ(learner.wait(std::chrono::seconds(580)), 0) << test::read_text(programs.err("golden"));
  const std::string hash = programs.hash("golden");
  if (std::getenv("OMENTUM_WRITE_GOLDEN") != nullptr) {  // NOLINT(concurrency-mt-unsafe)
    hashes[key] = hash;
    std::ofstream file(path);
    for (const auto& [name, h] : hashes) file << name << " " << h << "\n";
    return;
  }
  EXPECT_EQ(hash, hashes[key]) << key;
}

TEST_P(GoldenWeights, AfterTwentyThousandStepsAreTheStoredOnes) {
  check_weights(GetParam(), GetParam(), {"rollout.max_steps=20000"});
}

// A beginner rarely touches the tissue. Started at the sheet, with wide steps and a wide grasp, its
// observations and rewards are of the tissue.
TEST_P(GoldenWeights, AfterTrainingAtTheSheetAreTheStoredOnes) {
  check_weights(std::string(GetParam()) + ".at_the_sheet", GetParam(),
                {"rollout.max_steps=6000", "rollout.slots=16", "rollout.steps_per_segment=64",
                 "ppo.minibatch=128", "task.episode_steps=120",
                 "scene.start_grid.centre_m={ x: -0.0172 y: 0.0536 z: 0.042 }",
                 "scene.start_grid.row_pitch_m=0.001", "scene.start_grid.column_pitch_m=0.001",
                 "task.start_height_range_m=0.002", "task.increment_m=0.002", "grasp.radius_m=0.01",
                 "grasp.patch_radius_m=0.01", "grasp.jaw_open_deg=0", "grasp.max_approach_deg=0",
                 "grasp.min_pinch_m=0"});
}

}  // namespace
}  // namespace omentum
