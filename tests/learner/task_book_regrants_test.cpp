// Tasks that are granted again or twice: of workers that left, decline or are slow, and for audits.
#include <gtest/gtest.h>

#include "tests/learner/small_book.h"

namespace omentum {
namespace {

using test::expect_balance;
using test::fake_rollout;
using test::hash_of_version;
using test::small_config;

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

}  // namespace
}  // namespace omentum
