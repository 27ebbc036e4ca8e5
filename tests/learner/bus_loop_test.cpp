// The real learner side and the real worker side of the bus over loopback DDS, with an environment
// that is only a counter: workers that come, go, are slow, wrong or many.
#include "tests/learner/bus_loop.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <thread>

namespace omentum {
namespace {

using test::expected;
using test::FakeWorker;
using test::kMs;
using test::kS;
using test::Loop;
using test::loop_config;
using test::PrivateDomain;
using test::Process;
using test::worker_in;
using test::worker_process;
using test::WorkerThread;

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
  // Some 10 s; a storm of workers that join anew has no end, and a busy machine is slow.
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().workers_ready() == 33; }, 180 * kS))
      << loop.bus().workers_ready();
  EXPECT_EQ(loop.collect(3), expected(loop_config(66, 0), 3));
  EXPECT_TRUE(loop.bus().finish(30 * kS));
  for (Process& worker : workers) EXPECT_EQ(worker.wait(std::chrono::seconds(20)), 0);
}

// Prints the turn-around of a synchronous batch with workers as processes and the state of the real
// sheet.
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
