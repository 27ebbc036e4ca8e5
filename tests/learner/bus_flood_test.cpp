// Writers that fill the readers of the bus.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <string>
#include <thread>

#include "tests/learner/bus_loop.h"

namespace omentum {
namespace {

using test::expected;
using test::Loop;
using test::loop_config;
using test::PrivateDomain;
using test::Process;
using test::worker_in;
using test::WorkerThread;

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

// A writer per announced worker once took the learner to the end of what there is.
TEST(BusLoop, AFloodOfMadeUpWorkersIsBoundedAndTheTrainingGoesOn) {
  const PrivateDomain domain;
  Loop loop(domain.id(), loop_config(4, 0));
  loop.start();
  WorkerThread worker(worker_in(domain, 4));
  std::vector<std::uint64_t> hashes = loop.collect(1);
  std::atomic<std::uint32_t> announced = 0;
  std::jthread flood([&](const std::stop_token& stop) {
    const dds::Participant participant(domain.id(), test::loopback_profile().uri, "rogue");
    BusWriter<WorkerStatus> writer(participant, run_partition("loop"), "rogue-status");
    WorkerStatus status;
    status.lanes = 4;
    status.phase = WorkerPhase::kIdle;
    while (!stop.stop_requested()) {
      ++status.worker_id;
      if (writer.write(status)) announced = status.worker_id;
      if (status.worker_id % 100 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  });
  ASSERT_TRUE(loop.serve_until([&] { return announced > 5000; }));
  for (const std::uint64_t hash : loop.collect(4)) hashes.push_back(hash);
  EXPECT_EQ(hashes, expected(loop_config(4, 0), 5));
  EXPECT_GT(loop.bus().statistics().id_conflicts, 1000u);
  EXPECT_LE(loop.bus().worker_statuses().size(), 2u);
}

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

}  // namespace
}  // namespace omentum
