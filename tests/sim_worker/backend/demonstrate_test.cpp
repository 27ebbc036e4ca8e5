// The scripted expert and the recordings of it.

#include "sim_worker/backend/demonstrate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "core/check.h"
#include "core/config.h"
#include "core/episode_recording.h"
#include "sim_worker/backend/replay.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

constexpr std::uint32_t kEpisodes = 5;

class Demonstrate : public testing::TestWithParam<std::string> {};

TEST_P(Demonstrate, TheExpertReachesTheTarget) {
  const test::TempDir temp;
  const std::string folder = temp / "shown";
  const pb::Config config = load_config(GetParam(), {});
  const DemonstrationCount count = demonstrate(config, {.episodes = kEpisodes, .folder = folder});
  EXPECT_EQ(count.episodes, kEpisodes);
  EXPECT_EQ(count.reached, kEpisodes);
  const std::vector<std::string> files = recordings_of(folder);
  ASSERT_EQ(files.size(), kEpisodes);
  std::vector<std::vector<float>> starts;
  for (const std::string& file : files) {
    const Result<EpisodeRecording> read = load_episode(file);
    ASSERT_TRUE(read.has_value()) << read.error();
    const EpisodeRecording& recording = read.value();
    EXPECT_TRUE(recording.complete && recording.problems.empty());
    EXPECT_EQ(recording.context.config_hash, config_hash(config));
    EXPECT_EQ(recording.segment.steps,
              config.task().episode_steps() / config.task().action_repeat());
    EXPECT_FALSE(recording.segment.frame_positions_in_world_m.empty());
    starts.push_back(recording.segment.episode_start_position_in_world_m);
  }
  std::sort(starts.begin(), starts.end());
  if (config.task().random_start()) {
    EXPECT_EQ(std::unique(starts.begin(), starts.end()), starts.end()) << "two starts are the same";
  }
}

INSTANTIATE_TEST_SUITE_P(Presets, Demonstrate,
                         testing::Values("omentum", "paper_literal", "omentum_oriented"),
                         [](const auto& i) { return i.param; });

TEST(DemonstrateRecordings, AreReplayedBitForBit) {
  const test::TempDir temp;
  const pb::Config config =
      load_config("omentum", std::vector<std::string>{"task.episode_steps=260"});
  demonstrate(config, {.episodes = 1, .folder = temp / "shown"});
  const ReplayReport report = Replayer().replay(temp / "shown/demonstration_000.mcap");
  EXPECT_TRUE(report.identical) << report.text;
  EXPECT_EQ(report.steps, 260 / config.task().action_repeat());
}

TEST(DemonstrateRecordings, AFolderThatIsThereIsNotTouched) {
  const test::TempDir temp;
  std::filesystem::create_directories(temp / "shown/before");
  const pb::Config config = load_config("omentum", {});
  EXPECT_THROW(demonstrate(config, {.episodes = 1, .folder = temp / "shown"}), Error);
  EXPECT_TRUE(std::filesystem::exists(temp / "shown/before"));
}

TEST(DemonstrateRecordings, StoppedLeavesNothing) {
  const test::TempDir temp;
  const pb::Config config = load_config("omentum", {});
  int steps = 0;
  const DemonstrationCount count =
      demonstrate(config, {.episodes = 1, .folder = temp / "shown"}, [&] { return ++steps > 3; });
  EXPECT_TRUE(count.stopped);
  EXPECT_TRUE(std::filesystem::is_empty(temp.path()));
}

}  // namespace
}  // namespace omentum
