#include "core/hash.h"

#include <gtest/gtest.h>

#include <set>
#include <vector>

namespace omentum {
namespace {

std::vector<std::byte> some_bytes(std::size_t size) {
  std::vector<std::byte> bytes(size);
  for (std::size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::byte>(i * 37 + 11);
  return bytes;
}

TEST(HashState, EveryBitAndEveryLengthCounts) {
  std::set<std::uint64_t> seen;
  std::size_t made = 0;
  for (std::size_t size = 0; size <= 100; ++size) {
    std::vector<std::byte> bytes = some_bytes(size);
    seen.insert(hash_state(bytes));
    ++made;
    for (std::size_t bit = 0; bit < 8 * size; ++bit) {
      bytes[bit / 8] ^= static_cast<std::byte>(1 << (bit % 8));
      seen.insert(hash_state(bytes));
      ++made;
      bytes[bit / 8] ^= static_cast<std::byte>(1 << (bit % 8));
    }
  }
  EXPECT_EQ(seen.size(), made);
  // Zeros at the end are not padding, and exchanged words are not equal.
  EXPECT_NE(hash_state(std::vector<std::byte>(31)), hash_state(std::vector<std::byte>(32)));
  std::vector<std::byte> bytes = some_bytes(64);
  const std::uint64_t before = hash_state(bytes);
  std::swap_ranges(bytes.begin(), bytes.begin() + 8, bytes.begin() + 32);
  EXPECT_NE(hash_state(bytes), before);
}

// Reaches wire and recordings. Pinned on x86-64, g++ 12.2, at the commit that introduced it.
TEST(HashState, IsPinned) {
  EXPECT_EQ(hash_state({}), 5733344002381794708u);
  EXPECT_EQ(hash_state(some_bytes(1000)), 5774148937474921402u);
}

}  // namespace
}  // namespace omentum
