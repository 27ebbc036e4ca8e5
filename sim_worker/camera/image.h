#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace omentum {

/// Pixels of one byte per channel, top row first.
struct Image {
  int width = 0, height = 0;
  int channels = 0;                  ///< 3 = red, green, blue; 1 = object id
  std::vector<std::uint8_t> pixels;  ///< channels * (x + width * y)

  std::size_t offset(int x, int y) const { return channels * (x + width * y); }
};

/// PNG file content of an image of 1 (grey) or 3 channels.
std::string encode_png(const Image& image);

}  // namespace omentum
