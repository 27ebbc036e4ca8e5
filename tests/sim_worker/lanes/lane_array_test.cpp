#include "sim_worker/lanes/lane_array.h"

#include <gtest/gtest.h>

namespace omentum {
namespace {

using Eigen::Vector3d;

TEST(LaneArray, HasTheLaneFastestThenTheComponentThenTheItem) {
  LaneArray<float> array;
  const float* const data = array.assign(3, 4, 8, 0.5F);
  EXPECT_EQ(array.size(), 3U * 4 * 8);
  EXPECT_EQ(data, array.data());
  array(2, 1, 5) = 7;
  EXPECT_EQ(data[(2 * 4 + 1) * 8 + 5], 7);
  EXPECT_EQ(array(2, 0, 5), 0.5F);
  array(1, 3) = 9;  // the first component
  EXPECT_EQ(data[(1 * 4 + 0) * 8 + 3], 9);
}

TEST(LaneArray, VectorsAreTheFirstThreeComponentsOfAnItem) {
  LaneArray<double> array;
  array.assign(2, 4, 8);
  array.set_vector(1, 6, Vector3d(1, 2, 3));
  EXPECT_EQ(array.vector(1, 6), Vector3d(1, 2, 3));
  EXPECT_EQ(array(1, 3, 6), 0);
  EXPECT_EQ(array.vector(1, 5), Vector3d::Zero());
  EXPECT_EQ(array.vector(0, 6), Vector3d::Zero());
}

TEST(LaneArray, NumbersOfALaneAreItsItemsInOrderAndFillingItLeavesTheOthers) {
  LaneArray<float> array;
  array.assign(2, 3, 4);
  float next = 0;
  for (int item = 0; item < 2; ++item) {
    for (int k = 0; k < 3; ++k) array(item, k, 2) = ++next;
  }
  ASSERT_EQ(array.in_lane(), 6);
  for (int k = 0; k < 6; ++k) EXPECT_EQ(array.lane_value(k, 2), static_cast<float>(k + 1));
  array.fill_lane(1, 5);
  for (int k = 0; k < 6; ++k) {
    EXPECT_EQ(array.lane_value(k, 1), 5);
    EXPECT_EQ(array.lane_value(k, 2), static_cast<float>(k + 1));
    EXPECT_EQ(array.lane_value(k, 3), 0);
  }
}

TEST(LaneArray, EnsureKeepsWhatIsLargeEnough) {
  LaneArray<float> array;
  array.ensure(2, 3, 4, 1.5F);
  array(1, 2, 3) = 8;
  array.ensure(2, 3, 4, 1.5F);
  EXPECT_EQ(array(1, 2, 3), 8);
  array.ensure(3, 3, 4, 2.5F);
  EXPECT_EQ(array(2, 2, 3), 2.5F);
  EXPECT_EQ(LaneArray<float>().in_lane(), 0);
}

}  // namespace
}  // namespace omentum
