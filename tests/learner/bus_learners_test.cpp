// Workers of one learner after the other on the bus: of a higher epoch, resumed, after a crash.
#include <gtest/gtest.h>

#include <memory>

#include "tests/learner/bus_loop.h"

namespace omentum {
namespace {

using test::expected;
using test::kS;
using test::Loop;
using test::loop_config;
using test::PrivateDomain;
using test::worker_in;
using test::WorkerThread;

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

// Both ended once: the older one at the first word of the younger.
TEST(BusLoop, OfTwoLearnersTheYoungerHearsTheOlderBeforeItSpeaks) {
  const PrivateDomain domain;
  WorkerThread worker(worker_in(domain, 4));
  Loop older(domain.id(), loop_config(4, 0), 7);
  older.start();
  std::vector<std::uint64_t> hashes = older.collect(2);
  {
    Loop younger(domain.id(), loop_config(4, 0), 8);
    EXPECT_EQ(younger.bus().listen_for_older(5 * kS), 7u);
  }
  {
    // One that did not listen, and ends when it hears of it.
    Loop younger(domain.id(), loop_config(4, 0), 9);
    younger.start();
    EXPECT_TRUE(older.serve_until([&] { return younger.bus().older_epoch() == 7; }));
  }
  for (const std::uint64_t hash : older.collect(3)) hashes.push_back(hash);
  EXPECT_FALSE(older.bus().superseded());
  EXPECT_EQ(hashes, expected(loop_config(4, 0), 5));
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

}  // namespace
}  // namespace omentum
