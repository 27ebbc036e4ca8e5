// Which tasks of a worker run together: the real queue of the worker and the real book of the
// learner, in a time that the test keeps.
#include "sim_worker/bus/task_queue.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <vector>

#include "learner/task_book.h"
#include "tests/learner/fake_rollout.h"

namespace omentum {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::size_t kLanes = 4;

RolloutTask task_of(std::uint32_t slot, std::uint64_t segment, std::uint64_t version) {
  RolloutTask task;
  task.slot = slot;
  task.segment = segment;
  task.policy_version = version;
  return task;
}

bool always(const RolloutTask&) { return true; }

TEST(TaskQueue, AFullGroupBeginsAtOnceAndAPartialOneAfterTheGatherTime) {
  TaskQueue queue;
  for (std::uint32_t slot = 0; slot < kLanes; ++slot) queue.push(task_of(slot, 0, 0), 1000 * kMs);
  EXPECT_EQ(queue.next_group(kLanes, always, 1000 * kMs).size(), kLanes);
  queue.group_ran(1000 * kMs, 1100 * kMs);
  queue.push(task_of(0, 1, 0), 1101 * kMs);
  EXPECT_TRUE(queue.next_group(kLanes, always, 1101 * kMs).empty());
  const std::int64_t until = queue.hold_until_ns();
  EXPECT_EQ(until, 1106 * kMs);  // a twentieth of the group before
  EXPECT_EQ(queue.next_group(kLanes, always, until).size(), 1U);
}

TEST(TaskQueue, TasksThatTrickleInAreNotWaitedForEndlessly) {
  TaskQueue queue;
  queue.group_ran(0, 100 * kMs);
  std::int64_t now = 200 * kMs;
  std::uint32_t slot = 0;
  for (; queue.next_group(1000, always, now).empty(); now += 4 * kMs)
    queue.push(task_of(slot++, 0, 0), now);
  EXPECT_LE(now, 220 * kMs);
}

TEST(TaskQueue, TheOldestBatchRunsFirstWhateverCameFirst) {
  TaskQueue queue;
  for (std::uint32_t slot = 0; slot < kLanes; ++slot) queue.push(task_of(slot, 3, 2), 0);
  for (std::uint32_t slot = 4; slot < 4 + kLanes; ++slot) queue.push(task_of(slot, 2, 1), 0);
  for (const TaskQueue::Entry& entry : queue.next_group(kLanes, always, 0))
    EXPECT_EQ(entry.task.segment, 2U);
  for (const TaskQueue::Entry& entry : queue.next_group(kLanes, always, 0))
    EXPECT_EQ(entry.task.segment, 3U);
}

TEST(TaskQueue, ANewerGrantOfASlotReplacesTheOneThatWaits) {
  TaskQueue queue;
  EXPECT_FALSE(queue.push(task_of(5, 0, 0), 0));
  EXPECT_TRUE(queue.push(task_of(5, 1, 0), 0));
  EXPECT_EQ(queue.size(), 1U);
}

TEST(TaskQueue, SlotsThatFellApartAtTheStartFindTogetherAgain) {
  // Worker 2 joins while worker 1 has everything, and gets its first tasks in two lots.
  TaskBookConfig config;
  config.run_seed = 7;
  config.config_hash = 99;
  config.learner_epoch = 1;
  config.slots = 2 * kLanes;
  config.steps = 20;
  config.lead = 1;
  config.episode_decisions = 50;
  config.state_format = 4;
  config.shape = test::fake_shape();
  TaskBook book(config);
  const auto weights = [](std::uint64_t version) {
    Sha256 hash{};
    hash[0] = static_cast<std::uint8_t>(version + 1);
    return hash;
  };
  struct Worker {
    TaskQueue queue;
    std::vector<RolloutTask> running;
    std::int64_t begin_ns = 0;
  };
  std::map<std::uint32_t, Worker> workers;
  workers[1];
  book.worker_joined(1, kLanes);
  book.announce_weights(0, weights(0));
  std::multimap<std::int64_t, RolloutTask> down;  // by time of arrival
  std::multimap<std::int64_t, RolloutSegment> up;
  constexpr std::int64_t kGroupNs = 400 * kMs;
  int late = 0;  // tasks of the first lots for worker 2
  std::uint64_t batches = 0;
  std::vector<std::size_t> groups;  // of the last batches, tasks in each
  for (std::int64_t now = kMs; batches < 20; now += kMs / 4) {
    ASSERT_LT(now, 20 * kGroupNs * 3);
    if (now == 100 * kMs) {
      workers[2];
      book.worker_joined(2, kLanes);
    }
    for (; !up.empty() && up.begin()->first <= now; up.erase(up.begin()))
      ASSERT_EQ(book.receive(up.begin()->second, now), Verdict::kAdmitted);
    if (book.batch_complete()) {
      book.take_batch();
      ++batches;
      book.announce_weights(batches, weights(batches));
    }
    for (const RolloutTask& task : book.grant(now)) {
      const bool second_lot = task.worker_id == 2 && late++ < 3;
      down.emplace(now + (second_lot ? 60 * kMs : kMs), task);
    }
    for (; !down.empty() && down.begin()->first <= now; down.erase(down.begin()))
      workers.at(down.begin()->second.worker_id).queue.push(down.begin()->second, now);
    for (auto& [id, worker] : workers) {
      if (!worker.running.empty() && now - worker.begin_ns >= kGroupNs) {
        std::int64_t arrival = now;
        for (const RolloutTask& task : worker.running)
          up.emplace(arrival += kMs / 2, test::fake_rollout(task));
        worker.queue.group_ran(worker.begin_ns, now);
        worker.running.clear();
      }
      if (!worker.running.empty()) continue;
      for (TaskQueue::Entry& entry : worker.queue.next_group(kLanes, always, now))
        worker.running.push_back(std::move(entry.task));
      worker.begin_ns = now;
      if (batches >= 10 && !worker.running.empty()) groups.push_back(worker.running.size());
    }
  }
  EXPECT_EQ(std::count(groups.begin(), groups.end(), kLanes), std::ssize(groups))
      << testing::PrintToString(groups);
  EXPECT_GE(groups.size(), 18U);
}

}  // namespace
}  // namespace omentum
