#include "core/alarms.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "core/heartbeat.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using Texts = std::vector<std::string>;

TEST(Alarms, OneThatHoldsIsToldOnceAndListedUntilItEnds) {
  Alarms alarms;
  alarms.set("ring", false, "");
  EXPECT_EQ(alarms.raised(), 0u);
  alarms.set("ring", true, "49 of 64");
  alarms.set("ring", true, "50 of 64");
  alarms.set("buffers", true, "small");
  EXPECT_EQ(alarms.raised(), 2u);
  EXPECT_EQ(alarms.texts(), (Texts{"buffers: small", "ring: 50 of 64"}));
  alarms.set("ring", false, "");
  EXPECT_EQ(alarms.texts(), (Texts{"buffers: small"}));
  alarms.set("ring", true, "51 of 64");
  EXPECT_EQ(alarms.raised(), 3u);
}

TEST(Alarms, AtMostSixteenTravel) {
  Alarms alarms;
  for (int i = 0; i < 20; ++i) alarms.set(std::to_string(i), true, "x");
  EXPECT_EQ(alarms.texts().size(), 16u);
  EXPECT_EQ(alarms.raised(), 20u);
}

TEST(Heartbeat, TouchesItsFileOnceASecondAndLivesWithoutOne) {
  const test::TempDir folder;
  const std::string file = folder / "beat";
  Heartbeat heartbeat(file);
  heartbeat.beat(5);
  ASSERT_TRUE(std::filesystem::exists(file));
  std::filesystem::remove(file);
  heartbeat.beat(999'000'000);
  EXPECT_FALSE(std::filesystem::exists(file));
  heartbeat.beat(1'000'000'005);
  EXPECT_TRUE(std::filesystem::exists(file));
  Heartbeat(folder / "no/such/folder").beat(5);
  Heartbeat("").beat(5);
}

}  // namespace
}  // namespace omentum
