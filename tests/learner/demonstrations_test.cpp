// Recordings as demonstrations: what is read, and one line for whatever cannot be.

#include "learner/demonstrations.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>

#include "core/check.h"
#include "core/config.h"
#include "core/episode_recording.h"
#include "core/read_file.h"
#include "core/task.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using testing::HasSubstr;

/// An episode of preset omentum that reached p_T; numbers are made up and differ from step to step.
EpisodeRecording episode(const pb::Config& config, std::uint32_t steps) {
  EpisodeRecording recording;
  recording.context = recording_context(config, "demonstration", "0123456789ab");
  RolloutSegment& segment = recording.segment;
  segment.steps = steps;
  const int width = observation_size(config.task());
  for (std::uint32_t step = 0; step < steps; ++step) {
    for (int k = 0; k < width; ++k)
      segment.observations.push_back(0.01F * static_cast<float>(k) +
                                     0.001F * static_cast<float>(step));
    for (std::uint32_t k = 0; k < 4; ++k)
      segment.actions.push_back(static_cast<std::uint8_t>((step + k) % 2));
    segment.rewards.push_back(-0.1F * static_cast<float>(step));
    segment.flags.push_back(0);
    segment.log_probs.push_back(0);
    segment.values.push_back(0);
  }
  segment.episode_outcome = {static_cast<std::uint8_t>(Outcome::kTargetReached)};
  segment.episode_return = {-1};
  segment.episode_length = {steps};
  segment.episode_exposure = {1};
  segment.episode_grasped = {1};
  segment.episode_held = {1};
  segment.episode_grasp_position_in_world_m = {0, 0, 0};
  segment.episode_start_position_in_world_m = {0, 0, 0};
  return recording;
}

class DemonstrationsTest : public testing::Test {
 protected:
  void save(const std::string& file, const EpisodeRecording& recording) {
    const Result<void> saved =
        save_episode(folder_ / file, recording.task, recording.segment, recording.context);
    ASSERT_TRUE(saved.has_value()) << saved.error();
  }
  /// The folder is refused by one line that names the option and has these parts.
  void expect_refused(const std::vector<std::string>& parts, const std::string& folder = "") {
    try {
      read_demonstrations(folder.empty() ? folder_.path() : folder, config_);
      ADD_FAILURE() << "was taken";
    } catch (const Error& error) {
      const std::string text = error.what();
      EXPECT_THAT(text, HasSubstr("--initialise-from-recordings"));
      EXPECT_EQ(text.find('\n'), std::string::npos) << text;
      for (const std::string& part : parts) EXPECT_THAT(text, HasSubstr(part));
    }
  }
  /// An episode changed like this is refused; a good one beside it does not help.
  void expect_bad(const std::vector<std::string>& parts,
                  const std::function<void(EpisodeRecording&)>& change) {
    save("a.mcap", episode(config_, 6));
    EpisodeRecording bad = episode(config_, 5);
    change(bad);
    save("b.mcap", bad);
    std::vector<std::string> all = parts;
    all.push_back("b.mcap");
    expect_refused(all);
  }

  const test::TempDir folder_;
  const pb::Config config_ = load_config("omentum", {});
};

TEST_F(DemonstrationsTest, AreTheEpisodesInOrderOfName) {
  save("b.mcap", episode(config_, 7));
  save("a.mcap", episode(config_, 4));
  const Demonstrations read = read_demonstrations(folder_.path(), config_);
  EXPECT_EQ(read.episodes, 2u);
  EXPECT_EQ(read.batch.rows(), 11u);
  const EpisodeRecording first = episode(config_, 4);
  EXPECT_TRUE(std::equal(first.segment.observations.begin(), first.segment.observations.end(),
                         read.batch.observations.begin()));
  EXPECT_TRUE(std::equal(first.segment.actions.begin(), first.segment.actions.end(),
                         read.batch.branches.begin()));
  EXPECT_TRUE(std::equal(first.segment.rewards.begin(), first.segment.rewards.end(),
                         read.batch.rewards.begin()));
  for (std::size_t row = 0; row < 11; ++row)
    EXPECT_EQ(read.batch.flags[row], row == 3 || row == 10 ? step_flag::kTruncated : 0) << row;
}

TEST_F(DemonstrationsTest, OfARunFolderItsRecordingsAreRead) {
  std::filesystem::create_directories(folder_ / "recordings");
  save("recordings/x.mcap", episode(config_, 3));
  EXPECT_EQ(read_demonstrations(folder_.path(), config_).batch.rows(), 3u);
}

TEST_F(DemonstrationsTest, StepsBehindTheEndOfAnEpisodeAreNotRead) {
  EpisodeRecording recording = episode(config_, 9);
  recording.segment.flags[5] = step_flag::kTerminated | step_flag::kHeld;
  save("a.mcap", recording);
  const Demonstrations read = read_demonstrations(folder_.path(), config_);
  EXPECT_EQ(read.batch.rows(), 6u);
  EXPECT_EQ(read.batch.flags.back(), step_flag::kTerminated | step_flag::kHeld);
}

TEST_F(DemonstrationsTest, WhatDoesNotReachTheTargetIsLeftOutAndNamed) {
  EpisodeRecording lost = episode(config_, 5);
  lost.segment.episode_outcome = {static_cast<std::uint8_t>(Outcome::kGraspLost)};
  save("b.mcap", lost);
  expect_refused({"none of its 1 episodes reached p_T"});
  save("a.mcap", episode(config_, 6));
  const Demonstrations read = read_demonstrations(folder_.path(), config_);
  EXPECT_EQ(read.episodes, 1u);
  EXPECT_THAT(read.left_out, testing::ElementsAre(HasSubstr("b.mcap")));
}

TEST_F(DemonstrationsTest, WhatDoesNotChangeTheEpisodeMayDiffer) {
  pb::Config other = load_config(
      "omentum", std::vector<std::string>{"ppo.epochs=9", "rollout.slots=2", "run.domain=3",
                                          "cloning.epochs=7", "evaluation.frame_stride=5"});
  save("a.mcap", episode(other, 6));
  EXPECT_EQ(read_demonstrations(folder_.path(), config_).episodes, 1u);
}

TEST_F(DemonstrationsTest, AnEmptyFolderIsRefused) {
  expect_refused({folder_.path(), "without recordings (*.mcap)"});
  expect_refused({"nowhere", "cannot be opened"}, folder_ / "nowhere");
}

TEST_F(DemonstrationsTest, OtherTasksScenesAndGraspsAreRefusedByKnob) {
  const auto other = [](const std::string& preset, const std::string& set) {
    return episode(load_config(preset, std::vector<std::string>{set}), 5);
  };
  expect_bad({"task.exposure_distance_m", "0.02"}, [&](EpisodeRecording& bad) {
    bad = other("omentum", "task.exposure_distance_m=0.02");
  });
  expect_bad({"task.observation", "OBSERVATION_PAPER"}, [&](EpisodeRecording& bad) {
    bad = other("omentum", "task.observation=OBSERVATION_PAPER");
  });
  expect_bad({"grasp.radius_m"},
             [&](EpisodeRecording& bad) { bad = other("omentum", "grasp.radius_m=0.003"); });
  expect_bad({"scene."},
             [&](EpisodeRecording& bad) { bad = other("omentum_elastic", "run.domain=0"); });
  expect_bad({"its configuration"},
             [](EpisodeRecording& bad) { bad.context.config_text = "task { nonsense: 1 }"; });
}

TEST_F(DemonstrationsTest, NumbersThatCannotBeMeantAreRefused) {
  expect_bad({"an observation is not finite"}, [](EpisodeRecording& bad) {
    bad.segment.observations[3] = std::numeric_limits<float>::quiet_NaN();
  });
  expect_bad({"a reward is not finite"}, [](EpisodeRecording& bad) {
    bad.segment.rewards[3] = std::numeric_limits<float>::infinity();
  });
  expect_bad({"action 3 of branch 1", "below 3"},
             [](EpisodeRecording& bad) { bad.segment.actions[5] = 3; });
  expect_bad({"action 2 of branch 3", "below 2"},
             [](EpisodeRecording& bad) { bad.segment.actions[7] = 2; });
  expect_bad({"19 observed values", "20"},
             [](EpisodeRecording& bad) { bad.segment.observations.resize(5 * 19); });
  expect_bad({"the episode failed: it diverged"},
             [](EpisodeRecording& bad) { bad.segment.failure = "it diverged"; });
  expect_bad({"recorded on a robot"},
             [](EpisodeRecording& bad) { bad.segment.source = Source::kDvrk; });
}

TEST_F(DemonstrationsTest, DamagedFilesAreRefused) {
  save("a.mcap", episode(config_, 400));
  const std::string whole = read_file(folder_ / "a.mcap").value();
  const auto write = [&](const std::string& bytes) {
    std::ofstream(folder_ / "b.mcap", std::ios::binary | std::ios::trunc) << bytes;
  };
  for (const std::size_t size : {std::size_t{0}, std::size_t{5}, whole.size() / 4, whole.size() / 2,
                                 whole.size() - 60, whole.size() - 1}) {
    write(whole.substr(0, size));
    expect_refused({"b.mcap"});
  }
  std::string flipped = whole;
  flipped[whole.size() / 2] = static_cast<char>(~flipped[whole.size() / 2]);
  write(flipped);
  expect_refused({"b.mcap"});
  write("no recording at all");
  expect_refused({"b.mcap"});
}

}  // namespace
}  // namespace omentum
