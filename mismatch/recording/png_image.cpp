#include "mismatch/recording/png_image.h"

#include <fmt/format.h>
#include <png.h>
#include <zlib.h>

#include "core/check.h"
#include "mismatch/recording/depth_image.h"

namespace omentum {
namespace {

void put_big_endian(std::string& out, std::uint32_t value) {
  for (const int shift : {24, 16, 8, 0}) out.push_back(static_cast<char>(value >> shift & 0xff));
}

void put_chunk(std::string& png, const char* kind, std::string_view content) {
  put_big_endian(png, static_cast<std::uint32_t>(content.size()));
  const std::size_t begin = png.size();
  png.append(kind).append(content);
  const auto* bytes = reinterpret_cast<const Bytef*>(png.data() + begin);
  put_big_endian(png, static_cast<std::uint32_t>(crc32_z(0, bytes, png.size() - begin)));
}

}  // namespace

std::string encode_png(std::uint32_t width, std::uint32_t height, int bits, int channels,
                       const std::string& rows, int level) {
  const std::size_t row = 1 + std::size_t{width} * static_cast<std::size_t>(channels * bits / 8);
  OMENTUM_CHECK((channels == 1 || channels == 3) && rows.size() == row * height, "{} bytes",
                rows.size());
  std::string png("\x89PNG\r\n\x1a\n", 8), head;
  put_big_endian(head, width);
  put_big_endian(head, height);
  for (const int byte : {bits, channels == 3 ? 2 : 0, 0, 0, 0})
    head.push_back(static_cast<char>(byte));
  uLongf size = compressBound(rows.size());
  std::string packed(size, '\0');
  const int done = compress2(reinterpret_cast<Bytef*>(packed.data()), &size,
                             reinterpret_cast<const Bytef*>(rows.data()), rows.size(), level);
  OMENTUM_CHECK(done == Z_OK, "zlib: {}", done);
  packed.resize(size);
  png.reserve(packed.size() + 60);
  put_chunk(png, "IHDR", head);
  put_chunk(png, "IDAT", packed);
  put_chunk(png, "IEND", "");
  return png;
}

Result<Picture> parse_picture(const std::string& name, std::string_view png) {
  const Result<PngSize> size = parse_png_size(name, png);
  if (!size) return Failure{size.error()};
  // No row packs to less than a thousandth of it: what a header claims must be in the file.
  if (std::uint64_t{size.value().width} * size.value().height / 8000 > png.size())
    return Failure{fmt::format("{}: the file ends too soon", name)};
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  Picture picture;
  if (png_image_begin_read_from_memory(&image, png.data(), png.size()) != 0) {
    image.format = PNG_FORMAT_RGB;
    picture.width = image.width;
    picture.height = image.height;
    picture.rgb.resize(PNG_IMAGE_SIZE(image));
    png_color behind{0, 0, 0};
    png_image_finish_read(&image, &behind, picture.rgb.data(), 0, nullptr);
  }
  const bool failed = PNG_IMAGE_FAILED(image);
  const std::string error = image.message;
  png_image_free(&image);
  if (failed) return Failure{fmt::format("{}: {}", name, error)};
  return picture;
}

}  // namespace omentum
