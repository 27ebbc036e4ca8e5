// When a participant joins anew, in made-up times.
#include "core/deafness.h"

#include <gtest/gtest.h>

namespace omentum {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr std::int64_t kBegin_ns = 1000 * kSecond_ns;

/// Nothing changes around it and nothing is late, unless the test says so.
struct Watched {
  explicit Watched(std::uint32_t id = 0) : deaf(id) { join(kBegin_ns); }

  void join(std::int64_t at_ns) {
    now_ns = at_ns;
    deaf.joined(at_ns);
  }
  void watch_until(std::int64_t end_ns) {
    while (now_ns < end_ns) {
      now_ns += kSecond_ns / 20;
      deaf.watch(now_ns, late_ns, [this] {
        ++looks;
        if (discovers) ++around.found;
        around.waited_for_core_ns += waits_ns;
        return around;
      });
    }
  }
  /// How long after joining it may join anew [s]; -1: not within 300 s.
  int patience_s() {
    for (int s = 1; s <= 300; ++s) {
      watch_until(deaf.joined_ns() + s * kSecond_ns);
      if (deaf.may_join_anew(now_ns)) return s;
    }
    return -1;
  }
  void join_anew_in_vain() {
    deaf.gives_up();
    join(now_ns);
  }

  Deafness deaf;
  Deafness::Around around;
  bool discovers = false;     ///< more at each look
  std::int64_t waits_ns = 0;  ///< its threads for a core, between two looks
  std::int64_t late_ns = 0;
  std::int64_t now_ns = 0;
  int looks = 0;
};

TEST(Deafness, WhoHasJustJoinedStaysForTwelveSeconds) { EXPECT_EQ(Watched().patience_s(), 12); }

TEST(Deafness, EachTimeInVainTakesTwiceAsLongUpToAMinute) {
  Watched w;
  w.deaf.heard(kBegin_ns);
  for (const int expected : {12, 24, 48, 60, 60}) {
    EXPECT_EQ(w.patience_s(), expected);
    w.deaf.heard(w.now_ns);
    w.join_anew_in_vain();
  }
  w.deaf.helped();
  w.join(w.now_ns);
  EXPECT_EQ(w.patience_s(), 12);
}

TEST(Deafness, WhoHasHeardNobodyForFiveMinutesTakesAMinuteAtOnce) {
  Watched w;
  w.deaf.heard(kBegin_ns);
  w.join(kBegin_ns + 300 * kSecond_ns);
  w.join_anew_in_vain();
  EXPECT_EQ(w.patience_s(), 60);
}

TEST(Deafness, WaitsUntilDiscoveryFindsNoMoreButNotForEver) {
  Watched w;
  w.discovers = true;
  w.watch_until(kBegin_ns + 30 * kSecond_ns);
  EXPECT_FALSE(w.deaf.may_join_anew(w.now_ns));
  w.discovers = false;
  w.watch_until(kBegin_ns + 31 * kSecond_ns);
  EXPECT_FALSE(w.deaf.may_join_anew(w.now_ns));
  w.watch_until(kBegin_ns + 33 * kSecond_ns);
  EXPECT_TRUE(w.deaf.may_join_anew(w.now_ns));
  w.join(w.now_ns);
  w.discovers = true;
  EXPECT_EQ(w.patience_s(), 90);
}

TEST(Deafness, WaitsWhileItsThreadsWaitForACore) {
  Watched w;
  w.waits_ns = kSecond_ns / 4;  // half of the time
  EXPECT_EQ(w.patience_s(), 90);
  w.join(w.now_ns);
  w.waits_ns = kSecond_ns / 10;
  EXPECT_EQ(w.patience_s(), 12);
}

TEST(Deafness, WaitsWhileItIsWokenLate) {
  Watched w;
  w.late_ns = kSecond_ns / 4;
  EXPECT_EQ(w.patience_s(), 90);
}

TEST(Deafness, WhereManyAreKnownEachTakesAnotherTime) {
  Watched early(0), late(63);
  early.around.known = late.around.known = 363;  // 33 workers
  EXPECT_EQ(early.patience_s(), 12);
  EXPECT_EQ(late.patience_s(), 27);
  early.around.known = late.around.known = 1'000'000;  // made up
  early.join(early.now_ns);
  late.join(late.now_ns);
  EXPECT_EQ(early.patience_s(), 12);
  EXPECT_EQ(late.patience_s(), 32);
}

TEST(Deafness, ASilenceIsTooLongAfterTwelveSeconds) {
  const Deafness deaf(0);
  EXPECT_FALSE(deaf.is_too_long(kBegin_ns, kBegin_ns + 12 * kSecond_ns));
  EXPECT_TRUE(deaf.is_too_long(kBegin_ns, kBegin_ns + 12 * kSecond_ns + 1));
  EXPECT_TRUE(deaf.is_too_long(deaf.heard_ns(), kBegin_ns)) << "never heard";
}

TEST(Deafness, LooksAroundTwiceASecondAtMost) {
  Watched w;
  w.watch_until(kBegin_ns + 10 * kSecond_ns);
  EXPECT_LE(w.looks, 21);
  EXPECT_GE(w.looks, 19);
}

TEST(Deafness, TheKernelTellsHowLongThreadsWaitedForACore) { EXPECT_GE(waited_for_core_ns(), 0); }

}  // namespace
}  // namespace omentum
