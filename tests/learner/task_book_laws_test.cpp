// What a batch contains depends neither on workers, order, loss and repetition nor on a learner
// that resumes.
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <random>

#include "core/check.h"
#include "core/hash.h"
#include "tests/learner/small_book.h"

namespace omentum {
namespace {

using test::expect_balance;
using test::fake_rollout;
using test::hash_of_version;
using test::small_config;

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

// A whole run of `batches` batches with one perfect worker; a hash of the content of each.
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
