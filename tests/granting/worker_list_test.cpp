#include "granting/worker_list.h"

#include <gtest/gtest.h>

namespace omentum {
namespace {

using Event = WorkerList::Event;

constexpr std::int64_t kS = 1'000'000'000;

/// A status of a worker by a process; each process has one writer.
Arrival<WorkerStatus> said(std::uint32_t id, std::uint64_t participant) {
  Arrival<WorkerStatus> arrival;
  arrival.record.worker_id = id;
  arrival.info = {.valid = true,
                  .state = dds::InstanceState::kAlive,
                  .writer = participant + 1'000'000,
                  .participant = participant};
  return arrival;
}

Arrival<WorkerStatus> gone(std::uint32_t id, dds::InstanceState how) {
  Arrival<WorkerStatus> arrival;
  arrival.record.worker_id = id;
  arrival.info.state = how;
  return arrival;
}

TEST(WorkerList, AProcessIsOneWorkerHoweverManyItAnnounces) {
  WorkerList list;
  EXPECT_EQ(list.note(said(1, 10), kS), Event::kCame);
  for (std::uint32_t id = 2; id < 100'002; ++id)
    ASSERT_EQ(list.note(said(id, 10), kS), Event::kRefused);
  EXPECT_EQ(list.count_alive(), 1u);
  EXPECT_EQ(list.refused(), 100'000u);
  EXPECT_EQ(list.take_changed().size(), 1u);
  EXPECT_EQ(list.note(said(2, 11), kS), Event::kCame);  // another process may
}

TEST(WorkerList, AFullListGivesThePlaceOfASilentOneToTheNext) {
  WorkerList list;
  const auto most = static_cast<std::uint32_t>(WorkerList::kMostWorkers);
  for (std::uint32_t id = 1; id <= most; ++id)
    ASSERT_EQ(list.note(said(id, id), id < 5 ? 0 : 10 * kS), Event::kCame);
  EXPECT_EQ(list.note(said(most + 1, most + 1), 2 * kS), Event::kRefused);  // all speak
  list.take_changed();
  // The oldest goes first, and whoever serves it is told.
  ASSERT_EQ(list.note(said(2, 2), 10 * kS), Event::kSpoke);
  ASSERT_EQ(list.note(said(most + 2, most + 2), 10 * kS), Event::kCame);
  EXPECT_EQ(list.find(1)->alive, false);
  EXPECT_EQ(list.count_alive(), most);
  EXPECT_EQ(list.pushed_out(), 1u);
  bool told = false;
  for (const auto& [id, worker] : list.take_changed()) told = told || (id == 1 && !worker.alive);
  EXPECT_TRUE(told);
  EXPECT_EQ(list.find(1), nullptr);
}

TEST(WorkerList, AWorkerThatCameAnewIsAnotherProcessUnderItsId) {
  WorkerList list;
  ASSERT_EQ(list.note(said(1, 10), 0), Event::kCame);
  EXPECT_EQ(list.note(said(1, 11), kS), Event::kRefused);  // while the first is there
  EXPECT_EQ(list.note(gone(1, dds::InstanceState::kNoWriters), 2 * kS), Event::kCrashed);
  EXPECT_TRUE(list.is_process_of(1, 10));  // late results count
  EXPECT_EQ(list.note(said(1, 11), 3 * kS), Event::kCame);
  EXPECT_TRUE(list.is_process_of(1, 11));
  EXPECT_FALSE(list.is_process_of(1, 10));
  EXPECT_EQ(list.note(gone(7, dds::InstanceState::kDisposed), 3 * kS), Event::kNothing);
}

}  // namespace
}  // namespace omentum
