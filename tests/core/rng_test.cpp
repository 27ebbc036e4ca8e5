#include "core/rng.h"

#include <gtest/gtest.h>

namespace omentum {
namespace {

// Known-answer vectors of [Salmon11], docs/learner.md 3.2.
TEST(Philox, KnownAnswers) {
  EXPECT_EQ(philox({0, 0, 0, 0}, {0, 0}),
            (PhiloxWords{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  EXPECT_EQ(philox({~0u, ~0u, ~0u, ~0u}, {~0u, ~0u}),
            (PhiloxWords{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}),
            (PhiloxWords{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(RandomWords, CounterLayoutIsSlotPurposeEpisodeStep) {
  EXPECT_EQ(random_words(0x0000000200000001ull, 7, Purpose::kShuffle, 3, 0x1'0000'0009ull, 11),
            philox({7, (5u << 24) + 3, 9, 11}, {1, 2}));
}

TEST(Uniform24, IsExactAndBelowOne) {
  EXPECT_EQ(uniform_24(0), 0.0F);
  EXPECT_EQ(uniform_24(0xFF), 0.0F);
  EXPECT_EQ(uniform_24(0x100), 0x1p-24F);
  EXPECT_EQ(uniform_24(0xFFFFFFFF), 1.0F - 0x1p-24F);
}

TEST(Bounded, CoversTheRange) {
  EXPECT_EQ(bounded(0, 10), 0u);
  EXPECT_EQ(bounded(0xFFFFFFFF, 10), 9u);
}

}  // namespace
}  // namespace omentum
