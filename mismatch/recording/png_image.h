#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// A PNG of one channel (grey) or three (red, green, blue) of 8 or 16 bits. `rows`: row by row,
/// each with a byte of 0 ("no filter") before it, numbers of 16 bits big-endian. `level` of zlib;
/// 0: the rows are stored as they are.
std::string encode_png(std::uint32_t width, std::uint32_t height, int bits, int channels,
                       const std::string& rows, int level);

/// Red, green, blue of 8 bits, row by row.
struct Picture {
  std::uint32_t width = 0, height = 0;
  std::vector<std::uint8_t> rgb;
};
/// Of any PNG of up to 64 million pixels. Total over any bytes; fails with one line that begins
/// with `name`.
Result<Picture> parse_picture(const std::string& name, std::string_view png);

}  // namespace omentum
