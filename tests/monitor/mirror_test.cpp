// `omentum mirror`: a real run read through another domain (docs/monitor.md 5).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>
#include <set>

#include "core/wire.h"
#include "tests/monitor/tool_programs.h"
#include "tests/security/certificates.h"

namespace omentum {
namespace {

using test::eventually;
using test::Programs;
using test::tool;
using test::operator+;

/// A run, its mirror, and a participant of the open domain.
class Mirror : public testing::Test {
 protected:
  void start_run() {
    learner_ = programs_.learner("seen", test::endless_task());
    worker_ = programs_.worker("seen", {"--lanes", "6"});
    ASSERT_TRUE(programs_.reaches_update("seen", 4));
  }
  void start_mirror(const test::Strings& more = {}) {
    mirror_ = test::Process(tool(programs_, "mirror", "seen",
                                 test::Strings{"--to-domain", std::to_string(open_.id())} + more),
                            out_, programs_.folder() / "mirror.err");
    ASSERT_TRUE(eventually([&] { return !test::read_text(out_).empty(); }));
    outside_.emplace(open_.id(), test::loopback_profile().uri, "outside");
  }
  const dds::Participant& outside() const { return *outside_; }

  Programs programs_;
  test::PrivateDomain open_;
  std::string out_ = programs_.folder() / "mirror.out";
  test::Process learner_{{"/bin/true"}}, worker_{{"/bin/true"}}, mirror_{{"/bin/true"}};
  std::optional<dds::Participant> outside_;
};

TEST_F(Mirror, ALateJoinerOfEitherPartitionGetsWhatTheSourceKeeps) {
  const dds::Participant inside(programs_.domain(), test::loopback_profile().uri, "inside");
  BusWriter<PolicyWeights> writer(inside, public_partitions("seen"), "inside-weights");
  start_mirror();
  const auto versions_of = [this](const std::string& partition, std::uint64_t last) {
    BusReader<PolicyWeights> reader(outside(), {partition}, "late-weights");
    std::set<std::uint64_t> versions;
    EXPECT_TRUE(eventually([&] {
      (void)reader.take(16, [&](Arrival<PolicyWeights>&& arrival) {
        if (arrival.info.valid) versions.insert(arrival.record.policy_version);
      });
      return versions.contains(last);
    })) << "partition \""
        << partition << "\"";
    return versions;
  };
  PolicyWeights weights;
  weights.parameters = {1, 2, 3};
  for (weights.policy_version = 1; weights.policy_version <= 3; ++weights.policy_version)
    ASSERT_TRUE(writer.write(weights));
  versions_of("seen", 3);  // the mirror has them all
  EXPECT_EQ(versions_of("", 3), (std::set<std::uint64_t>{2, 3}));
  EXPECT_EQ(versions_of("seen", 3), (std::set<std::uint64_t>{2, 3}));
}

TEST_F(Mirror, SegmentsFlowAndTheRunDoesNotWait) {
  start_run();
  start_mirror();
  BusReader<RolloutSegment> segments(outside(), {"seen"}, "outside-segments");
  int seen = 0;
  EXPECT_TRUE(eventually([&] {
    (void)segments.take(64, [&](Arrival<RolloutSegment>&& arrival) {
      if (arrival.info.valid && !arrival.record.end_state.empty()) ++seen;
    });
    return seen > 100;
  }));
  mirror_.kill(SIGTERM);
  EXPECT_EQ(mirror_.wait(std::chrono::seconds(20)), 0);
  EXPECT_THAT(test::read_text(out_), testing::HasSubstr(" samples mirrored, "));
}

TEST_F(Mirror, LeavingAndCrashingLookAsInTheSource) {
  start_run();
  test::Process crashing = programs_.worker("seen", {"--lanes", "6"});
  start_mirror();
  BusReader<WorkerStatus> workers(outside(), {"seen"}, "outside-workers");
  std::map<int, std::uint32_t> ids;  // by process
  std::map<std::uint32_t, dds::InstanceState> ends;
  const auto look = [&] {
    (void)workers.take(64, [&](Arrival<WorkerStatus>&& arrival) {
      if (arrival.info.valid) ids[static_cast<int>(arrival.record.pid)] = arrival.record.worker_id;
      // Beside a last status that was not taken yet, the end comes with it and not by itself.
      if (arrival.info.state != dds::InstanceState::kAlive)
        ends[arrival.record.worker_id] = arrival.info.state;
    });
  };
  const pid_t crashed_pid = crashing.pid(), left_pid = worker_.pid();
  ASSERT_TRUE(eventually([&] {
    look();
    return ids.contains(crashed_pid) && ids.contains(left_pid);
  }));
  crashing.kill(SIGKILL);
  worker_.kill(SIGTERM);
  EXPECT_TRUE(eventually([&] {
    look();
    return ends.size() == 2;
  }));
  EXPECT_EQ(ends[ids[left_pid]], dds::InstanceState::kDisposed);
  EXPECT_EQ(ends[ids[crashed_pid]], dds::InstanceState::kNoWriters);
}

TEST_F(Mirror, NothingFlowsBack) {
  const dds::Participant inside(programs_.domain(), test::loopback_profile().uri, "inside");
  BusReader<ControlCommand> inside_reader(inside, {"", "seen"}, "inside-reader");
  BusWriter<ControlCommand> inside_writer(inside, public_partitions("seen"), "inside-writer");
  start_mirror();
  BusReader<ControlCommand> outside_reader(outside(), {"seen"}, "outside-reader");
  BusWriter<ControlCommand> outside_writer(outside(), public_partitions("seen"), "outside-writer");
  // Both directions are matched as far as they ever will be.
  ASSERT_TRUE(eventually(
      [&] { return inside_writer.matched() >= 2 && outside_reader.raw().matched() >= 2; }));
  std::set<std::uint64_t> inside_seen, outside_seen;
  const auto look = [](BusReader<ControlCommand>& reader, std::set<std::uint64_t>& seen) {
    (void)reader.take(64, [&seen](Arrival<ControlCommand>&& arrival) {
      if (arrival.info.valid) seen.insert(arrival.record.request);
    });
  };
  ControlCommand command;
  command.run_id = "seen";
  for (std::uint64_t round = 1; round <= 20; ++round) {
    command.request = 1000 + round;  // from outside, always before the one from inside
    ASSERT_TRUE(outside_writer.write(command));
    command.request = round;
    ASSERT_TRUE(inside_writer.write(command));
    ASSERT_TRUE(eventually([&] {
      look(inside_reader, inside_seen);
      look(outside_reader, outside_seen);
      return outside_seen.contains(round) && outside_seen.contains(1000 + round);
    }));
  }
  EXPECT_EQ(inside_seen.size(), 20u);
  EXPECT_EQ(*inside_seen.rbegin(), 20u);  // none of those from outside
}

TEST_F(Mirror, ASecuredRunCanBeReadOpenly) {
  test::Certificates certificates(programs_);
  learner_ = programs_.learner("seen", test::endless_task(), certificates.option("learner"));
  worker_ = programs_.worker("seen", test::Strings{"--lanes", "6"} + certificates.option("worker"));
  ASSERT_TRUE(programs_.reaches_update("seen", 2)) << test::read_text(programs_.err("seen"));
  start_mirror(certificates.option("tool"));
  BusReader<RolloutSegment> segments(outside(), {"seen"}, "outside-segments");
  BusReader<WorkerStatus> workers(outside(), {""}, "outside-workers");
  bool segment = false, worker = false;
  EXPECT_TRUE(eventually([&] {
    (void)segments.take(64,
                        [&](Arrival<RolloutSegment>&& a) { segment = segment || a.info.valid; });
    (void)workers.take(64, [&](Arrival<WorkerStatus>&& a) { worker = worker || a.info.valid; });
    return segment && worker;
  })) << test::read_text(programs_.folder() / "mirror.err");
}

TEST(MirrorOptions, TheRunsOwnDomainIsRefused) {
  Programs programs;
  const std::string domain = std::to_string(programs.domain());
  const test::Finished finished =
      programs.finish(tool(programs, "mirror", "seen", {"--to-domain", domain}));
  EXPECT_EQ(finished.code, 2);
  EXPECT_THAT(finished.err, testing::HasSubstr("--to-domain " + domain));
}

}  // namespace
}  // namespace omentum
