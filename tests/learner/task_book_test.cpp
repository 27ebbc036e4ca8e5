#include "learner/task_book.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <map>
#include <random>

#include "core/check.h"
#include "core/rng.h"
#include "core/segment_fields.h"
#include "tests/learner/fake_rollout.h"

namespace omentum {
namespace {

using test::fake_rollout;

TaskBookConfig small_config(std::uint32_t lead) {
  TaskBookConfig config;
  config.run_seed = 7;
  config.config_hash = 99;
  config.learner_epoch = 1;
  config.slots = 6;
  config.steps = 20;
  config.lead = lead;
  config.episode_decisions = 50;
  config.state_format = 4;
  config.shape = test::fake_shape();
  return config;
}

Sha256 hash_of_version(std::uint64_t version) {
  Sha256 hash{};
  hash[0] = static_cast<std::uint8_t>(version + 1);
  return hash;
}

void expect_balance(const TaskBook& book) {
  const Result<void> ok = book.check_balance();
  ASSERT_TRUE(ok) << ok.error();
}

// A whole run of `batches` batches with one perfect worker; returns a hash per batch over its
// content.
std::uint64_t content_hash(const std::vector<RolloutSegment>& batch) {
  std::uint64_t hash = kFnvOffset;
  for (std::uint32_t s = 0; s < batch.size(); ++s) {
    EXPECT_EQ(batch[s].slot, s);
    hash = fnv1a64(std::as_bytes(std::span(batch[s].observations)), hash);
    hash = fnv1a64(batch[s].end_state, hash);
    hash = fnv1a64(std::as_bytes(std::span(&batch[s].task_hash, 1)), hash);
  }
  return hash;
}

std::vector<std::uint64_t> reference_run(const TaskBookConfig& config, int batches) {
  TaskBook book(config);
  book.worker_joined(1, 100);
  book.announce_weights(0, hash_of_version(0));
  std::vector<std::uint64_t> hashes;
  std::int64_t now = 0;
  while (static_cast<int>(hashes.size()) < batches) {
    for (const RolloutTask& task : book.grant(++now)) {
      EXPECT_EQ(book.receive(fake_rollout(task), ++now), Verdict::kAdmitted);
    }
    if (!book.batch_complete()) continue;
    hashes.push_back(content_hash(book.take_batch()));
    book.announce_weights(hashes.size(), hash_of_version(hashes.size()));
  }
  return hashes;
}

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

// ------------------------------------------------------------------------------------------
// re-grants

TEST(TaskBook, TasksOfADeadWorkerAreGrantedElsewhereAtOnce) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 3);
  book.worker_joined(2, 3);
  book.announce_weights(0, hash_of_version(0));
  const std::vector<RolloutTask> tasks = book.grant(0);
  book.worker_joined(3, 6);
  book.worker_left(1);
  const std::vector<RolloutTask> again = book.grant(1);
  ASSERT_EQ(again.size(), 3u);
  for (const RolloutTask& task : again) EXPECT_EQ(task.worker_id, 3u);
  EXPECT_EQ(book.ledger().regranted, 3u);
  // A result of the dead one that was on its way still counts, once.
  EXPECT_EQ(book.receive(fake_rollout(tasks[0]), 2), Verdict::kAdmitted);
  EXPECT_EQ(book.receive(fake_rollout(again[0]), 2), Verdict::kDuplicate);
  expect_balance(book);
}

TEST(TaskBook, AnOldTaskIsGrantedToAnotherWorkerAndTheFirstResultWins) {
  TaskBookConfig config = small_config(0);
  config.first_task_age_ns = 5'000'000'000;
  TaskBook book(config);
  book.worker_joined(1, 6);
  book.announce_weights(0, hash_of_version(0));
  const std::vector<RolloutTask> tasks = book.grant(0);
  book.worker_joined(2, 6);
  EXPECT_TRUE(book.grant(4'000'000'000).empty());
  const std::vector<RolloutTask> again = book.grant(6'000'000'000);
  ASSERT_EQ(again.size(), 6u);
  EXPECT_EQ(again[0].worker_id, 2u);
  EXPECT_TRUE(book.grant(6'000'000'001).empty());  // at most one extra
  EXPECT_EQ(book.receive(fake_rollout(again[0]), 6'100'000'000), Verdict::kAdmitted);
  EXPECT_EQ(book.receive(fake_rollout(tasks[0]), 6'200'000'000), Verdict::kDuplicate);
  EXPECT_EQ(book.ledger().cancelled, 1u);
  expect_balance(book);
}

TEST(TaskBook, ALoneWorkerGetsALostTaskAgain) {
  TaskBookConfig config = small_config(0);
  config.first_task_age_ns = 1'000'000'000;
  TaskBook book(config);
  book.worker_joined(1, 6);
  book.announce_weights(0, hash_of_version(0));
  ASSERT_EQ(book.grant(0).size(), 6u);
  EXPECT_TRUE(book.grant(1'500'000'000).empty());
  EXPECT_EQ(book.grant(2'500'000'000).size(), 6u);
  EXPECT_EQ(book.ledger().regranted, 6u);
  expect_balance(book);
}

TEST(TaskBook, AStragglerIsDoubledWhenTheBatchIsNearlyThere) {
  TaskBookConfig config = small_config(0);
  config.slots = 20;
  TaskBook book(config);
  book.worker_joined(1, 10);
  book.worker_joined(2, 10);
  book.announce_weights(0, hash_of_version(0));
  const std::vector<RolloutTask> tasks = book.grant(0);
  ASSERT_EQ(tasks.size(), 20u);
  constexpr std::int64_t kMs = 1'000'000;
  for (std::size_t i = 0; i < 19; ++i) book.receive(fake_rollout(tasks[i]), 100 * kMs);
  EXPECT_TRUE(book.grant(120 * kMs).empty());  // may just be on its way
  const std::vector<RolloutTask> again = book.grant(200 * kMs);
  ASSERT_EQ(again.size(), 1u);
  EXPECT_EQ(again[0].task_hash, tasks[19].task_hash);
  EXPECT_NE(again[0].worker_id, tasks[19].worker_id);
  book.receive(fake_rollout(again[0]), 201 * kMs);
  EXPECT_TRUE(book.batch_complete());
  expect_balance(book);
}

TEST(TaskBook, AuditGrantsEveryTaskTwice) {
  TaskBookConfig config = small_config(0);
  config.audit_rate = 1;
  TaskBook book(config);
  book.worker_joined(1, 6);
  book.worker_joined(2, 6);
  book.announce_weights(0, hash_of_version(0));
  const std::vector<RolloutTask> tasks = book.grant(0);
  ASSERT_EQ(tasks.size(), 12u);
  for (const RolloutTask& task : tasks) book.receive(fake_rollout(task), 1);
  const Ledger ledger = book.ledger();
  EXPECT_EQ(ledger.admitted, 6u);
  EXPECT_EQ(ledger.duplicate, 6u);
  EXPECT_EQ(ledger.audit_mismatch, 0u);
  expect_balance(book);
}

TEST(TaskBook, AuditedBatchesAreAFixedShareAlsoWhenAllLanesAreTaken) {
  for (const std::uint32_t lead : {0U, 1U}) {
    TaskBookConfig config = small_config(lead);
    config.audit_rate = 0.1;
    TaskBook book(config);
    book.worker_joined(1, 3);
    book.worker_joined(2, 3);
    std::vector<std::uint64_t> audited;
    for (std::uint64_t batch = 0; batch < 100; ++batch) {
      book.announce_weights(batch, hash_of_version(batch));
      std::uint64_t second = 0;
      while (!book.batch_complete()) {
        const auto now = static_cast<std::int64_t>(batch + 1);
        const std::vector<RolloutTask> tasks = book.grant(now);
        ASSERT_FALSE(tasks.empty());
        for (const RolloutTask& task : tasks) {
          second += task.grant == 1 && task.segment == batch ? 1 : 0;
          book.receive(fake_rollout(task), now);
        }
      }
      if (second == config.slots) audited.push_back(batch);
      book.take_batch();
    }
    EXPECT_GE(audited.size(), 9u);
    EXPECT_LE(audited.size(), 11u);
    EXPECT_EQ(audited.front(), 0u);  // what is wrong from the start shows at the start
    EXPECT_EQ(book.ledger().duplicate, audited.size() * config.slots);
    expect_balance(book);
  }
}

TEST(TaskBook, ABarredWorkerIsToldWhyAndIsTriedAgainAfterEverLongerTimes) {
  constexpr std::int64_t kS = 1'000'000'000;
  TaskBook book(small_config(0));
  book.worker_joined(1, 6);
  book.announce_weights(0, hash_of_version(0));
  std::int64_t now = 0;
  for (const std::int64_t wait : {10, 20, 40, 80, 160, 320, 320}) {
    ASSERT_FALSE(book.grant(now).empty());
    book.worker_declined(1, "its mesh is another", now);
    ASSERT_EQ(book.barred(now).size(), 1u);
    EXPECT_EQ(book.barred(now)[0].worker_id, 1u);
    EXPECT_EQ(book.barred(now)[0].reason, "its mesh is another");
    now += wait * kS;
    EXPECT_TRUE(book.grant(now - 1).empty());
    EXPECT_TRUE(book.barred(now).empty());
  }
  for (const RolloutTask& task : book.grant(now)) book.receive(fake_rollout(task), now);
  EXPECT_TRUE(book.batch_complete());
  expect_balance(book);
}

TEST(TaskBook, ADeclinedTaskGoesElsewhere) {
  TaskBook book(small_config(0));
  book.worker_joined(1, 6);
  book.announce_weights(0, hash_of_version(0));
  ASSERT_EQ(book.grant(0).size(), 6u);
  book.worker_declined(1, "declines", 0);
  EXPECT_TRUE(book.grant(1).empty());
  book.worker_joined(2, 6);
  EXPECT_EQ(book.grant(2).size(), 6u);
  expect_balance(book);
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

// ----------------------------------------------------------------------------------------------
// laws

// Workers that lose, delay, reorder, repeat, corrupt, die and come back.
class Storm {
 public:
  Storm(TaskBook& book, unsigned seed) : book_(book), random_(seed) {
    for (int i = 0; i < 3; ++i) join();
  }

  void step() {
    now_ += 20'000'000;
    for (RolloutTask& task : book_.grant(now_)) {
      if (draw() < 0.1) continue;  // lost on the way down
      flying_.push_back(fake_rollout(task));
      if (draw() < 0.1) flying_.push_back(flying_.back());  // repeated
    }
    std::shuffle(flying_.begin(), flying_.end(), random_);
    std::size_t arrive = static_cast<std::size_t>(draw() * 8);
    while (arrive-- > 0 && !flying_.empty()) {
      RolloutSegment segment = std::move(flying_.back());
      flying_.pop_back();
      const double fate = draw();
      if (fate < 0.05) continue;  // lost on the way up
      if (fate < 0.08) {
        book_.overflowed(segment.slot, segment.task_hash);
        continue;
      }
      if (fate < 0.1) segment.rewards[0] += 1;
      book_.receive(std::move(segment), now_);
    }
    if (draw() < 0.03) leave();
    if (draw() < 0.05 && workers_.size() < 5) join();
    if (workers_.empty()) join();
    const Result<void> ok = book_.check_balance();
    ASSERT_TRUE(ok) << ok.error();
    const Ledger ledger = book_.ledger();
    ASSERT_LE(ledger.outstanding, 3u * 6u);
  }

 private:
  double draw() { return std::uniform_real_distribution<double>(0, 1)(random_); }
  void join() {
    workers_.push_back(++next_id_);
    book_.worker_joined(next_id_, 1 + next_id_ % 4);
  }
  void leave() {
    book_.worker_left(workers_.front());
    workers_.erase(workers_.begin());
  }

  TaskBook& book_;
  std::mt19937 random_;
  std::vector<RolloutSegment> flying_;
  std::vector<std::uint32_t> workers_;
  std::uint32_t next_id_ = 0;
  std::int64_t now_ = 0;
};

TEST(TaskBook, BatchesDoNotDependOnWorkersOrderLossOrRepetition) {
  constexpr int kBatches = 12;
  for (const std::uint32_t lead : {0u, 1u}) {
    TaskBookConfig config = small_config(lead);
    config.first_task_age_ns = config.min_task_age_ns;
    const std::vector<std::uint64_t> wanted = reference_run(config, kBatches);
    for (unsigned seed = 1; seed <= 20; ++seed) {
      config.audit_rate = seed % 2 == 0 ? 0.3 : 0.0;
      TaskBook book(config);
      book.announce_weights(0, hash_of_version(0));
      Storm storm(book, seed);
      std::vector<std::uint64_t> hashes;
      for (int i = 0; i < 200'000 && hashes.size() < kBatches; ++i) {
        storm.step();
        if (HasFatalFailure()) return;
        if (!book.batch_complete()) continue;
        hashes.push_back(content_hash(book.take_batch()));
        book.announce_weights(hashes.size(), hash_of_version(hashes.size()));
      }
      EXPECT_EQ(hashes, wanted) << "lead " << lead << " seed " << seed;
    }
  }
}

TEST(TaskBook, ResumeFromTheTableRepeatsTheSameTasksAndBatches) {
  constexpr int kBatches = 10;
  for (const std::uint32_t lead : {0u, 1u}) {
    TaskBookConfig config = small_config(lead);
    config.first_task_age_ns = config.min_task_age_ns;
    const std::vector<std::uint64_t> wanted = reference_run(config, kBatches);
    for (unsigned seed = 1; seed <= 10; ++seed) {
      auto book = std::make_unique<TaskBook>(config);
      book->announce_weights(0, hash_of_version(0));
      auto storm = std::make_unique<Storm>(*book, seed);
      SlotTable saved = book->table();
      std::vector<std::uint64_t> hashes;
      std::size_t hashes_saved = 0;
      for (int i = 1; i < 200'000 && hashes.size() < kBatches; ++i) {
        storm->step();
        if (HasFatalFailure()) return;
        if (book->batch_complete()) {
          hashes.push_back(content_hash(book->take_batch()));
          book->announce_weights(hashes.size(), hash_of_version(hashes.size()));
          if (hashes.size() % 2 == 0) {
            saved = book->table();
            hashes_saved = hashes.size();
          }
        }
        if (i % 400 != 0) continue;
        // The learner is killed and resumes from its last checkpoint.
        config.learner_epoch += 1;
        hashes.resize(hashes_saved);
        book = std::make_unique<TaskBook>(config, saved);
        const std::uint64_t batch = book->batch();
        if (batch > 0) book->announce_weights(batch - 1, hash_of_version(batch - 1));
        book->announce_weights(batch, hash_of_version(batch));
        storm = std::make_unique<Storm>(*book, seed + static_cast<unsigned>(i));
        expect_balance(*book);
      }
      EXPECT_EQ(hashes, wanted) << "lead " << lead << " seed " << seed;
    }
  }
}

TEST(TaskBook, AResultOfTheCrashedLearnerIsValidForTheResumedOne) {
  TaskBookConfig config = small_config(0);
  TaskBook before(config);
  before.worker_joined(1, 100);
  before.announce_weights(0, hash_of_version(0));
  const std::vector<RolloutTask> tasks = before.grant(0);
  config.learner_epoch = 2;
  TaskBook after(config, before.table());
  after.announce_weights(0, hash_of_version(0));
  EXPECT_EQ(after.receive(fake_rollout(tasks[1]), 1), Verdict::kAdmitted);
  expect_balance(after);
}

TEST(TaskBook, ATableThatDoesNotFitIsRefused) {
  TaskBook book(small_config(0));
  SlotTable table = book.table();
  table.slots.pop_back();
  EXPECT_THROW(TaskBook(small_config(0), table), Error);
  table = book.table();
  table.slots[0].segment = 3;
  EXPECT_THROW(TaskBook(small_config(0), table), Error);
}

}  // namespace
}  // namespace omentum
