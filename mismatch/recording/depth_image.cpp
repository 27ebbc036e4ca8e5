#include "mismatch/recording/depth_image.h"

#include <fmt/format.h>
#include <png.h>

#include <cmath>
#include <csetjmp>
#include <cstring>

#include "core/check.h"

namespace omentum {
namespace {

constexpr std::uint64_t kMostPixels = 64'000'000;

/// Bytes that libpng takes, and what it says of them.
struct Source {
  std::string_view rest;
  std::string error;
};

void take_bytes(png_structp png, png_bytep to, std::size_t size) {
  auto& source = *static_cast<Source*>(png_get_io_ptr(png));
  if (size > source.rest.size()) png_error(png, "the file ends too soon");
  std::memcpy(to, source.rest.data(), size);
  source.rest.remove_prefix(size);
}

[[noreturn]] void keep_error(png_structp png, png_const_charp text) {
  static_cast<Source*>(png_get_error_ptr(png))->error = text;
  std::longjmp(*png_set_longjmp_fn(png, std::longjmp, sizeof(std::jmp_buf)), 1);
}

void ignore_warning(png_structp, png_const_charp) {}

/// Nothing with a destructor may live across a jump of libpng: the image is the caller's.
bool decode(Source& source, DepthImage& image, png_bytep* rows) {
  png_structp png =
      png_create_read_struct(PNG_LIBPNG_VER_STRING, &source, keep_error, ignore_warning);
  png_infop info = png == nullptr ? nullptr : png_create_info_struct(png);
  if (info == nullptr) return false;
  if (setjmp(*png_set_longjmp_fn(png, std::longjmp, sizeof(std::jmp_buf))) != 0) {
    png_destroy_read_struct(&png, &info, nullptr);
    return false;
  }
  png_set_read_fn(png, &source, take_bytes);
  png_set_user_limits(png, image.width, image.height);
  png_read_info(png, info);
  png_set_swap(png);  // big-endian in the file
  png_set_interlace_handling(png);
  png_read_update_info(png, info);
  if (png_get_rowbytes(png, info) != 2 * std::size_t{image.width})
    png_error(png, "rows of another length");
  png_read_image(png, rows);
  png_destroy_read_struct(&png, &info, nullptr);
  return true;
}

std::uint32_t big_endian(std::string_view bytes) {
  std::uint32_t value = 0;
  for (const char c : bytes.substr(0, 4)) value = value << 8 | static_cast<unsigned char>(c);
  return value;
}

}  // namespace

Result<PngSize> parse_png_size(const std::string& name, std::string_view png) {
  constexpr std::string_view kMagic{"\x89PNG\r\n\x1a\n", 8};
  constexpr std::size_t kHeader = 8 + 8 + 13;
  if (!png.starts_with(kMagic) || png.size() < kHeader || png.substr(12, 4) != "IHDR")
    return Failure{fmt::format("{}: no PNG", name)};
  PngSize size;
  size.width = big_endian(png.substr(16));
  size.height = big_endian(png.substr(20));
  size.bits = static_cast<unsigned char>(png[24]);
  const int colour = static_cast<unsigned char>(png[25]);
  size.channels = colour == 2 ? 3 : colour == 4 ? 2 : colour == 6 ? 4 : 1;
  if (size.width == 0 || size.height == 0 || std::uint64_t{size.width} * size.height > kMostPixels)
    return Failure{fmt::format("{}: {} x {} pixels, allowed up to {} together", name, size.width,
                               size.height, kMostPixels)};
  return size;
}

Result<DepthImage> parse_depth_png(const std::string& name, std::string_view png) {
  const Result<PngSize> size = parse_png_size(name, png);
  if (!size) return Failure{size.error()};
  if (size.value().bits != 16 || size.value().channels != 1)
    return Failure{fmt::format("{}: {} channels of {} bits, needed one of 16", name,
                               size.value().channels, size.value().bits)};
  // No row packs to less than a thousandth of it: what a header claims must be in the file.
  const std::uint64_t pixels = std::uint64_t{size.value().width} * size.value().height;
  if (pixels / 2000 > png.size()) return Failure{fmt::format("{}: the file ends too soon", name)};
  DepthImage image{size.value().width, size.value().height, {}};
  image.depth.resize(pixels);
  std::vector<png_bytep> rows;
  for (std::uint32_t row = 0; row < image.height; ++row)
    rows.push_back(
        reinterpret_cast<png_bytep>(image.depth.data() + std::size_t{row} * image.width));
  Source source{png, {}};
  if (!decode(source, image, rows.data()))
    return Failure{fmt::format("{}: {}", name, source.error.empty() ? "no memory" : source.error)};
  return image;
}

std::string encode_depth_png(const DepthImage& image) {
  std::string png;
  const auto write = [](png_structp to, png_bytep bytes, std::size_t size) {
    static_cast<std::string*>(png_get_io_ptr(to))
        ->append(reinterpret_cast<const char*>(bytes), size);
  };
  png_structp out = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(out);
  OMENTUM_CHECK(out != nullptr && info != nullptr, "no memory for a PNG");
  png_set_write_fn(out, &png, write, nullptr);
  png_set_IHDR(out, info, image.width, image.height, 16, PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_write_info(out, info);
  png_set_swap(out);
  for (std::uint32_t row = 0; row < image.height; ++row)
    png_write_row(out, reinterpret_cast<png_const_bytep>(image.depth.data() +
                                                         std::size_t{row} * image.width));
  png_write_end(out, nullptr);
  png_destroy_write_struct(&out, &info);
  return png;
}

bool has_intrinsics(const pb::RecordingCamera& camera) {
  return camera.width() > 0 && camera.height() > 0 &&
         ((camera.fx() > 0 && camera.fy() > 0) || camera.vertical_fov_rad() > 0);
}

Cloud cloud_of_depth(const std::string& name, const DepthImage& image,
                     const pb::RecordingCamera& camera, double depth_unit_m) {
  if (!has_intrinsics(camera)) throw_error("{}: depth without intrinsics", name);
  if (camera.width() != image.width || camera.height() != image.height)
    throw_error("{}: {} x {} pixels, the camera has {} x {}", name, image.width, image.height,
                camera.width(), camera.height());
  if (camera.p_m_size() != 3 || camera.view_direction_size() != 3 || camera.up_size() != 3)
    throw_error("{}: camera needs p_m, view_direction and up of three numbers each", name);
  const Eigen::Map<const Eigen::Vector3d> p_WC(camera.p_m().data());
  const Eigen::Map<const Eigen::Vector3d> view(camera.view_direction().data());
  const Eigen::Map<const Eigen::Vector3d> up(camera.up().data());
  const Eigen::Vector3d right = view.cross(up);
  if (!(right.norm() > 1e-6 * view.norm() * up.norm()) || !(view.norm() > 0))
    throw_error("{}: the camera's view_direction and up are parallel or zero", name);
  Eigen::Matrix3d R_WC;  // OpenCV: x right, y down, z forward
  R_WC.col(0) = right.normalized();
  R_WC.col(2) = view.normalized();
  R_WC.col(1) = R_WC.col(2).cross(R_WC.col(0));
  double fx = camera.fx(), fy = camera.fy(), cx = camera.cx(), cy = camera.cy();
  if (!(fx > 0 && fy > 0)) {
    fx = fy = 0.5 * image.height / std::tan(0.5 * camera.vertical_fov_rad());
    cx = 0.5 * (image.width - 1.0);
    cy = 0.5 * (image.height - 1.0);
  }
  Cloud cloud;
  for (std::uint32_t v = 0; v < image.height; ++v) {
    for (std::uint32_t u = 0; u < image.width; ++u) {
      const std::uint16_t raw = image.depth[std::size_t{v} * image.width + u];
      if (raw == 0) continue;
      const double z = raw * depth_unit_m;
      const Eigen::Vector3d p_C((u - cx) / fx * z, (v - cy) / fy * z, z);
      cloud.emplace_back((p_WC + R_WC * p_C).cast<float>());
    }
  }
  return cloud;
}

Frames<Cloud> seen_clouds(const Recording& recording) {
  if (recording.clouds.size() > 0 || recording.depth.size() == 0) return recording.clouds;
  Frames<Cloud> clouds;
  clouds.time_ns = recording.depth.time_ns;
  clouds.number = recording.depth.number;
  clouds.fetch = [depth = recording.depth, camera = recording.info.camera(),
                  unit = recording.info.depth_unit_m()](std::size_t k) {
    const std::string name = fmt::format("/depth {}", k);
    Result<DepthImage> image = parse_depth_png(name, depth.fetch(k));
    if (!image) throw_error("{}", image.error());
    return cloud_of_depth(name, image.value(), camera, unit);
  };
  return clouds;
}

}  // namespace omentum
