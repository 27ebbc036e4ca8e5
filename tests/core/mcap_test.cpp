#include "core/mcap.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "core/check.h"
#include "core/episode_recording.h"
#include "proto/foxglove.pb.h"
#include "proto/recording.pb.h"
#include "tests/support/episode_fixture.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace omentum {
namespace {

using testing::HasSubstr;

const std::string kTests = OMENTUM_TESTS_DIR;

std::string temp_path(const std::string& name) {
  return (std::filesystem::path(testing::TempDir()) / (std::to_string(::getpid()) + "_" + name))
      .string();
}

std::string read_bytes(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

/// A small file: two channels, three chunks.
std::string make_file(McapCompression compression, int messages = 12) {
  std::ostringstream out;
  McapWriter writer(out, compression, 600);
  const auto step = writer.add_channel("/step", *pb::StepRecord::descriptor());
  const auto note = writer.add_channel("/note", *pb::EpisodeResult::descriptor());
  for (int k = 0; k < messages; ++k) {
    pb::StepRecord record;
    record.set_step(static_cast<std::uint32_t>(k));
    record.set_action("abcd");
    record.set_state_hash(0x0123456789abcdefULL * static_cast<std::uint64_t>(k + 1));
    writer.write(step, static_cast<std::uint64_t>(k) * 1000, static_cast<std::uint32_t>(k), record);
    pb::EpisodeResult text;
    text.set_failure("{\"k\": 1, \"text\": \"hello hello\"}");
    if (k % 3 == 0) writer.write(note, static_cast<std::uint64_t>(k) * 1000, 0, text);
    if (k % 4 == 3) writer.flush();
  }
  EXPECT_TRUE(writer.finish().has_value());
  return out.str();
}

TEST(Mcap, RoundTrip) {
  for (const McapCompression compression :
       {McapCompression::kNone, McapCompression::kLz4, McapCompression::kZstd}) {
    const McapContent content = read_mcap(make_file(compression));
    EXPECT_TRUE(content.complete);
    EXPECT_THAT(content.problems, testing::IsEmpty());
    EXPECT_GE(content.chunks, 3);
    ASSERT_EQ(content.channels.size(), 2);
    const McapChannel& channel = content.channels.at(1);
    EXPECT_EQ(channel.topic, "/step");
    EXPECT_EQ(channel.encoding, "protobuf");
    EXPECT_EQ(channel.schema.name, "omentum.pb.StepRecord");
    EXPECT_EQ(channel.schema.encoding, "protobuf");
    EXPECT_GT(channel.schema.data.size(), 100);
    const auto steps = content.of_topic("/step");
    ASSERT_EQ(steps.size(), 12);
    for (std::size_t k = 0; k < steps.size(); ++k) {
      pb::StepRecord record;
      ASSERT_TRUE(record.ParseFromString(steps[k]->data));
      EXPECT_EQ(record.step(), k);
      EXPECT_EQ(steps[k]->log_time, k * 1000);
    }
    EXPECT_EQ(content.of_topic("/note").size(), 4);
  }
}

TEST(Mcap, EmptyFileIsLegal) {
  std::ostringstream out;
  McapWriter writer(out);
  ASSERT_TRUE(writer.finish().has_value());
  const McapContent content = read_mcap(out.str());
  EXPECT_TRUE(content.complete);
  EXPECT_THAT(content.problems, testing::IsEmpty());
}

TEST(McapReader, TruncationAtEveryByteIsReported) {
  for (const McapCompression compression :
       {McapCompression::kNone, McapCompression::kLz4, McapCompression::kZstd}) {
    const std::string file = make_file(compression);
    std::size_t messages_before = 0;
    for (std::size_t size = 0; size < file.size(); ++size) {
      const McapContent content = read_mcap(std::string_view(file).substr(0, size));
      EXPECT_FALSE(content.problems.empty()) << "cut at byte " << size;
      EXPECT_GE(content.messages.size(), messages_before) << "whole chunks stay readable";
      messages_before = content.messages.size();
    }
    EXPECT_EQ(messages_before, 16);
  }
}

TEST(McapReader, TruncatedTailIsReportedAndSkipped) {
  const std::string file = make_file(McapCompression::kNone);
  const std::size_t last_chunk = file.find("\"text\"", file.size() / 2);
  ASSERT_NE(last_chunk, std::string::npos);
  const McapContent content = read_mcap(std::string_view(file).substr(0, last_chunk));
  EXPECT_FALSE(content.complete);
  EXPECT_EQ(content.chunks_skipped, 1);
  EXPECT_GT(content.messages.size(), 0);
  EXPECT_THAT(content.problems.front(), HasSubstr("file ends inside a chunk"));
}

TEST(McapReader, EveryFlippedByteIsCaught) {
  for (const McapCompression compression :
       {McapCompression::kNone, McapCompression::kLz4, McapCompression::kZstd}) {
    const std::string file = make_file(compression, 6);
    for (std::size_t at = 0; at < file.size(); ++at) {
      std::string flipped = file;
      flipped[at] = static_cast<char>(flipped[at] ^ 0x20);
      EXPECT_FALSE(read_mcap(flipped).problems.empty()) << "byte " << at;
    }
  }
}

TEST(McapReader, DamagedChunkIsSkippedAndTheOthersStay) {
  std::string file = make_file(McapCompression::kNone);
  const std::size_t at = file.find("hello");
  file[at] = 'j';
  const McapContent content = read_mcap(file);
  EXPECT_TRUE(content.complete);
  EXPECT_EQ(content.chunks_skipped, 1);
  EXPECT_GE(content.chunks, 2);
  EXPECT_THAT(content.problems.front(), HasSubstr("CRC differs"));
}

TEST(McapReader, ChunkThatClaimsTooMuchIsSkipped) {
  std::string file = make_file(McapCompression::kZstd);
  const std::size_t zstd = file.find("zstd");
  file[zstd - 4 - 4 - 3] =
      '\x7f';  // a high byte of uncompressed_size, before CRC and length of the name
  const McapContent content = read_mcap(file);
  EXPECT_GE(content.chunks_skipped, 1);
}

TEST(McapReader, MessagesAreFetchedAgainInAnyOrder) {
  for (const McapCompression compression :
       {McapCompression::kNone, McapCompression::kLz4, McapCompression::kZstd}) {
    const std::string path = temp_path("fetch.mcap");
    std::ofstream(path, std::ios::binary) << make_file(compression);
    std::ifstream in(path, std::ios::binary);
    McapReader reader(in);
    std::vector<std::pair<McapPlace, std::string>> messages;
    for (McapView view; reader.next(view);) messages.emplace_back(view.place, view.data);
    EXPECT_TRUE(reader.complete());
    ASSERT_EQ(messages.size(), 16);
    McapFetcher fetcher(path);
    for (const std::size_t k : {15U, 0U, 7U, 8U, 1U, 15U})
      EXPECT_EQ(fetcher.fetch(messages[k].first), messages[k].second) << k;
    EXPECT_THROW(fetcher.fetch({messages[3].first.record + 1, 0}), Error);
    EXPECT_THROW(fetcher.fetch({messages[3].first.record, 1U << 20}), Error);
    std::filesystem::remove(path);
  }
}

TEST(McapReader, OneChunkAtATimeIsInMemory) {
  // A stream that is told how far it was read: the first message comes before the second chunk.
  const std::string file = make_file(McapCompression::kZstd);
  std::istringstream in(file);
  McapReader reader(in);
  McapView view;
  ASSERT_TRUE(reader.next(view));
  EXPECT_EQ(reader.chunks(), 1);
  EXPECT_LT(static_cast<std::size_t>(in.tellg()), file.size() / 2);
}

TEST(McapReader, NotAFileAtAll) {
  EXPECT_THAT(read_mcap("hello").problems.front(), HasSubstr("no MCAP magic"));
  EXPECT_FALSE(load_episode("/nonexistent.mcap").has_value());
}

void expect_equal(const RolloutSegment& a, const RolloutSegment& b) {
  EXPECT_EQ(a.steps, b.steps);
  EXPECT_EQ(a.observations, b.observations);
  EXPECT_EQ(a.actions, b.actions);
  EXPECT_EQ(a.actions_continuous, b.actions_continuous);
  EXPECT_EQ(a.rewards, b.rewards);
  EXPECT_EQ(a.flags, b.flags);
  EXPECT_EQ(a.log_probs, b.log_probs);
  EXPECT_EQ(a.values, b.values);
  EXPECT_EQ(a.state_hashes, b.state_hashes);
  EXPECT_EQ(a.exposures, b.exposures);
  EXPECT_EQ(a.tool_positions_in_world_m, b.tool_positions_in_world_m);
  EXPECT_EQ(a.frame_positions_in_world_m, b.frame_positions_in_world_m);
  EXPECT_EQ(a.episode_outcome, b.episode_outcome);
  EXPECT_EQ(a.episode_return, b.episode_return);
  EXPECT_EQ(a.episode_length, b.episode_length);
  EXPECT_EQ(a.episode_exposure, b.episode_exposure);
  EXPECT_EQ(a.episode_grasped, b.episode_grasped);
  EXPECT_EQ(a.episode_held, b.episode_held);
  EXPECT_EQ(a.episode_grasp_position_in_world_m, b.episode_grasp_position_in_world_m);
  EXPECT_EQ(a.episode_start_position_in_world_m, b.episode_start_position_in_world_m);
  EXPECT_EQ(a.end_hash, b.end_hash);
  EXPECT_EQ(a.physics_ticks, b.physics_ticks);
  EXPECT_EQ(a.build_id, b.build_id);
}

TEST(EpisodeRecording, SaveAndLoadAreInverse) {
  EpisodeRecording made = test::make_episode(43, 20);
  for (const bool continuous : {false, true}) {
    if (continuous) made.segment.actions_continuous.assign(4 * 43, 0.25F);
    const std::string path = temp_path("episode.mcap");
    const Result<void> saved = save_episode(path, made.task, made.segment, made.context);
    ASSERT_TRUE(saved.has_value()) << saved.error();
    const Result<EpisodeRecording> read = load_episode(path);
    std::filesystem::remove(path);
    ASSERT_TRUE(read.has_value()) << read.error();
    const EpisodeRecording& episode = read.value();
    EXPECT_TRUE(episode.complete);
    EXPECT_THAT(episode.problems, testing::IsEmpty());
    expect_equal(episode.segment, made.segment);
    EXPECT_EQ(episode.frame_steps, made.frame_steps);
    EXPECT_EQ(episode.context.name, made.context.name);
    EXPECT_EQ(episode.context.config_text, made.context.config_text);
    EXPECT_EQ(episode.context.git_revision, made.context.git_revision);
    EXPECT_EQ(episode.task.weights_hash, made.task.weights_hash);
    EXPECT_EQ(episode.task.start_index, made.task.start_index);
    EXPECT_EQ(episode.task.run_seed, made.task.run_seed);
    EXPECT_EQ(episode.task.episode, made.task.episode);
    EXPECT_EQ(episode.task.greedy, made.task.greedy);
    // The task is identified by everything that decides its result; a recording must carry all of
    // it.
    EXPECT_EQ(hash_task(episode.task), hash_task(made.task));
  }
}

// The file was written before the list of fields served recordings.
TEST(EpisodeRecording, KeepsTheBytesOfEveryMessageButTheHeader) {
  const EpisodeRecording made = test::make_episode(2, 2, 1);
  const std::string path = temp_path("episode.mcap");
  ASSERT_TRUE(save_episode(path, made.task, made.segment, made.context));
  const McapContent now = read_mcap(read_bytes(path));
  std::filesystem::remove(path);
  const McapContent then =
      read_mcap(read_bytes(OMENTUM_TESTS_DIR "/fuzz/corpus/mcap/episode.mcap"));
  for (const char* topic : {"/step", "/tool", "/tissue", "/result"}) {
    const auto a = now.of_topic(topic);
    const auto b = then.of_topic(topic);
    ASSERT_EQ(a.size(), b.size()) << topic;
    EXPECT_GE(a.size(), 1U) << topic;
    for (std::size_t i = 0; i < a.size(); ++i) EXPECT_EQ(a[i]->data, b[i]->data) << topic << i;
  }
}

TEST(EpisodeRecording, ArraysThatDoNotFitTheStepsAreRefused) {
  EpisodeRecording made = test::make_episode(2, 2, 1);
  made.segment.actions_continuous.assign(7, 0);
  EXPECT_FALSE(save_episode(temp_path("bad.mcap"), made.task, made.segment, made.context));
  made.segment.actions_continuous.clear();
  made.segment.flags.clear();
  EXPECT_FALSE(save_episode(temp_path("bad.mcap"), made.task, made.segment, made.context));
}

TEST(EpisodeRecording, RefusesArraysThatDoNotFit) {
  EpisodeRecording made = test::make_episode(10, 4);
  made.segment.rewards.pop_back();
  const Result<void> saved =
      save_episode(temp_path("bad.mcap"), made.task, made.segment, made.context);
  ASSERT_FALSE(saved.has_value());
  EXPECT_THAT(saved.error(), HasSubstr("do not fit its 10 steps"));
}

TEST(EpisodeRecording, TruncatedFileGivesTheStepsOfItsWholeChunks) {
  // As the preset omentum records an episode: 961 particles, a frame every ten steps.
  const EpisodeRecording made = test::make_episode(600, 961);
  const std::string path = temp_path("long.mcap");
  ASSERT_TRUE(save_episode(path, made.task, made.segment, made.context).has_value());
  const std::string bytes = read_bytes(path);
  std::filesystem::remove(path);
  const Result<EpisodeRecording> cut = parse_episode("cut", bytes.substr(0, bytes.size() * 3 / 4));
  ASSERT_TRUE(cut.has_value()) << cut.error();
  EXPECT_FALSE(cut.value().complete);
  EXPECT_GT(cut.value().segment.steps, 200);
  EXPECT_LT(cut.value().segment.steps, 600);
  EXPECT_FALSE(cut.value().problems.empty());
  // However early it is cut, it says what it is of.
  const Result<EpisodeRecording> head = parse_episode("cut", bytes.substr(0, bytes.size() / 10));
  ASSERT_TRUE(head.has_value()) << head.error();
  EXPECT_EQ(head.value().task.start_index, made.task.start_index);
  EXPECT_EQ(head.value().problems.back(), "0 of 600 steps are there");
}

TEST(EpisodeRecording, ACorruptFileIsSaidToBeCorrupt) {
  const Result<EpisodeRecording> none = parse_episode("file", "no recording");
  EXPECT_EQ(none.error(), "file: corrupt: byte 0: no MCAP magic at the start; no episode header");
}

TEST(McapFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kTests + "/fuzz/corpus/mcap")) {
    ++files;
    const std::string content = read_bytes(entry.path().string());
    const auto feed = [](const std::string& bytes) {
      LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
    };
    feed(content);
    for (std::size_t size = 0; size < content.size(); ++size) feed(content.substr(0, size));
    std::string flipped = content;
    for (char& byte : flipped) {
      const char original = byte;
      for (const char mask : {'\x01', '\x80'}) {
        byte = static_cast<char>(original ^ mask);
        feed(flipped);
      }
      byte = original;
    }
  }
  EXPECT_GE(files, 4);
}

}  // namespace
}  // namespace omentum
