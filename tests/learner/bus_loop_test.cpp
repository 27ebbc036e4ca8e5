// The real learner side and the real worker side of the bus over loopback DDS, with an environment
// that is only a counter. Run with `--worker`, `--flood` or `--end-full` it is another
// process of these tests.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstring>

#include "core/check.h"
#include "core/clock.h"
#include "learner/bus.h"
#include "tests/learner/fake_worker.h"
#include "tests/support/process.h"

namespace omentum {
namespace {

using test::FakeWorker;
using test::PrivateDomain;
using test::Process;
using test::WorkerThread;

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kS = 1'000 * kMs;

TaskBookConfig loop_config(std::uint32_t slots, std::uint32_t lead) {
  TaskBookConfig config;
  config.run_seed = 7;
  config.config_hash = test::kFakeConfigHash;
  config.slots = slots;
  config.steps = 20;
  config.lead = lead;
  config.episode_decisions = 50;
  config.state_format = test::kFakeStateFormat;
  config.shape = test::fake_shape();
  return config;
}

std::uint64_t content_hash(const std::vector<RolloutSegment>& batch) {
  std::uint64_t hash = kFnvOffset;
  for (const RolloutSegment& segment : batch) {
    hash = fnv1a64(std::as_bytes(std::span(segment.observations)), hash);
    hash ^= hash_state(segment.end_state);
  }
  return hash;
}

// A learner that counts instead of learning.
class Loop {
 public:
  Loop(std::uint32_t domain, TaskBookConfig config, std::uint32_t epoch = 1,
       const DdsProfile& profile = test::loopback_profile())
      : config_(std::move(config)), bus_(options(domain, epoch, profile)) {
    config_.learner_epoch = epoch;
    book = std::make_unique<TaskBook>(config_);
  }

  void start(std::uint64_t version = 0) {
    RunManifest manifest;
    manifest.config_text = "fake";
    manifest.config_hash = config_.config_hash;
    manifest.layout_hash = test::fake_shape().layout_hash();
    manifest.build_id = test::kFakeBuild;
    manifest.slots = config_.slots;
    manifest.steps_per_segment = config_.steps;
    manifest.lead = config_.lead;
    manifest.state_format = config_.state_format;
    ASSERT_TRUE(bus_.publish_manifest(manifest));
    publish(version);
  }

  void publish(std::uint64_t version) {
    const PolicyWeights weights = test::fake_weights(version);
    ASSERT_TRUE(bus_.publish_weights(weights));
    book->announce_weights(version, weights.weights_hash);
  }

  // Serves until done() or the deadline; true when done.
  bool serve_until(const std::function<bool()>& done, std::int64_t timeout_ns = 30 * kS) {
    const std::int64_t end = steady_now_ns() + timeout_ns;
    while (!done()) {
      if (steady_now_ns() > end) return false;
      bus_.serve(*book, steady_now_ns());
      const Result<void> ok = book->check_balance();
      EXPECT_TRUE(ok) << ok.error();
      if (!done()) bus_.wait(20 * kMs);
    }
    return true;
  }

  // Collects `count` batches; returns their content hashes.
  std::vector<std::uint64_t> collect(int count) {
    std::vector<std::uint64_t> hashes;
    for (int i = 0; i < count; ++i) {
      if (!serve_until([this] { return book->batch_complete(); })) {
        ADD_FAILURE() << "batch " << book->batch() << " has " << book->admitted_in_batch() << " of "
                      << config_.slots;
        return hashes;
      }
      hashes.push_back(content_hash(book->take_batch()));
      publish(book->batch());
    }
    return hashes;
  }

  LearnerBus& bus() { return bus_; }
  std::unique_ptr<TaskBook> book;

 private:
  LearnerBusOptions options(std::uint32_t domain, std::uint32_t epoch,
                            const DdsProfile& profile) const {
    LearnerBusOptions options;
    options.run = "loop";
    options.domain = domain;
    options.profile = profile;
    options.learner_epoch = epoch;
    options.slots = config_.slots;
    return options;
  }

  TaskBookConfig config_;
  LearnerBus bus_;
};

// What the same batches contain without any bus.
std::vector<std::uint64_t> expected(TaskBookConfig config, int count) {
  TaskBook book(std::move(config));
  book.worker_joined(1, 1000);
  book.announce_weights(0, test::fake_weights(0).weights_hash);
  std::vector<std::uint64_t> hashes;
  for (std::int64_t now = 1; static_cast<int>(hashes.size()) < count; ++now) {
    for (const RolloutTask& task : book.grant(now)) book.receive(test::fake_rollout(task), now);
    if (!book.batch_complete()) continue;
    hashes.push_back(content_hash(book.take_batch()));
    book.announce_weights(hashes.size(), test::fake_weights(hashes.size()).weights_hash);
  }
  return hashes;
}

FakeWorker worker_in(const PrivateDomain& domain, int lanes, std::int64_t group_ms = 0) {
  FakeWorker fake;
  fake.domain = domain.id();
  fake.lanes = lanes;
  fake.group_ms = group_ms;
  return fake;
}

Process worker_process(const PrivateDomain& domain, int lanes, int group_ms) {
  return Process({test::this_executable(), "--worker", std::to_string(domain.id()), "loop",
                  std::to_string(lanes), std::to_string(group_ms)});
}

TEST(BusLoop, TwoWorkerThreadsFillBatchesInBothLeadModes) {
  for (const std::uint32_t lead : {0u, 1u}) {
    const PrivateDomain domain;
    Loop loop(domain.id(), loop_config(12, lead));
    WorkerThread a(worker_in(domain, 4));
    WorkerThread b(worker_in(domain, 4));
    loop.start();
    EXPECT_EQ(loop.collect(20), expected(loop_config(12, lead), 20)) << "lead " << lead;
    EXPECT_TRUE(loop.bus().finish(10 * kS));
    a.join();
    b.join();
    for (const WorkerThread* worker : {&a, &b}) {
      const WorkerStatus& s = worker->last;
      EXPECT_EQ(worker->code, 0);
      EXPECT_EQ(s.tasks_received, s.segments_published + s.tasks_abandoned +
                                      s.tasks_declined_config + s.tasks_declined_epoch +
                                      s.tasks_declined_no_weights + s.tasks_declined_state);
    }
    const BusStatistics statistics = loop.bus().statistics();
    EXPECT_EQ(statistics.worker_leaves, 2u);
    EXPECT_EQ(statistics.worker_crashes, 0u);
    EXPECT_EQ(statistics.lost, 0u);
  }
}

// It held the threads of the library, and a learner that had trained to its end hung there.
TEST(BusLoop, AProgramEndsAlthoughAFloodFillsItsReader) {
  const PrivateDomain domain;
  const std::string id = std::to_string(domain.id());
  const Process flood({test::this_executable(), "--flood", id});
  for (int i = 0; i < 5; ++i) {
    Process program({test::this_executable(), "--end-full", id});
    EXPECT_EQ(program.wait(std::chrono::seconds(60)), 0);
  }
}

TEST(BusLoop, AWorkerStartedBeforeTheLearnerJoins) {
  const PrivateDomain domain;
  WorkerThread worker(worker_in(domain, 4));
  while (worker.id == 0) std::this_thread::yield();
  Loop loop(domain.id(), loop_config(4, 0));
  loop.start();
  EXPECT_EQ(loop.collect(3), expected(loop_config(4, 0), 3));
}

TEST(BusLoop, AKilledWorkerProcessCostsNothingButTime) {
  const PrivateDomain domain;
  Loop loop(domain.id(), loop_config(16, 1));
  Process survivor = worker_process(domain, 4, 20);
  Process victim = worker_process(domain, 4, 20);
  loop.start();
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().workers_ready() == 2; }));
  std::vector<std::uint64_t> hashes = loop.collect(3);
  victim.kill(SIGKILL);
  const std::int64_t killed = steady_now_ns();
  std::int64_t noticed = 0;
  for (const std::uint64_t hash : loop.collect(3)) hashes.push_back(hash);
  if (loop.serve_until([&] { return loop.bus().statistics().worker_crashes == 1; }, 10 * kS)) {
    noticed = steady_now_ns() - killed;
  }
  for (const std::uint64_t hash : loop.collect(4)) hashes.push_back(hash);
  EXPECT_EQ(hashes, expected(loop_config(16, 1), 10));
  EXPECT_EQ(loop.bus().statistics().worker_crashes, 1u);
  EXPECT_LE(noticed, 4 * kS);  // lease 2 s, expiry check and a busy machine
  EXPECT_TRUE(loop.bus().finish(10 * kS));
  EXPECT_EQ(survivor.wait(std::chrono::seconds(10)), 0);
  RecordProperty("noticed_ms", static_cast<int>(noticed / kMs));
}

TEST(BusLoop, AStoppedWorkerIsPassedOverAndItsLateResultsAreDuplicates) {
  const PrivateDomain domain;
  TaskBookConfig config = loop_config(8, 0);
  Loop loop(domain.id(), config);
  Process healthy = worker_process(domain, 4, 5);
  Process stopped = worker_process(domain, 4, 5);
  loop.start();
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().workers_ready() == 2; }));
  std::vector<std::uint64_t> hashes = loop.collect(5);
  stopped.kill(SIGSTOP);
  for (const std::uint64_t hash : loop.collect(3)) hashes.push_back(hash);
  stopped.kill(SIGCONT);
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().workers_ready() == 2; }));
  for (const std::uint64_t hash : loop.collect(5)) hashes.push_back(hash);
  EXPECT_EQ(hashes, expected(config, 13));
}

TEST(BusLoop, AGracefulLeaveReturnsTheTasksAtOnce) {
  const PrivateDomain domain;
  Loop loop(domain.id(), loop_config(8, 0));
  WorkerThread leaver(worker_in(domain, 8, 60'000));  // would need a minute
  loop.start();
  ASSERT_TRUE(loop.serve_until([&] { return loop.book->ledger().granted == 8; }));
  WorkerThread other(worker_in(domain, 8));
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().workers_ready() == 2; }));
  std::jthread leaving([&] { leaver.join(); });
  EXPECT_EQ(loop.collect(1), expected(loop_config(8, 0), 1));  // gives up after half a minute
  leaving.join();
  EXPECT_EQ(leaver.last.tasks_abandoned, leaver.last.tasks_received);
  EXPECT_EQ(loop.book->ledger().regranted, 8u);
  EXPECT_EQ(loop.bus().statistics().worker_leaves, 1u);
}

TEST(BusLoop, AWorkerThatMakesItsSceneIsNotSaidToBeSilent) {
  const PrivateDomain domain;
  Loop loop(domain.id(), loop_config(8, 0));
  FakeWorker slow = worker_in(domain, 4);
  slow.setup_ms = 4000;  // silence begins at 2 s and is looked for every second
  testing::internal::CaptureStderr();
  WorkerThread worker(slow);
  loop.start();
  loop.collect(1);
  const std::string said = testing::internal::GetCapturedStderr();
  EXPECT_NE(said.find("event=worker_joined"), std::string::npos) << said;
  EXPECT_EQ(said.find("silent"), std::string::npos) << said;
  EXPECT_EQ(said.find("speaks_again"), std::string::npos) << said;
}

TEST(BusLoop, AWorkerOfAnotherConfigurationDeclinesVisibly) {
  const PrivateDomain domain;
  Loop loop(domain.id(), loop_config(8, 0));
  FakeWorker wrong = worker_in(domain, 4);
  wrong.config_hash = 1;
  WorkerThread bad(wrong);
  loop.start();
  ASSERT_TRUE(loop.serve_until([&] {
    const std::vector<WorkerStatus> all = loop.bus().worker_statuses();
    return all.size() == 1 && all[0].tasks_declined_config > 0;
  }));
  EXPECT_FALSE(loop.bus().worker_statuses()[0].warnings.empty());
  FakeWorker other_build = worker_in(domain, 4);
  other_build.build = 6;
  WorkerThread old(other_build);
  WorkerThread good(worker_in(domain, 4));
  EXPECT_EQ(loop.collect(3), expected(loop_config(8, 0), 3));
}

TEST(BusLoop, AWorkerThatSendsGarbageIsCountedAndBarred) {
  const PrivateDomain domain;
  Loop loop(domain.id(), loop_config(8, 0));
  FakeWorker spoiler = worker_in(domain, 4);
  spoiler.garbage = 1;
  WorkerThread bad(spoiler);
  loop.start();
  ASSERT_TRUE(loop.serve_until([&] { return loop.book->ledger().invalid >= 3; }));
  EXPECT_TRUE(loop.book->grant(steady_now_ns()).empty()) << "the only worker is barred";
  WorkerThread good(worker_in(domain, 4));
  EXPECT_EQ(loop.collect(5), expected(loop_config(8, 0), 5));
}

TEST(BusLoop, WorkersFollowTheHigherEpochAndTheOlderLearnerSeesIt) {
  const PrivateDomain domain;
  WorkerThread worker(worker_in(domain, 4));
  Loop older(domain.id(), loop_config(4, 0), 1);
  older.start();
  std::vector<std::uint64_t> hashes = older.collect(2);
  const SlotTable table = older.book->table();
  {
    Loop newer(domain.id(), loop_config(4, 0), 2);
    TaskBookConfig config = loop_config(4, 0);
    config.learner_epoch = 2;
    newer.book = std::make_unique<TaskBook>(config, table);
    newer.start(table.batch);
    for (const std::uint64_t hash : newer.collect(2)) hashes.push_back(hash);
    EXPECT_TRUE(older.serve_until([&] { return older.bus().superseded(); }));
    EXPECT_EQ(older.bus().superseding_epoch(), 2u);
  }
  // The newer one is gone without a word: the worker does not go back to the older one.
  const std::uint64_t written = older.bus().statistics().bytes_down;
  older.serve_until([] { return false; }, kS);
  EXPECT_EQ(older.bus().statistics().bytes_down, written);
  ASSERT_EQ(older.bus().worker_statuses().size(), 1u);
  EXPECT_EQ(older.bus().worker_statuses()[0].learner_epoch, 2u);
  EXPECT_EQ(hashes, expected(loop_config(4, 0), 4));
}

TEST(BusLoop, AResumedLearnerContinuesWithTheSameContent) {
  const PrivateDomain domain;
  WorkerThread worker(worker_in(domain, 8));
  std::vector<std::uint64_t> hashes;
  SlotTable table;
  {
    Loop first(domain.id(), loop_config(8, 1), 1);
    first.start();
    hashes = first.collect(4);
    table = first.book->table();
  }
  TaskBookConfig config = loop_config(8, 1);
  config.learner_epoch = 2;
  Loop second(domain.id(), config, 2);
  second.book = std::make_unique<TaskBook>(config, table);
  second.start(table.batch - 1);
  second.publish(table.batch);
  for (const std::uint64_t hash : second.collect(4)) hashes.push_back(hash);
  EXPECT_EQ(hashes, expected(loop_config(8, 1), 8));
}

TEST(BusLoop, WorkDoneForACrashedLearnerCountsForTheNextOne) {
  const PrivateDomain domain;
  WorkerThread worker(worker_in(domain, 8, 400));
  TaskBookConfig config = loop_config(8, 0);
  SlotTable table;
  {
    Loop first(domain.id(), config, 1);
    table = first.book->table();
    first.start();
    ASSERT_TRUE(first.serve_until([&] { return first.book->ledger().granted == 8; }));
  }
  config.learner_epoch = 2;
  Loop second(domain.id(), config, 2);
  second.book = std::make_unique<TaskBook>(config, table);
  second.start(0);
  EXPECT_EQ(second.collect(1), expected(loop_config(8, 0), 1));
  worker.join();
  EXPECT_GE(worker.last.segments_published, 8u);
}

TEST(BusLoop, ASecondWriterOfAWorkerIdIsRefused) {
  const PrivateDomain domain;
  Loop loop(domain.id(), loop_config(4, 0));
  loop.start();
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "twins");
  BusWriter<WorkerStatus> first(participant, run_partition("loop"), "first");
  BusWriter<WorkerStatus> second(participant, run_partition("loop"), "second");
  WorkerStatus status;
  status.worker_id = 77;
  status.host = "first";
  ASSERT_TRUE(first.write(status));
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().statistics().workers_alive == 1; }));
  status.host = "second";
  ASSERT_TRUE(second.write(status));
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().statistics().id_conflicts == 1; }));
  ASSERT_EQ(loop.bus().worker_statuses().size(), 1u);
  EXPECT_EQ(loop.bus().worker_statuses()[0].host, "first");
}

TEST(BusLoop, SmallBuffersChangeNothingButTheTime) {
  const PrivateDomain domain;
  DdsProfile profile = test::loopback_profile();
  DdsConfig small;
  small.large_buffers = false;
  profile.uri = dds_config_xml(small);
  profile.small_buffer = true;
  profile.task_spacing_ns = 200'000;
  Loop loop(domain.id(), loop_config(16, 1), 1, profile);
  Process a = worker_process(domain, 4, 2);
  Process b = worker_process(domain, 4, 2);
  loop.start();
  EXPECT_EQ(loop.collect(10), expected(loop_config(16, 1), 10));
}

TEST(BusLoop, ThirtyThreeWorkersFindTheirPlaceOnOneHost) {
  const PrivateDomain domain;
  Loop loop(domain.id(), loop_config(66, 0));
  std::vector<Process> workers;
  for (int i = 0; i < 33; ++i) workers.push_back(worker_process(domain, 2, 5));
  loop.start();
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().workers_ready() == 33; }, 60 * kS))
      << loop.bus().workers_ready();
  EXPECT_EQ(loop.collect(3), expected(loop_config(66, 0), 3));
  EXPECT_TRUE(loop.bus().finish(30 * kS));
  for (Process& worker : workers) EXPECT_EQ(worker.wait(std::chrono::seconds(20)), 0);
}

TEST(BusLoop, AFloodFromARogueWriterIsDroppedAndCounted) {
  const PrivateDomain domain;
  Loop loop(domain.id(), loop_config(4, 0));
  loop.start();
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "rogue");
  BusWriter<RolloutSegment> rogue(participant, run_partition("loop"), "rogue");
  BusWriter<WorkerStatus> announcement(participant, run_partition("loop"), "rogue-status");
  WorkerStatus status;
  status.worker_id = 77;  // without it the segments are a stranger's (Strangers.*)
  ASSERT_TRUE(announcement.write(status));
  ASSERT_TRUE(loop.serve_until(
      [&] { return rogue.matched() > 0 && loop.bus().worker_statuses().size() == 1; }));
  RolloutTask task;
  task.steps = 20;
  task.reset = true;
  RolloutSegment segment = test::fake_rollout(task);
  segment.worker_id = status.worker_id;
  std::uint64_t sent = 0;
  while (sent < 1000) {  // the learner thread does not serve meanwhile
    if (rogue.write(segment)) ++sent;
  }
  ASSERT_TRUE(loop.serve_until([&] { return loop.book->ledger().received == sent; }));
  EXPECT_GT(loop.book->ledger().overflow, 0u);
  WorkerThread worker(worker_in(domain, 4));
  EXPECT_EQ(loop.collect(2), expected(loop_config(4, 0), 2));
}

// Prints the turn-around of a synchronous batch with workers as processes and the state of the real
// sheet.
TEST(BusLoop, ALearnerLeavesWhileSegmentsOfARogueWriterPourIn) {
  const PrivateDomain domain;
  std::jthread rogue([&domain](const std::stop_token& stop) {
    dds::Participant participant(domain.id(), test::loopback_profile().uri, "rogue");
    BusWriter<RolloutSegment> writer(participant, run_partition("loop"), "rogue");
    RolloutSegment segment;
    segment.observations.resize(1000);
    while (!stop.stop_requested()) (void)writer.write(segment);
  });
  std::jthread leaving([&domain](const std::stop_token& /*stop*/) {
    for (int i = 0; i < 3; ++i) {
      Loop loop(domain.id(), loop_config(4, 0));
      ASSERT_TRUE(loop.serve_until([&] { return loop.bus().statistics().foreign > 100; }));
    }
  });
  leaving.join();  // the time limit of the test
}

TEST(BusLoop, MeasuresTheTurnaroundOfASynchronousBatch) {
  const PrivateDomain domain;
  TaskBookConfig config = loop_config(32, 0);
  config.steps = 256;
  Loop loop(domain.id(), config);
  std::vector<Process> workers;
  for (int i = 0; i < 2; ++i) {
    workers.push_back(Process({test::this_executable(), "--worker", std::to_string(domain.id()),
                               "loop", "16", "0", "23064"}));
  }
  loop.start();
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().workers_ready() == 2; }));
  loop.collect(5);
  std::vector<double> ms;
  for (int i = 0; i < 200; ++i) {
    const std::int64_t begin = steady_now_ns();
    loop.collect(1);
    ms.push_back(static_cast<double>(steady_now_ns() - begin) * 1e-6);
  }
  std::sort(ms.begin(), ms.end());
  std::printf(
      "batch of 32 x 256 steps, 23 064 B states, 2 workers: p50 %.2f p95 %.2f max %.2f ms\n",
      ms[100], ms[190], ms[199]);
  EXPECT_EQ(loop.bus().statistics().lost, 0u);
  EXPECT_LT(ms[100], 100.0);  // a stalled bus needs 100 to 200 ms; the machine may be busy
}

}  // namespace
}  // namespace omentum

namespace omentum {
namespace {

// Writes segments of a worker that nobody knows, as fast as they are taken, for ever.
void flood(std::uint32_t domain) {
  const dds::Participant participant(domain, test::loopback_profile().uri, "flood");
  BusWriter<RolloutSegment> writer(participant, run_partition("loop"), "flood");
  RolloutSegment segment;
  segment.worker_id = 9;
  while (true) {
    segment.slot = static_cast<std::uint32_t>(segment.segment % 64);
    if (writer.write(segment)) ++segment.segment;
  }
}

// A program whose reader is full at its end, and nobody takes from it.
int end_full(std::uint32_t domain) {
  const dds::Participant participant(domain, test::loopback_profile().uri, "full");
  const BusReader<RolloutSegment> reader(participant, run_partition("loop"), "full", 4);
  const std::int64_t give_up_ns = steady_now_ns() + 20 * kS;
  while (reader.raw().rejected() == 0 && steady_now_ns() < give_up_ns)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return reader.raw().rejected() > 0 ? 0 : 3;
}

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  if (argc == 3 && std::strcmp(argv[1], "--flood") == 0)
    omentum::flood(static_cast<std::uint32_t>(std::stoul(argv[2])));
  if (argc == 3 && std::strcmp(argv[1], "--end-full") == 0)
    return omentum::end_full(static_cast<std::uint32_t>(std::stoul(argv[2])));
  if (argc >= 6 && std::strcmp(argv[1], "--worker") == 0) {
    omentum::test::FakeWorker fake;
    fake.domain = static_cast<std::uint32_t>(std::stoul(argv[2]));
    fake.run = argv[3];
    fake.lanes = std::stoi(argv[4]);
    fake.group_ms = std::stoll(argv[5]);
    if (argc >= 7) fake.state_bytes = std::stoul(argv[6]);
    omentum::BusWorker worker(omentum::test::fake_options(fake));
    return worker.run([] { return false; });
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
