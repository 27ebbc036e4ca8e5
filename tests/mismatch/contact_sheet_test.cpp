// A contact sheet shows what is there, and PNG that are written are read back.
#include "mismatch/intake/contact_sheet.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "mismatch/intake/canvas.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/png_image.h"

namespace omentum {
namespace {

std::size_t pixels_of(const Picture& picture, Colour colour) {
  std::size_t count = 0;
  for (std::size_t k = 0; k < picture.rgb.size(); k += 3) {
    count += picture.rgb[k] == colour[0] && picture.rgb[k + 1] == colour[1] &&
             picture.rgb[k + 2] == colour[2];
  }
  return count;
}

TEST(PngImage, WhatIsWrittenIsReadBackAtEveryLevel) {
  for (const int level : {0, 6}) {
    const std::string rows("\0abcdef\0ghijkl", 14);
    const auto colour = parse_picture("test", encode_png(2, 2, 8, 3, rows, level));
    ASSERT_TRUE(colour.has_value()) << colour.error();
    EXPECT_EQ(std::string(colour.value().rgb.begin(), colour.value().rgb.end()), "abcdefghijkl");
    const auto grey = parse_picture("test", encode_png(3, 1, 8, 1, std::string("\0xyz", 4), level));
    EXPECT_EQ(std::string(grey.value().rgb.begin(), grey.value().rgb.end()), "xxxyyyzzz");
  }
  EXPECT_FALSE(parse_picture("test", "no picture").has_value());
}

TEST(Canvas, DrawsInsideAndLeavesOutTheRest) {
  Canvas canvas(40, 30, {0, 0, 0});
  constexpr Colour kRed = {255, 0, 0};
  canvas.line(-100, 5, 100, 5, kRed);
  canvas.text(-3, 28, "8", kRed);
  canvas.box(39, 29, 10, 10, kRed);
  const Picture picture = parse_picture("test", canvas.png()).value();
  EXPECT_GE(pixels_of(picture, kRed), 40);
  EXPECT_LE(pixels_of(picture, kRed), 50);
  canvas.line(std::nan(""), 0, 1, 1, kRed);
  canvas.line(0, 0, 1e300, 1, kRed);
}

TEST(ContactSheet, GrowsWithWhatThereIs) {
  Recording recording;
  const auto height = [&] {
    const Result<Picture> picture = parse_picture("test", make_contact_sheet(recording));
    EXPECT_TRUE(picture.has_value()) << picture.error();
    return picture.value().height;
  };
  Series& tool = recording.series["tool"];
  tool.columns = {"tip_measured_x_m", "tip_measured_y_m", "tip_measured_z_m"};
  for (int k = 0; k < 50; ++k) {
    tool.time_ns.push_back(k * 20'000'000);
    tool.values.insert(tool.values.end(),
                       {0.001 * k, std::sin(0.1 * k), k % 7 == 0 ? std::nan("") : 1.0});
  }
  const auto curves = height();
  recording.clouds.time_ns = {0, 1'000'000'000};
  recording.clouds.number = {0, 1};
  recording.clouds.fetch = [](std::size_t k) {
    return k == 0 ? Cloud() : Cloud{{0, 0, 0.01F}, {0.1F, 0.05F, 0}};
  };
  const auto clouds = height();
  EXPECT_GT(clouds, curves);
  recording.depth.time_ns = {0};
  recording.depth.number = {0};
  recording.depth.fetch = [](std::size_t) {
    return encode_depth_png({3, 2, {0, 400, 500, 600, 700, 800}});
  };
  recording.color.time_ns = {5};
  recording.color.number = {0};
  recording.color.fetch = [](std::size_t) {
    return encode_png(1, 1, 8, 3, std::string("\0\xff\x01\x02", 4), 0);
  };
  EXPECT_GT(height(), clouds);
  const Picture sheet = parse_picture("test", make_contact_sheet(recording)).value();
  EXPECT_GT(pixels_of(sheet, {255, 1, 2}), 1000) << "the colour picture fills its box";
}

}  // namespace
}  // namespace omentum
