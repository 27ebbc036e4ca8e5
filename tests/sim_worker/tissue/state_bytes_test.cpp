#include "sim_worker/tissue/state_bytes.h"

#include <gtest/gtest.h>

#include <array>
#include <limits>

namespace omentum {
namespace {

TEST(StateBytes, AreReadAsTheyWereWritten) {
  Bytes bytes;
  StateWriter writer(bytes);
  LaneArray<float> array;
  array.assign(2, 2, 4);
  for (int k = 0; k < 4; ++k) array.lane_value(k, 3) = static_cast<float>(k) + 0.5F;
  const std::array<std::int32_t, 3> nodes = {4, 7, 9};
  writer.add(2.25);
  writer.add_lane(array, 3);
  writer.add_all(std::span<const std::int32_t>(nodes));
  EXPECT_EQ(bytes.size(), sizeof(double) + 4 * sizeof(float) + sizeof nodes);

  StateReader reader(bytes);
  double number = 0;
  std::array<float, 4> lane{};
  std::array<std::int32_t, 3> read{};
  ASSERT_TRUE(reader.read(number) && reader.read_all(std::span(lane)));
  EXPECT_EQ(reader.used(), sizeof(double) + sizeof lane);
  ASSERT_TRUE(reader.read_all(std::span(read)));
  EXPECT_EQ(number, 2.25);
  EXPECT_EQ(lane, (std::array<float, 4>{0.5F, 1.5F, 2.5F, 3.5F}));
  EXPECT_EQ(read, nodes);
  EXPECT_EQ(reader.used(), bytes.size());
}

TEST(StateBytes, EveryPrefixEndsWithoutReadingPastIt) {
  Bytes bytes;
  StateWriter writer(bytes);
  writer.add(std::uint32_t{3});
  writer.add(1.5);
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    StateReader reader({bytes.data(), size});
    std::uint32_t count = 0;
    double number = 0;
    EXPECT_FALSE(reader.read(count) && reader.read(number)) << size;
    EXPECT_EQ(reader.used(), size < sizeof count ? 0 : sizeof count) << size;
    EXPECT_EQ(number, 0) << size;
  }
}

TEST(StateBytes, ACountThatNoMemoryHoldsIsNotThere) {
  const Bytes bytes(64);
  const StateReader reader(bytes);
  EXPECT_TRUE(reader.has(16, sizeof(float)));
  EXPECT_FALSE(reader.has(17, sizeof(float)));
  EXPECT_FALSE(reader.has(std::numeric_limits<std::size_t>::max(), sizeof(double)));
}

TEST(StateBytes, NumbersThatAreNoneAreFound) {
  std::array<float, 3> values = {1, 2, 3};
  EXPECT_TRUE(all_finite(std::span<const float>(values)));
  for (const float bad : {std::numeric_limits<float>::infinity(), std::nanf("")}) {
    values[2] = bad;
    EXPECT_FALSE(all_finite(std::span<const float>(values)));
  }
}

}  // namespace
}  // namespace omentum
