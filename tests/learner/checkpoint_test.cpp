#include "learner/checkpoint.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>

#include "core/durable_file.h"
#include "core/policy.h"
#include "learner/ppo.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

class CheckpointTest : public testing::Test {
 protected:
  void overwrite(const std::string& path, std::span<const std::byte> bytes) {
    std::ofstream file(path, std::ios::binary | std::ios::trunc);
    for (const std::byte b : bytes) file.put(static_cast<char>(b));
  }

  const test::TempDir temp_dir_;
  const std::string& folder_ = temp_dir_.path();
};

pb::Checkpoint small_checkpoint(std::uint64_t updates) {
  pb::Config config;
  config.mutable_rollout()->set_slots(2);
  PolicyShape shape;
  shape.observations = 3;
  shape.branches = {2};
  shape.hidden = 8;
  const Ppo ppo(config, shape, 1);
  pb::Checkpoint c;
  c.set_format_version(kCheckpointFormat);
  c.set_config_text("rollout {\n  slots: 2\n}\n");
  c.set_config_hash(77);
  c.set_run_seed(1);
  c.set_git_revision("abc");
  ppo.save(*c.mutable_ppo());
  c.mutable_ppo()->set_updates(updates);
  to_disk(ppo.weights(), *c.mutable_previous_weights());
  for (std::uint32_t i = 0; i < 2; ++i) {
    pb::SlotState& slot = *c.add_slot();
    slot.set_slot(i);
    slot.set_next_segment(5);
    slot.set_start_state(std::string(20, '\x5a'));
    slot.set_start_hash(9);
  }
  c.mutable_ledger()->set_granted(10);
  return c;
}

TEST_F(CheckpointTest, RoundTripIsExact) {
  const pb::Checkpoint written = small_checkpoint(3);
  const Result<pb::Checkpoint> read = decode_checkpoint(encode_checkpoint(written));
  ASSERT_TRUE(read.has_value()) << read.error();
  EXPECT_EQ(read.value().SerializeAsString(), written.SerializeAsString());
  const Result<PolicyWeights> weights = from_disk(read.value().previous_weights());
  ASSERT_TRUE(weights.has_value()) << weights.error();
  EXPECT_EQ(weights.value().parameters.size(),
            static_cast<std::size_t>(written.previous_weights().parameters_size()));
}

TEST_F(CheckpointTest, EveryPrefixIsRefused) {
  const Bytes bytes = encode_checkpoint(small_checkpoint(3));
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    ASSERT_FALSE(decode_checkpoint(std::span(bytes).first(size)).has_value()) << size;
  }
  Bytes longer = bytes;
  longer.push_back(std::byte{0});
  EXPECT_FALSE(decode_checkpoint(longer).has_value());
}

TEST_F(CheckpointTest, EveryFlippedByteIsRefused) {
  Bytes bytes = encode_checkpoint(small_checkpoint(3));
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    for (const std::byte flip : {std::byte{0x01}, std::byte{0x80}, std::byte{0xFF}}) {
      bytes[i] ^= flip;
      ASSERT_FALSE(decode_checkpoint(bytes).has_value()) << i;
      bytes[i] ^= flip;
    }
  }
}

TEST_F(CheckpointTest, ARefusedPayloadWithAGoodCrcLeavesTheWeightsAsTheyWere) {
  // What the CRC cannot catch: a well-framed file of another program. Parsing and loading must
  // still be total.
  pb::Config config;
  config.mutable_rollout()->set_slots(2);
  PolicyShape shape;
  shape.observations = 3;
  shape.branches = {2};
  shape.hidden = 8;
  Ppo ppo(config, shape, 1);
  const std::string good = small_checkpoint(3).ppo().SerializeAsString();
  int refused = 0;
  for (std::size_t i = 0; i < good.size(); i += 3) {
    std::string bad = good;
    bad[i] = static_cast<char>(bad[i] ^ 0x55);
    for (const std::string& payload : {bad, good.substr(0, i)}) {
      pb::PpoState state;
      if (!state.ParseFromString(payload)) continue;
      const Sha256 before = ppo.weights().weights_hash;
      if (ppo.load(state).has_value()) continue;
      ++refused;
      EXPECT_EQ(ppo.weights().weights_hash, before) << i;
    }
  }
  EXPECT_GT(refused, 0);
}

TEST_F(CheckpointTest, KeepsTheNewestTwoTheBestAndMilestones) {
  CheckpointStore store(folder_, {500, 2000});
  EXPECT_EQ(store.crossed_milestone(0, 499), std::nullopt);
  EXPECT_EQ(store.crossed_milestone(499, 500), std::optional<std::uint64_t>(500));
  EXPECT_EQ(store.crossed_milestone(500, 900), std::nullopt);
  for (std::uint64_t k = 1; k <= 4; ++k) {
    CheckpointStore::Save what;
    what.best = k == 2;
    if (k == 3) what.milestone = 500;
    const Result<void> result = store.save(small_checkpoint(k), what);
    ASSERT_TRUE(result.has_value()) << result.error();
  }
  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder_))
    names.push_back(entry.path().filename().string());
  EXPECT_THAT(names,
              testing::UnorderedElementsAre("checkpoint-00000003.pb", "checkpoint-00000004.pb",
                                            "best.pb", "milestone-0000000500.pb"));
  const auto newest = store.load_newest();
  ASSERT_TRUE(newest.has_value());
  EXPECT_EQ(newest.value()->checkpoint.ppo().updates(), 4u);
  EXPECT_EQ(load_checkpoint(folder_ + "/best.pb").value().ppo().updates(), 2u);
}

TEST_F(CheckpointTest, DamagedNewestFallsBackToThePrevious) {
  CheckpointStore store(folder_, {});
  ASSERT_TRUE(store.save(small_checkpoint(1), {}).has_value());
  ASSERT_TRUE(store.save(small_checkpoint(2), {}).has_value());
  const std::string newest = folder_ + "/checkpoint-00000002.pb";
  const Bytes bytes = read_whole(newest).value();
  overwrite(newest, std::span(bytes).first(bytes.size() / 2));
  const auto loaded = store.load_newest();
  ASSERT_TRUE(loaded.has_value());
  EXPECT_EQ(loaded.value()->checkpoint.ppo().updates(), 1u);
  ASSERT_EQ(loaded.value()->warnings.size(), 1u);
  EXPECT_THAT(loaded.value()->warnings.front(), testing::HasSubstr("truncated"));

  overwrite(folder_ + "/checkpoint-00000001.pb", {});
  const auto none = store.load_newest();
  EXPECT_FALSE(none.has_value());
  EXPECT_THAT(none.error(), testing::HasSubstr("checkpoint-00000001.pb"));
}

// Such a folder was begun anew, over what it held.
TEST_F(CheckpointTest, WithoutANumberedOneTheBestOrALaterMilestoneIsTaken) {
  CheckpointStore store(folder_, {100});
  ASSERT_TRUE(store.save(small_checkpoint(3), {.best = true, .milestone = std::nullopt}));
  ASSERT_TRUE(store.save(small_checkpoint(5), {.best = false, .milestone = 100}));
  for (const char* name : {"checkpoint-00000003.pb", "checkpoint-00000005.pb"})
    ASSERT_TRUE(fs::remove(folder_ + "/" + name));
  auto newest = store.load_newest();
  ASSERT_TRUE(newest) << newest.error();
  EXPECT_EQ(newest.value()->checkpoint.ppo().updates(), 5u);
  fs::remove(folder_ + "/milestone-0000000100.pb");
  newest = store.load_newest();
  ASSERT_TRUE(newest) << newest.error();
  EXPECT_EQ(newest.value()->checkpoint.ppo().updates(), 3u);
}

// The numbered one says what the best score is: it must not be there before the best is.
TEST_F(CheckpointTest, NoNumberedOneIsWrittenBeforeItsBestAndMilestone) {
  CheckpointStore store(folder_, {100});
  fs::create_directory(folder_ + "/best.pb");  // so it cannot be written
  EXPECT_FALSE(store.save(small_checkpoint(3), {.best = true, .milestone = std::nullopt}));
  EXPECT_FALSE(fs::exists(folder_ + "/checkpoint-00000003.pb"));
}

TEST_F(CheckpointTest, EmptyFolderHasNone) {
  const CheckpointStore store(folder_ + "/fresh", {});
  const auto loaded = store.load_newest();
  ASSERT_TRUE(loaded.has_value());
  EXPECT_FALSE(loaded.value().has_value());
}

TEST_F(CheckpointTest, FailedWriteLeavesOlderFiles) {
  CheckpointStore store(folder_, {});
  ASSERT_TRUE(store.save(small_checkpoint(1), {}).has_value());
  fs::create_directory(folder_ +
                       "/checkpoint-00000002.pb.tmp");  // the temporary file cannot be created
  EXPECT_FALSE(store.save(small_checkpoint(2), {}).has_value());
  EXPECT_EQ(store.load_newest().value()->checkpoint.ppo().updates(), 1u);
}

TEST_F(CheckpointTest, AnotherConfigurationIsRefusedReadably) {
  pb::Checkpoint c = small_checkpoint(1);
  c.set_config_text("ppo {\n  clip: 0.2\n}\nrollout {\n  slots: 2\n}\nrun {\n  workers: 2\n}\n");
  const std::string now =
      "ppo {\n  clip: 0.1\n  epochs: 3\n}\nrollout {\n  slots: 2\n}\nrun {\n  workers: 5\n}\n";
  EXPECT_TRUE(check_same_config(c, 77, now).has_value());
  const Result<void> result = check_same_config(c, 78, now);
  ASSERT_FALSE(result.has_value());
  EXPECT_THAT(result.error(),
              testing::HasSubstr("ppo.clip: 0.2 -> 0.1\nppo.epochs: (absent) -> 3"));
  EXPECT_THAT(result.error(), testing::Not(testing::HasSubstr("workers")));
  c.set_config_text(now);
  EXPECT_THAT(check_same_config(c, 78, now).error(), testing::HasSubstr("texts are equal"));
}

TEST_F(CheckpointTest, DamagedWeightsAreNotBelieved) {
  pb::Weights weights = small_checkpoint(1).previous_weights();
  weights.set_parameters(0, weights.parameters(0) + 1);
  EXPECT_FALSE(from_disk(weights).has_value());
  weights.clear_weights_hash();
  EXPECT_FALSE(from_disk(weights).has_value());
}

TEST_F(CheckpointTest, PolicyOfARunIsItsBestCheckpointElseItsNewest) {
  EXPECT_FALSE(load_policy(folder_));
  CheckpointStore store(folder_ + "/checkpoints", {});
  ASSERT_TRUE(store.save(small_checkpoint(9), {}));
  ASSERT_TRUE(store.save(small_checkpoint(10), {}));
  const Result<SavedPolicy> newest = load_policy(folder_);
  ASSERT_TRUE(newest) << newest.error();
  EXPECT_THAT(newest.value().path, testing::EndsWith("checkpoint-00000010.pb"));
  EXPECT_EQ(newest.value().config.rollout().slots(), 2U);
  EXPECT_FALSE(newest.value().weights.parameters.empty());
  ASSERT_TRUE(store.save(small_checkpoint(11), {.best = true, .milestone = {}}));
  EXPECT_THAT(load_policy(folder_).value().path, testing::EndsWith("best.pb"));
  EXPECT_THAT(load_policy(folder_ + "/checkpoints/checkpoint-00000010.pb").value().path,
              testing::EndsWith("checkpoint-00000010.pb"));
}

TEST_F(CheckpointTest, LearnerEpochsGrowWhateverHappensToTheFolder) {
  EXPECT_EQ(next_learner_epoch(folder_, 1000).value(), 1000u);
  EXPECT_EQ(next_learner_epoch(folder_, 1000).value(), 1001u);  // within a second
  EXPECT_EQ(next_learner_epoch(folder_, 900).value(), 1002u);   // a clock that went back
  EXPECT_EQ(next_learner_epoch(folder_, 5000).value(), 5000u);
  overwrite(folder_ + "/learner_epoch", std::as_bytes(std::span("x", 1)));
  EXPECT_FALSE(next_learner_epoch(folder_, 1).has_value());
  std::ofstream(folder_ + "/learner_epoch") << "4294967294";  // two more starts and none was left
  EXPECT_THAT(next_learner_epoch(folder_, 1).error(), testing::HasSubstr("allowed up to"));
}

}  // namespace
}  // namespace omentum
