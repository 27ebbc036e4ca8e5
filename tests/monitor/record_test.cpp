// `omentum record` of a real run, read with our reader.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/mcap.h"
#include "proto/bus.pb.h"
#include "tests/monitor/tool_programs.h"

namespace omentum {
namespace {

using test::eventually;
using test::Programs;
using test::tool;
using test::operator+;
using testing::HasSubstr;

class Record : public testing::Test {
 protected:
  void SetUp() override {
    learner_ = programs_.learner("kept", test::endless_task());
    worker_ = programs_.worker("kept", {"--lanes", "6"});
    ASSERT_TRUE(programs_.reaches_update("kept", 2));
  }
  test::Process record(const test::Strings& more) {
    return test::Process(tool(programs_, "record", "kept", test::Strings{"--out", file_} + more),
                         programs_.folder() / "record.out", programs_.folder() / "record.err");
  }
  std::string said() const { return test::read_text(programs_.folder() / "record.out"); }

  Programs programs_;
  std::string file_ = programs_.folder() / "kept.mcap";
  test::Process learner_{{"/bin/true"}}, worker_{{"/bin/true"}};
};

TEST_F(Record, EndsWholeAtSigintWithEveryPublicTopic) {
  test::Process process = record({});
  ASSERT_TRUE(eventually([&] { return test::read_text(file_).size() > 200'000; }))
      << test::read_text(programs_.folder() / "record.err");
  process.kill(SIGINT);
  ASSERT_EQ(process.wait(std::chrono::seconds(30)), 0);
  EXPECT_THAT(said(), HasSubstr(": 0 samples dropped"));
  const McapContent content = read_mcap(test::read_text(file_));
  EXPECT_TRUE(content.complete);
  EXPECT_THAT(content.problems, testing::IsEmpty());
  EXPECT_EQ(content.channels.size(), 10u);
  const auto segments = content.of_topic("omentum/rollout/segment");
  ASSERT_FALSE(segments.empty());
  pb::bus::RolloutSegment segment;
  ASSERT_TRUE(segment.ParseFromString(segments.front()->data));
  EXPECT_EQ(segment.steps(), 32u);
  EXPECT_EQ(segment.rewards_size(), 32);
  EXPECT_FALSE(segment.end_state().empty());
  const auto manifests = content.of_topic("omentum/run/manifest");
  ASSERT_EQ(manifests.size(), 1u);  // published before the recorder came
  pb::bus::RunManifest manifest;
  ASSERT_TRUE(manifest.ParseFromString(manifests.front()->data));
  EXPECT_EQ(manifest.run_id(), "kept");
  EXPECT_FALSE(content.of_topic("omentum/worker/status").empty());
  EXPECT_FALSE(content.of_topic("omentum/learner/status").empty());
}

TEST_F(Record, HoldsTheTopicsThatWereNamedForTheTimeThatWasNamed) {
  test::Process process =
      record({"--topics", "omentum/worker/status,omentum/run/manifest", "--seconds", "2"});
  ASSERT_EQ(process.wait(test::kRunTime), 0);
  const McapContent content = read_mcap(test::read_text(file_));
  EXPECT_TRUE(content.complete);
  EXPECT_EQ(content.channels.size(), 2u);
  EXPECT_FALSE(content.of_topic("omentum/worker/status").empty());
}

TEST_F(Record, AFileThatIsThereOrATopicThatIsNotIsRefused) {
  for (const test::Strings& more :
       {test::Strings{"--out", "/dev/null"}, test::Strings{"--out", "/no/such/folder/x.mcap"},
        test::Strings{"--out", file_, "--topics", "omentum/rollout/task"}}) {
    const test::Finished finished = programs_.finish(tool(programs_, "record", "kept", more));
    EXPECT_EQ(finished.code, 2) << more.back();
    EXPECT_EQ(test::lines_of(finished.err).size(), 1u) << finished.err;
  }
}

TEST(RecordOfNobody, IsNoSuccess) {
  Programs programs;
  const test::Finished finished = programs.finish(tool(
      programs, "record", "nobody", {"--out", programs.folder() / "none.mcap", "--seconds", "1"}));
  EXPECT_EQ(finished.code, 1);
  EXPECT_THAT(finished.err, HasSubstr("nobody of run nobody spoke on domain " +
                                      std::to_string(programs.domain())));
}

}  // namespace
}  // namespace omentum
