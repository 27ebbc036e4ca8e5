#include "learner/task_book.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <map>

#include "core/rng.h"
#include "core/segment_fields.h"
#include "tests/learner/small_book.h"

namespace omentum {
namespace {

using test::expect_balance;
using test::fake_rollout;
using test::hash_of_version;
using test::small_config;

// ---------------------------------------------------------------------------------------- lead
// rules

TEST(TaskBook, Lead0GrantsOneSegmentPerSlotAndWaitsForWeights) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 100);
  EXPECT_TRUE(book.grant(0).empty());  // no weights yet
  book.announce_weights(0, hash_of_version(0));
  const std::vector<RolloutTask> tasks = book.grant(1);
  ASSERT_EQ(tasks.size(), 6u);
  for (std::uint32_t s = 0; s < 6; ++s) {
    EXPECT_EQ(tasks[s].slot, s);
    EXPECT_EQ(tasks[s].policy_version, 0u);
    EXPECT_TRUE(tasks[s].reset);
    EXPECT_EQ(tasks[s].task_hash, hash_task(tasks[s]));
    book.receive(fake_rollout(tasks[s]), 2);
  }
  EXPECT_TRUE(book.batch_complete());
  EXPECT_TRUE(book.grant(3).empty());
  book.take_batch();
  EXPECT_TRUE(book.grant(4).empty());  // weights 1 are not announced
  book.announce_weights(1, hash_of_version(1));
  const std::vector<RolloutTask> next = book.grant(5);
  ASSERT_EQ(next.size(), 6u);
  EXPECT_EQ(next[0].segment, 1u);
  EXPECT_EQ(next[0].policy_version, 1u);
  EXPECT_FALSE(next[0].reset);
  EXPECT_EQ(next[0].episode_step, 11u);  // the staggered first episode of slot 0 ended after 9
  expect_balance(book);
}

TEST(TaskBook, Lead1CollectsTheNextBatchWithTheOldWeights) {
  TaskBook book(small_config(1));
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  std::vector<RolloutTask> tasks = book.grant(0);
  ASSERT_EQ(tasks.size(), 6u);
  book.receive(fake_rollout(tasks[2]), 1);
  tasks = book.grant(2);  // slot 2 alone may go on
  ASSERT_EQ(tasks.size(), 1u);
  EXPECT_EQ(tasks[0].slot, 2u);
  EXPECT_EQ(tasks[0].segment, 1u);
  EXPECT_EQ(tasks[0].policy_version, 0u);  // v(1) = 0
  book.receive(fake_rollout(tasks[0]), 3);
  EXPECT_TRUE(book.grant(4).empty());  // v(2) = 1 does not exist
  book.announce_weights(1, hash_of_version(1));
  tasks = book.grant(5);
  ASSERT_EQ(tasks.size(), 1u);
  EXPECT_EQ(tasks[0].segment, 2u);
  EXPECT_EQ(tasks[0].policy_version, 1u);
  expect_balance(book);
}

TEST(TaskBook, StaggerLimitsTheFirstEpisodeOfEverySlot) {
  TaskBookConfig config = small_config(0);
  config.slots = 4;
  config.episode_decisions = 10;
  TaskBook book(config);
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  const std::vector<RolloutTask> tasks = book.grant(0);
  ASSERT_EQ(tasks.size(), 4u);
  EXPECT_EQ(tasks[0].episode_limit, 3u);  // ceil(10 x 1/4)
  EXPECT_EQ(tasks[1].episode_limit, 5u);
  EXPECT_EQ(tasks[2].episode_limit, 8u);
  EXPECT_EQ(tasks[3].episode_limit, 10u);
  config.stagger = false;
  TaskBook plain(config);
  plain.worker_joined(1, 100);
  plain.announce_weights(0, hash_of_version(0));
  EXPECT_EQ(plain.grant(0)[0].episode_limit, 0u);
}

TEST(TaskBook, NothingIsGrantedBeyondTheLastBatch) {
  TaskBookConfig config = small_config(1);
  config.batches = 1;
  TaskBook book(config);
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  for (const RolloutTask& task : book.grant(0)) book.receive(fake_rollout(task), 1);
  EXPECT_TRUE(book.batch_complete());
  EXPECT_TRUE(book.grant(2).empty());
  EXPECT_EQ(book.ledger().outstanding, 0u);
}

// -------------------------------------------------------------------------------------------
// credits

TEST(TaskBook, CreditsBoundWhatAWorkerHolds) {
  TaskBook lead0(small_config(0));
  lead0.worker_joined(1, 2);
  lead0.announce_weights(0, hash_of_version(0));
  EXPECT_EQ(lead0.grant(0).size(), 2u);
  EXPECT_TRUE(lead0.grant(1).empty());
  TaskBook lead1(small_config(1));
  lead1.worker_joined(1, 2);
  lead1.announce_weights(0, hash_of_version(0));
  EXPECT_EQ(lead1.grant(0).size(), 4u);  // one group running, one waiting
  lead1.worker_joined(2, 1);
  EXPECT_EQ(lead1.grant(1).size(), 2u);
}

TEST(TaskBook, WorkIsSpreadOverTheWorkers) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 8);
  book.worker_joined(2, 8);
  book.announce_weights(0, hash_of_version(0));
  std::map<std::uint32_t, int> share;
  for (const RolloutTask& task : book.grant(0)) ++share[task.worker_id];
  EXPECT_EQ(share[1], 3);
  EXPECT_EQ(share[2], 3);
}

TEST(TaskBook, GroupsStayFullHoweverTheResultsOfTwoWorkersInterleave) {
  // A worker that gets four of its sixteen lanes takes as long as one that gets all.
  TaskBookConfig config = small_config(1);
  config.slots = 8;
  TaskBook book(config);
  struct Worker {
    std::deque<RolloutTask> waiting, running;
  };
  std::map<std::uint32_t, Worker> workers;
  for (const std::uint32_t id : {1U, 2U}) {
    book.worker_joined(id, 4);
    workers[id] = {};
  }
  book.announce_weights(0, hash_of_version(0));
  std::map<std::size_t, int> groups;  // by size
  std::uint64_t batches = 0;
  for (std::uint32_t step = 0; batches < 40; ++step) {
    for (const RolloutTask& task : book.grant(step))
      workers.at(task.worker_id).waiting.push_back(task);
    for (auto& [id, worker] : workers) {
      if (!worker.running.empty() || worker.waiting.empty()) continue;
      // A worker waits for more only while others still bring results.
      if (worker.waiting.size() < 4 && !workers.at(3 - id).running.empty()) continue;
      for (; !worker.waiting.empty() && worker.running.size() < 4; worker.waiting.pop_front())
        worker.running.push_back(worker.waiting.front());
      ++groups[worker.running.size()];
    }
    Worker& worker = workers.at(1 + philox({step, 0, 0, 0}, {7, 7})[0] % 2);
    if (worker.running.empty()) continue;
    ASSERT_EQ(book.receive(fake_rollout(worker.running.front()), step), Verdict::kAdmitted);
    worker.running.pop_front();
    if (!book.batch_complete()) continue;
    book.take_batch();
    ++batches;
    book.announce_weights(batches, hash_of_version(batches));
  }
  EXPECT_EQ(groups.size(), 1U) << testing::PrintToString(groups);
  EXPECT_GE(groups[4], 80);
}

// ---------------------------------------------------------------------------------------------
// ledger

TEST(TaskBook, LateDuplicateIsDroppedAndDifferenceIsAnAuditMismatch) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  const std::vector<RolloutTask> tasks = book.grant(0);
  EXPECT_EQ(book.receive(fake_rollout(tasks[0]), 1), Verdict::kAdmitted);
  EXPECT_EQ(book.receive(fake_rollout(tasks[0]), 2), Verdict::kDuplicate);
  EXPECT_EQ(book.ledger().audit_mismatch, 0u);
  RolloutSegment other = fake_rollout(tasks[0]);
  other.end_state[9] ^= std::byte{1};
  other.end_hash = hash_state(other.end_state);
  other.payload_crc32c = segment_crc(other);
  EXPECT_EQ(book.receive(other, 3), Verdict::kDuplicate);
  EXPECT_EQ(book.ledger().audit_mismatch, 1u);
  expect_balance(book);
}

TEST(TaskBook, ADifferenceTellsTheEndStateFromTheSteps) {
  for (const bool end_state : {false, true}) {
    TaskBook book(small_config(0));
    book.worker_joined(1, 100);
    book.announce_weights(0, hash_of_version(0));
    const RolloutTask task = book.grant(0).front();
    ASSERT_EQ(book.receive(fake_rollout(task), 1), Verdict::kAdmitted);
    RolloutSegment other = fake_rollout(task);
    if (end_state) {
      other.end_state[9] ^= std::byte{1};
      other.end_hash = hash_state(other.end_state);
    } else {
      other.rewards[2] += 1;
    }
    other.payload_crc32c = segment_crc(other);
    ASSERT_EQ(book.receive(other, 2), Verdict::kDuplicate);
    ASSERT_TRUE(book.audit_difference().has_value());
    EXPECT_EQ(book.audit_difference()->end_state, end_state);
  }
}

TEST(TaskBook, GarbageIsInvalidAndGrantedAgain) {
  using Spoil = void (*)(RolloutSegment&);
  const std::vector<Spoil> spoils{
      [](RolloutSegment& s) { s.observations[3] = NAN; },
      [](RolloutSegment& s) { s.log_probs.pop_back(); },
      [](RolloutSegment& s) { s.actions[1] = 3; },
      [](RolloutSegment& s) { s.flags[0] = 255; },
      [](RolloutSegment& s) { s.rewards[5] += 1; },  // right length, wrong bit: CRC
      [](RolloutSegment& s) { s.end_state[8] ^= std::byte{4}; },
      [](RolloutSegment& s) { s.end_state.clear(); },
      [](RolloutSegment& s) { s.steps = 3; },
      [](RolloutSegment& s) { s.policy_version = 8; },
      [](RolloutSegment& s) { s.state_format = 1; },
      [](RolloutSegment& s) { s.bootstrap_observation.clear(); },
  };
  for (const Spoil spoil : spoils) {
    TaskBook book(small_config(0));
    book.worker_joined(1, 100);
    book.announce_weights(0, hash_of_version(0));
    const std::vector<RolloutTask> tasks = book.grant(0);
    RolloutSegment bad = fake_rollout(tasks[0]);
    spoil(bad);
    EXPECT_EQ(book.receive(bad, 1), Verdict::kInvalid) << &spoil - spoils.data();
    expect_balance(book);
    const std::vector<RolloutTask> again = book.grant(2);
    ASSERT_EQ(again.size(), 1u);
    EXPECT_EQ(again[0].grant, 1u);
    EXPECT_EQ(again[0].task_hash, tasks[0].task_hash);
    EXPECT_EQ(book.receive(fake_rollout(again[0]), 3), Verdict::kAdmitted);
    expect_balance(book);
  }
}

// Learning takes a value of every truncated step from them.
TEST(TaskBook, ASegmentWithoutItsFinalObservationsIsInvalid) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  RolloutSegment bad = fake_rollout(book.grant(0)[0]);
  ASSERT_FALSE(bad.final_observations.empty());
  bad.final_observations.clear();
  bad.payload_crc32c = segment_crc(bad);
  EXPECT_EQ(book.receive(bad, 1), Verdict::kInvalid);
  EXPECT_EQ(book.ledger().invalid, 1u);
  EXPECT_NE(book.last_refusal().find("final_observations"), std::string::npos);
  expect_balance(book);
}

TEST(TaskBook, AWorkerThatKeepsSendingGarbageIsBarred) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  for (const RolloutTask& task : book.grant(0)) {
    RolloutSegment bad = fake_rollout(task);
    bad.rewards[0] += 1;
    book.receive(bad, 1);
  }
  EXPECT_TRUE(book.grant(2).empty());
  book.worker_joined(2, 100);
  EXPECT_EQ(book.grant(3).size(), 6u);
  expect_balance(book);
}

TEST(TaskBook, ForeignAndStaleAndOverflowAreCounted) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  const std::vector<RolloutTask> tasks = book.grant(0);
  RolloutSegment foreign = fake_rollout(tasks[0]);
  foreign.source = Source::kDvrk;
  EXPECT_EQ(book.receive(foreign, 1), Verdict::kForeign);
  RolloutSegment stale = fake_rollout(tasks[0]);
  stale.task_hash ^= 1;
  EXPECT_EQ(book.receive(stale, 1), Verdict::kStale);
  stale.slot = 5000;
  EXPECT_EQ(book.receive(stale, 1), Verdict::kStale);
  book.overflowed(tasks[3].slot, tasks[3].task_hash);
  book.refused(2);
  EXPECT_EQ(book.ledger().overflow, 1u);
  EXPECT_EQ(book.ledger().invalid, 2u);
  expect_balance(book);
  ASSERT_EQ(book.grant(2).size(), 1u);  // the overflowed one
  expect_balance(book);
}

TEST(TaskBook, ADivergedEpisodeIsSkippedTheSameWayForEveryWorker) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  const RolloutTask first = book.grant(0)[0];
  RolloutSegment failed = fake_rollout(first);
  failed.failed = 1;
  failed.failure = "non-finite";
  failed.payload_crc32c = segment_crc(failed);
  EXPECT_EQ(book.receive(failed, 1), Verdict::kInvalid);
  EXPECT_EQ(book.failures(), 1u);
  expect_balance(book);
  const std::vector<RolloutTask> next = book.grant(2);
  ASSERT_EQ(next.size(), 1u);
  EXPECT_EQ(next[0].segment, 0u);
  EXPECT_TRUE(next[0].reset);
  EXPECT_EQ(next[0].episode, first.episode + failed.episode_end_step.size() + 1);
  EXPECT_NE(next[0].task_hash, first.task_hash);
}

// -----------------------------------------------------------------------------------------
// evaluation

TEST(TaskBook, EvaluationResultsComeInOrderAndNeverEnterABatch) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  std::vector<EvaluationTask> list;
  for (std::uint32_t i = 0; i < 9; ++i) {
    list.emplace_back();
    list.back().start_index = i;
    list.back().steps = 30;
  }
  book.evaluate(list);
  std::vector<RolloutTask> tasks = book.grant(0);
  ASSERT_EQ(tasks.size(), 15u);
  std::reverse(tasks.begin(), tasks.end());
  for (const RolloutTask& task : tasks) {
    EXPECT_EQ(book.receive(fake_rollout(task), 1), Verdict::kAdmitted);
  }
  ASSERT_TRUE(book.evaluation_complete());
  EXPECT_TRUE(book.batch_complete());
  expect_balance(book);
  const std::vector<RolloutSegment> results = book.take_evaluation();
  ASSERT_EQ(results.size(), 9u);
  for (std::uint32_t i = 0; i < 9; ++i) EXPECT_EQ(results[i].slot, kEvaluationSlot + i);
  EXPECT_TRUE(book.granted_evaluation().empty());
  EXPECT_EQ(book.ledger().evaluated, 9u);
  expect_balance(book);
}

}  // namespace
}  // namespace omentum
