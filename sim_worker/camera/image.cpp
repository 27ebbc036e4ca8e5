#include "sim_worker/camera/image.h"

#include <png.h>

#include <array>
#include <fstream>

#include "core/check.h"

namespace omentum {

std::string encode_png(const Image& image) {
  OMENTUM_CHECK(image.channels == 1 || image.channels == 3, "{} channels", image.channels);
  png_image header{};
  header.version = PNG_IMAGE_VERSION;
  header.width = static_cast<png_uint_32>(image.width);
  header.height = static_cast<png_uint_32>(image.height);
  header.format = image.channels == 3 ? PNG_FORMAT_RGB : PNG_FORMAT_GRAY;
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(header);
  std::string bytes(size, '\0');
  const int written =
      png_image_write_to_memory(&header, bytes.data(), &size, 0, image.pixels.data(), 0, nullptr);
  OMENTUM_CHECK(written != 0, "libpng: {}", header.message);
  bytes.resize(size);
  return bytes;
}

void write_png(const std::string& path, const Image& image) {
  const std::string bytes = encode_png(image);
  std::ofstream file(path, std::ios::binary);
  file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  file.close();
  if (!file) throw_error("{}: cannot be written", path);
}

Image colour_ids(const Image& ids) {
  OMENTUM_CHECK(ids.channels == 1, "{} channels", ids.channels);
  constexpr std::array<std::array<std::uint8_t, 3>, 8> kColours = {{{20, 22, 28},
                                                                    {120, 124, 130},
                                                                    {156, 62, 58},
                                                                    {60, 180, 90},
                                                                    {240, 206, 120},
                                                                    {90, 140, 230},
                                                                    {200, 90, 200},
                                                                    {255, 0, 0}}};
  Image image{ids.width, ids.height, 3, {}};
  for (const std::uint8_t id : ids.pixels) {
    const auto& colour = kColours[id < kColours.size() ? id : kColours.size() - 1];
    image.pixels.insert(image.pixels.end(), colour.begin(), colour.end());
  }
  return image;
}

}  // namespace omentum
