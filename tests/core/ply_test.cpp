#include "core/ply.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace omentum {
namespace {

using Eigen::Vector3f;
using testing::HasSubstr;

const std::string kAscii =
    "ply\nformat ascii 1.0\nelement vertex 2\nproperty uchar red\nproperty double z\n"
    "property float x\nproperty float y\nelement face 1\nproperty list uchar int index\n"
    "end_header\n255 3 1 2\n0 0.25 -1e-3 7\n3 0 1 1\n";

TEST(Ply, ReadsBackWhatItWrites) {
  const std::vector<Vector3f> points = {{1, 2, 3}, {-0.5F, 1e-7F, 0}};
  const auto read = parse_ply("a.ply", encode_ply(points));
  ASSERT_TRUE(read) << read.error();
  EXPECT_EQ(read.value(), points);
}

TEST(Ply, TakesAnyOrderAndPassesOverTheRest) {
  const auto read = parse_ply("a.ply", kAscii);
  ASSERT_TRUE(read) << read.error();
  EXPECT_EQ(read.value(), (std::vector<Vector3f>{{1, 2, 3}, {-1e-3F, 7, 0.25F}}));
}

TEST(Ply, OfAFileCutAnywhereIsPointsOrOneLine) {
  const std::string binary = encode_ply({{1, 2, 3}, {4, 5, 6}});
  for (std::size_t size = 0; size < binary.size(); ++size) {
    const auto read = parse_ply("a.ply", binary.substr(0, size));
    ASSERT_FALSE(read) << size;
    EXPECT_THAT(read.error(), testing::StartsWith("a.ply: "));
  }
  for (std::size_t size = 0; size < kAscii.size(); ++size)
    (void)parse_ply("a.ply", kAscii.substr(0, size));
}

TEST(Ply, WhatCannotBeMeantIsRefused) {
  const auto refusal = [](const std::string& format, const std::string& count,
                          const std::string& last) {
    const auto read = parse_ply("a.ply", "ply\nformat " + format + " 1.0\nelement " + count +
                                             "\nproperty float x\nproperty float y\n" + last +
                                             "\nend_header\n1 2 nan\n");
    return read ? "taken" : read.error();
  };
  EXPECT_THAT(refusal("binary", "vertex 1", "property float z"), HasSubstr("none of"));
  EXPECT_THAT(refusal("ascii", "face 1", "property float z"), HasSubstr("first element"));
  EXPECT_THAT(refusal("ascii", "vertex 99999999999", "property float z"),
              HasSubstr("allowed up to"));
  EXPECT_THAT(refusal("ascii", "vertex 1", "property float w"), HasSubstr("no x, y or z"));
  EXPECT_THAT(refusal("ascii", "vertex 1", "property list uchar int z"), HasSubstr("no scalar"));
}

TEST(Ply, TheSamePointsStandInTheOtherOrderOfBytes) {
  const std::string head =
      " 1.0\nelement vertex 1\nproperty uchar red\nproperty float x\nproperty double y\n"
      "property short z\nend_header\n";
  // 7; 1.5F; -2.0; 258.
  const std::string values("\x07\x3f\xc0\x00\x00\xc0\x00\x00\x00\x00\x00\x00\x00\x01\x02", 15);
  const auto read = parse_ply("a.ply", "ply\nformat binary_big_endian" + head + values);
  ASSERT_TRUE(read) << read.error();
  EXPECT_EQ(read.value(), (std::vector<Vector3f>{{1.5F, -2, 258}}));
  EXPECT_FALSE(parse_ply("a.ply", "ply\nformat binary_big_endian" + head + values.substr(0, 14)));
}

TEST(Ply, PointsThatACameraDidNotSeeAreLeftOut) {
  const auto read = parse_ply("a.ply",
                              "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\n"
                              "property float y\nproperty float z\nend_header\n"
                              "nan nan nan\n1 2 3\n-nan(ind) inf 0\nNaN 1 2\n");
  ASSERT_TRUE(read) << read.error();
  EXPECT_EQ(read.value(), (std::vector<Vector3f>{{1, 2, 3}}));
  const float none = std::numeric_limits<float>::quiet_NaN();
  const auto binary = parse_ply("a.ply", encode_ply({{none, none, none}, {4, 5, 6}}));
  ASSERT_TRUE(binary) << binary.error();
  EXPECT_EQ(binary.value(), (std::vector<Vector3f>{{4, 5, 6}}));
  const auto nothing = parse_ply("a.ply", encode_ply({}));
  ASSERT_TRUE(nothing) << nothing.error() << ": a frame without points is one, too";
  EXPECT_TRUE(nothing.value().empty());
}

}  // namespace
}  // namespace omentum
