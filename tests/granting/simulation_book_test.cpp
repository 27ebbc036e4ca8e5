// The book of simulations that others do, without a bus: pieces, second grants, duplicates, counts.
#include "granting/simulation_book.h"

#include <gtest/gtest.h>

#include <functional>
#include <utility>

#include "core/hash.h"

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;

Bytes some_bytes(std::size_t size, int seed) {
  Bytes bytes(size);
  for (std::size_t i = 0; i < size; ++i)
    bytes[i] = static_cast<std::byte>((i * 31 + static_cast<std::size_t>(seed)) % 251);
  return bytes;
}

/// What a worker sends back for a grant.
std::vector<SimulationPart> parts_of(const SimulationGrant& grant, const Bytes& result) {
  std::vector<SimulationPart> parts;
  for (std::uint32_t k = 0; k < count_parts(result.size()); ++k) {
    SimulationPart& part = parts.emplace_back();
    part.asker_id = grant.asker_id;
    part.task = grant.task;
    part.grant = grant.grant;
    part.worker_id = grant.worker_id;
    part.task_hash = grant.task_hash;
    part.part = k;
    part.parts = static_cast<std::uint32_t>(count_parts(result.size()));
    part.result_bytes = result.size();
    part.result_crc32c = crc32c(result);
    const auto begin = result.begin() + static_cast<std::ptrdiff_t>(k * kPartBytes);
    part.payload.assign(begin, begin + static_cast<std::ptrdiff_t>(size_of_part(result.size(), k)));
  }
  return parts;
}

class Book : public testing::Test {
 protected:
  void TearDown() override { EXPECT_TRUE(book_.balanced()); }
  void give(const SimulationGrant& grant, const Bytes& result) {
    for (SimulationPart& part : parts_of(grant, result)) book_.receive(std::move(part), now_);
  }
  std::vector<SimulationGrant> grant() { return book_.grant(now_); }

  SimulationBook book_{77, "test", 5};
  std::int64_t now_ = 1'000 * kS;
};

TEST_F(Book, AResultOfManyPiecesIsPutTogetherAsItWas) {
  book_.grants().worker_joined(1, 1);
  const std::uint32_t task = book_.ask(some_bytes(100, 1), 10);
  const std::vector<SimulationGrant> grants = grant();
  ASSERT_EQ(grants.size(), 1u);
  EXPECT_EQ(grants[0].payload, some_bytes(100, 1));
  EXPECT_EQ(grants[0].task_hash, hash_state(grants[0].payload));
  const Bytes result = some_bytes(2 * kPartBytes + 17, 2);
  give(grants[0], result);
  const std::vector<SimulationDone> done = book_.take_done();
  ASSERT_EQ(done.size(), 1u);
  EXPECT_EQ(done[0].task, task);
  EXPECT_TRUE(done[0].result == result);
  EXPECT_EQ(done[0].holders, std::vector<std::uint32_t>{1});
  EXPECT_EQ(book_.open(), 0u);
  EXPECT_EQ(book_.ledger().admitted, 1u);
}

TEST_F(Book, AWorkerGetsOneTaskToDoAndOneToWaitInTheOrderOfAsking) {
  book_.grants().worker_joined(1, 1);
  for (int k = 0; k < 4; ++k) book_.ask(some_bytes(10, k), 1);
  const std::vector<SimulationGrant> grants = grant();
  ASSERT_EQ(grants.size(), 2u);
  EXPECT_EQ(grants[0].task, 0u);
  EXPECT_EQ(grants[1].task, 1u);
  give(grants[0], some_bytes(5, 0));
  const std::vector<SimulationGrant> next = grant();
  ASSERT_EQ(next.size(), 1u);
  EXPECT_EQ(next[0].task, 2u);
}

TEST_F(Book, WhatAWorkerTookWithItIsGrantedAgain) {
  book_.grants().worker_joined(1, 1);
  book_.ask(some_bytes(10, 1), 1);
  const std::vector<SimulationGrant> first = grant();
  ASSERT_EQ(first.size(), 1u);
  std::vector<SimulationPart> parts = parts_of(first[0], some_bytes(kPartBytes + 1, 3));
  book_.receive(parts[0], now_);  // half of it
  book_.worker_left(1);
  book_.grants().worker_joined(2, 1);
  const std::vector<SimulationGrant> second = grant();
  ASSERT_EQ(second.size(), 1u);
  EXPECT_EQ(second[0].worker_id, 2u);
  give(second[0], some_bytes(kPartBytes + 1, 3));
  EXPECT_EQ(book_.take_done().size(), 1u);
  EXPECT_EQ(book_.ledger().regranted, 1u);
}

TEST_F(Book, PiecesThatDoNotFitTogetherAreRefusedAndTheTaskIsGrantedAgain) {
  const Bytes result = some_bytes(2 * kPartBytes + 1, 4);
  const auto spoilt = [&](const std::function<void(std::vector<SimulationPart>&)>& spoil) {
    SimulationBook book(77, "test", 5);
    book.grants().worker_joined(1, 1);
    book.ask(some_bytes(10, 1), 1);
    const std::vector<SimulationGrant> first = book.grant(now_);
    std::vector<SimulationPart> parts = parts_of(first[0], result);
    spoil(parts);
    for (SimulationPart& part : parts) book.receive(std::move(part), now_);
    EXPECT_TRUE(book.take_done().empty());
    EXPECT_GE(book.ledger().invalid, 1u);
    EXPECT_EQ(book.grant(now_).size(), 1u);
    EXPECT_TRUE(book.balanced());
    return book.last_refusal();
  };
  EXPECT_NE(spoilt([](auto& parts) { parts.erase(parts.begin() + 1); }), "");
  EXPECT_NE(spoilt([](auto& parts) { std::swap(parts[0], parts[1]); }), "");
  EXPECT_NE(spoilt([](auto& parts) { parts[1].payload[7] ^= std::byte{1}; }).find("CRC"),
            std::string::npos);
  EXPECT_NE(spoilt([](auto& parts) { parts[2].result_crc32c ^= 1; }), "");
  EXPECT_NE(spoilt([](auto& parts) { parts[1].grant = 9; }), "");
}

TEST_F(Book, ResultsThatNobodyWantsAreCountedAndDropped) {
  book_.grants().worker_joined(1, 1);
  book_.ask(some_bytes(10, 1), 1);
  const std::vector<SimulationGrant> grants = grant();
  const Bytes result = some_bytes(kPartBytes + 3, 1);
  give(grants[0], result);
  give(grants[0], result);  // once more
  EXPECT_EQ(book_.ledger().duplicate, 1u);
  EXPECT_EQ(book_.ledger().audit_mismatch, 0u);
  give(grants[0], some_bytes(kPartBytes + 3, 2));  // another answer to the same question
  EXPECT_EQ(book_.ledger().audit_mismatch, 1u);
  SimulationGrant never = grants[0];
  never.task = 99;
  give(never, result);
  SimulationGrant other = grants[0];
  other.task_hash ^= 1;
  give(other, result);
  EXPECT_EQ(book_.ledger().stale, 2u);
  book_.foreign(3);
  book_.refused(2);
  EXPECT_EQ(book_.take_done().size(), 1u);
  EXPECT_EQ(book_.ledger().received, 1u + 2u + 2u + 3u + 2u);
}

TEST_F(Book, AnIdleWorkerTakesWhatAnotherIsLateWithAndTheFirstResultCounts) {
  book_.grants().worker_joined(1, 1);
  for (int k = 0; k < 3; ++k) book_.ask(some_bytes(10, k), 10);
  std::vector<SimulationGrant> grants = grant();
  ASSERT_EQ(grants.size(), 2u);
  now_ += kS;
  give(grants[0], some_bytes(5, 0));  // what a task takes is known now
  const std::vector<SimulationGrant> third = grant();
  ASSERT_EQ(third.size(), 1u);
  book_.grants().worker_joined(2, 1);
  EXPECT_TRUE(grant().empty()) << "nobody is late";
  now_ += 10 * kS;
  const std::vector<SimulationGrant> again = grant();
  ASSERT_EQ(again.size(), 1u);
  EXPECT_EQ(again[0].worker_id, 2u);
  EXPECT_EQ(again[0].task, 1u);
  EXPECT_EQ(again[0].grant, 1u);
  give(again[0], some_bytes(5, 1));
  const std::vector<SimulationDone> done = book_.take_done();
  ASSERT_EQ(done.size(), 2u);
  EXPECT_EQ(done[1].holders, (std::vector<std::uint32_t>{1, 2})) << "the slow one is told as well";
  give(grants[1], some_bytes(5, 1));
  EXPECT_EQ(book_.ledger().duplicate, 1u);
}

TEST_F(Book, AWorkerThatDeclinesGetsNothingForAWhile) {
  book_.grants().worker_joined(1, 1);
  book_.ask(some_bytes(10, 1), 1);
  ASSERT_EQ(grant().size(), 1u);
  book_.grants().worker_declined(1, "another build", now_);
  EXPECT_TRUE(grant().empty());
  now_ += 11 * kS;
  EXPECT_EQ(grant().size(), 1u);
}

}  // namespace
}  // namespace omentum
