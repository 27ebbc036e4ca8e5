#include "sim_worker/camera/image.h"

#include <png.h>

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

}  // namespace omentum
