#include "mismatch/ros/images.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

#include "core/check.h"
#include "core/table.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/png_image.h"

namespace omentum {
namespace {

constexpr double kMostPixels = 64e6;
/// compressedDepth: kind, then two numbers of inverted depth.
constexpr std::size_t kDepthHeader = 12;

std::uint32_t whole(const RosValue& message, std::string_view path, double most) {
  const double value = message.number_at(path);
  if (!(value >= 0 && value <= most))
    throw_error("{} of {}: {}, allowed 0 ... {}", path, message.message->name, value, most);
  return static_cast<std::uint32_t>(value);
}

std::size_t bytes_per_pixel(std::string_view encoding) {
  if (encoding == "32FC1" || encoding == "rgba8" || encoding == "bgra8") return 4;
  if (encoding == "rgb8" || encoding == "bgr8") return 3;
  return encoding == "mono8" || encoding == "8UC1" ? 1 : 2;
}

std::uint16_t steps_of(double metres, double unit_m) {
  const double steps = std::round(metres / unit_m);
  return steps >= 1 && steps <= 65535 ? static_cast<std::uint16_t>(steps) : std::uint16_t{0};
}

float float_at(const char* bytes, bool big_endian) {
  std::array<char, 4> raw;
  std::memcpy(raw.data(), bytes, 4);
  if (big_endian) std::reverse(raw.begin(), raw.end());
  float value = 0;
  std::memcpy(&value, raw.data(), 4);
  return value;
}

std::string_view packed_bytes(const RosValue& message) { return message.numbers_at("data").bytes; }

constexpr std::string_view kPngMagic{"\x89PNG\r\n\x1a\n", 8};

}  // namespace

bool is_depth_encoding(std::string_view encoding) {
  return encoding == "16UC1" || encoding == "mono16" || encoding == "32FC1";
}

bool is_color_encoding(std::string_view encoding) {
  return encoding == "rgb8" || encoding == "bgr8" || encoding == "rgba8" || encoding == "bgra8" ||
         encoding == "mono8" || encoding == "8UC1";
}

RosImage ros_image(const RosValue& message) {
  RosImage image;
  image.width = whole(message, "width", kMostPixels);
  image.height = whole(message, "height", kMostPixels);
  image.step = whole(message, "step", 1e9);
  image.encoding = message.text_at("encoding");
  image.big_endian = message.number_at("is_bigendian") != 0;
  image.data = message.numbers_at("data").bytes;
  const std::uint64_t pixels = std::uint64_t{image.width} * image.height;
  if (pixels == 0 || static_cast<double>(pixels) > kMostPixels)
    throw_error("{} x {} pixels, allowed up to {} together", image.width, image.height,
                kMostPixels);
  if (!is_depth_encoding(image.encoding) && !is_color_encoding(image.encoding)) return image;
  if (image.step < image.width * bytes_per_pixel(image.encoding) ||
      image.data.size() < std::uint64_t{image.step} * image.height)
    throw_error("{} x {} pixels {} in {} bytes, rows of {}", image.width, image.height,
                image.encoding, image.data.size(), image.step);
  return image;
}

std::string depth_png(const RosImage& image, double unit_m) {
  if (!is_depth_encoding(image.encoding))
    throw_error("encoding {}, needed 16UC1, mono16 or 32FC1 for depth", shown(image.encoding));
  const bool metres = image.encoding == "32FC1";
  const std::size_t line = 1 + 2 * std::size_t{image.width};
  std::string rows(line * image.height, '\0');
  for (std::uint32_t v = 0; v < image.height; ++v) {
    const char* from = image.data.data() + v * image.step;
    char* to = rows.data() + v * line + 1;
    // Big-endian in the file.
    if (metres) {
      for (std::uint32_t u = 0; u < image.width; ++u) {
        const std::uint16_t steps =
            steps_of(double{float_at(from + 4 * std::size_t{u}, image.big_endian)}, unit_m);
        to[2 * u] = static_cast<char>(steps >> 8);
        to[2 * u + 1] = static_cast<char>(steps & 0xff);
      }
    } else if (image.big_endian) {
      std::memcpy(to, from, 2 * std::size_t{image.width});
    } else {
      for (std::uint32_t u = 0; u < image.width; ++u) {
        to[2 * u] = from[2 * u + 1];
        to[2 * u + 1] = from[2 * u];
      }
    }
  }
  // Stored: chunks of the recording pack them together.
  return encode_png(image.width, image.height, 16, 1, rows, 0);
}

std::string color_png(const RosImage& image) {
  if (!is_color_encoding(image.encoding))
    throw_error("encoding {}, needed rgb8, bgr8, rgba8, bgra8 or mono8 for colour",
                shown(image.encoding));
  const std::size_t pixel = bytes_per_pixel(image.encoding), kept = pixel == 1 ? 1 : 3;
  const bool turned = image.encoding.starts_with("bgr");
  const std::size_t line = 1 + kept * image.width;
  std::string rows(line * image.height, '\0');
  for (std::uint32_t v = 0; v < image.height; ++v) {
    const char* from = image.data.data() + v * image.step;
    char* to = rows.data() + v * line + 1;
    for (std::uint32_t u = 0; u < image.width; ++u) {
      for (std::size_t k = 0; k < kept; ++k)
        to[kept * u + k] = from[pixel * u + (turned ? kept - 1 - k : k)];
    }
  }
  return encode_png(image.width, image.height, 8, static_cast<int>(kept), rows, 0);
}

PackedImage packed_image(const RosValue& message) {
  const std::string_view format = message.text_at("format"), data = packed_bytes(message);
  if (format.find("compressedDepth") != std::string_view::npos) {
    if (data.size() < kDepthHeader || !data.substr(kDepthHeader).starts_with(kPngMagic))
      return PackedImage::kOther;
    return format.starts_with("32FC1") ? PackedImage::kDepthInvertedPng : PackedImage::kDepthPng;
  }
  if (data.starts_with(kPngMagic)) {
    const Result<PngSize> size = parse_png_size("picture", data);
    if (!size) throw_error("{}", size.error());
    const bool depth = size.value().bits == 16 && size.value().channels == 1;
    if (depth) return PackedImage::kDepthPng;
    // "16UC1; png compressed " as image_transport writes it: what was packed, then how.
    const std::string_view packed_from = format.substr(0, format.find(';'));
    const bool cut = is_depth_encoding(packed_from) && packed_from != format;
    return cut ? PackedImage::kDepthCut : PackedImage::kColorPng;
  }
  return data.starts_with("\xff\xd8") ? PackedImage::kJpeg : PackedImage::kOther;
}

std::string_view packed_png(const RosValue& message) {
  const std::string_view data = packed_bytes(message);
  return data.starts_with(kPngMagic) ? data : data.substr(std::min(kDepthHeader, data.size()));
}

std::string unpacked_depth_png(const RosValue& message, double unit_m) {
  const PackedImage kind = packed_image(message);
  const std::string_view data = packed_bytes(message);
  if (kind != PackedImage::kDepthPng && kind != PackedImage::kDepthInvertedPng)
    throw_error("format {}, needed png or compressedDepth png of 16 bits",
                shown(message.text_at("format")));
  const std::string_view png = packed_png(message);
  Result<DepthImage> packed = parse_depth_png("compressedDepth", png);
  if (!packed) throw_error("{}", packed.error());
  if (kind == PackedImage::kDepthPng) return std::string(png);
  // depth = a / (stored - b), in m.
  const double a = double{float_at(data.data() + 4, false)};
  const double b = double{float_at(data.data() + 8, false)};
  const DepthImage& image = packed.value();
  std::string bytes(image.depth.size() * 2, '\0');
  for (std::size_t k = 0; k < image.depth.size(); ++k) {
    const std::uint16_t steps =
        image.depth[k] == 0 ? std::uint16_t{0} : steps_of(a / (image.depth[k] - b), unit_m);
    std::memcpy(bytes.data() + 2 * k, &steps, 2);
  }
  return depth_png({image.width, image.height, 2 * std::size_t{image.width}, "16UC1", bytes}, 1);
}

std::string packed_color_png(const RosValue& message) {
  if (packed_image(message) != PackedImage::kColorPng)
    throw_error("format {}, needed png", shown(message.text_at("format")));
  return std::string(packed_bytes(message));
}

namespace {

/// Where the numbers of a cloud lie.
struct CloudLayout {
  struct Axis {
    std::size_t offset = 0;
    bool wide = false;
  };
  std::array<Axis, 3> axes;
  std::size_t width = 0, height = 0, point = 0, row = 0;
  bool swapped = false;
  std::string_view data;
  std::string told;  ///< what is taken other than it is stated
};

CloudLayout cloud_layout(const RosValue& message) {
  constexpr int kFloat32 = 7, kFloat64 = 8;  // of sensor_msgs/PointField
  using Axis = CloudLayout::Axis;
  std::array<std::optional<Axis>, 3> axes;
  const std::size_t point = whole(message, "point_step", 1e6);
  std::size_t row = whole(message, "row_step", 4e9);
  const std::size_t width = whole(message, "width", 4e9), height = whole(message, "height", 4e9);
  const std::string_view data = message.numbers_at("data").bytes;
  CloudLayout layout;
  for (const RosValue& field : message.get("fields").items) {
    const std::string_view name = field.text_at("name");
    const std::size_t axis = name.size() == 1 ? std::string_view("xyz").find(name) : 3;
    if (axis > 2) continue;
    const double type = field.number_at("datatype");
    if (type != kFloat32 && type != kFloat64)
      throw_error("{} of the cloud is no FLOAT32 or FLOAT64", name);
    axes[axis] = {whole(field, "offset", 1e6), type == kFloat64};
    if (axes[axis]->offset + (axes[axis]->wide ? 8 : 4) > point)
      throw_error("{} of the cloud lies behind its point", name);
  }
  if (!axes[0] || !axes[1] || !axes[2]) throw_error("a cloud without x, y or z");
  layout.axes = {*axes[0], *axes[1], *axes[2]};
  layout.swapped = message.number_at("is_bigendian") != 0;
  layout.point = point;
  layout.data = data;
  if (width == 0 || height == 0) return layout;
  const bool fits = width <= data.size() / point && (height == 1 || row >= width * point) &&
                    (height - 1) <= (data.size() - width * point) / std::max<std::size_t>(row, 1);
  if (!fits) {
    // Some drivers state the bytes of all rows as those of one: the points still lie one behind the
    // other.
    const bool dense = width <= data.size() / point && height == data.size() / (width * point) &&
                       data.size() % (width * point) == 0;
    if (!dense)
      throw_error("a cloud of {} x {} points of {} bytes in {}, row_step {}", width, height, point,
                  data.size(), row);
    layout.told = fmt::format(
        "row_step {} is not that of {} points of {} bytes: rows are taken to lie one behind the "
        "other",
        row, width, point);
    row = width * point;
  }
  layout.width = width;
  layout.height = height;
  layout.row = row;
  return layout;
}

}  // namespace

void check_ros_cloud(const RosValue& message, std::string& told) {
  told = cloud_layout(message).told;
}

Cloud ros_cloud(const RosValue& message, const Eigen::Isometry3d& X_WF) {
  const CloudLayout layout = cloud_layout(message);
  const std::size_t width = layout.width, height = layout.height;
  if (width == 0 || height == 0) return {};
  const std::string_view data = layout.data;
  const bool moved = !X_WF.matrix().isIdentity(0);
  Cloud cloud;
  cloud.reserve(width * height);
  RosValue number;
  number.kind = RosValue::kNumbers;
  number.swapped = layout.swapped;
  for (std::size_t v = 0; v < height; ++v) {
    for (std::size_t u = 0; u < width; ++u) {
      Eigen::Vector3d p;
      for (Eigen::Index k = 0; k < 3; ++k) {
        const CloudLayout::Axis& axis = layout.axes[static_cast<std::size_t>(k)];
        number.type = axis.wide ? RosNumber::kFloat64 : RosNumber::kFloat32;
        number.bytes =
            data.substr(v * layout.row + u * layout.point + axis.offset, axis.wide ? 8 : 4);
        p[k] = number.at(0);
      }
      if (moved) p = X_WF * p;
      const Eigen::Vector3f seen = p.cast<float>();
      if (seen.allFinite()) cloud.push_back(seen);
    }
  }
  return cloud;
}

namespace {

/// fx, fy, cx, cy at these places of a row of numbers; false where they are no pinhole.
bool set_pinhole(const RosValue& numbers, const std::array<std::size_t, 4>& at,
                 pb::RecordingCamera& camera) {
  std::array<double, 4> found{};
  for (std::size_t k = 0; k < 4; ++k) {
    if (at[k] >= numbers.size() || !std::isfinite(numbers.at(at[k]))) return false;
    found[k] = numbers.at(at[k]);
  }
  if (!(found[0] > 0 && found[1] > 0)) return false;
  camera.set_fx(found[0]);
  camera.set_fy(found[1]);
  camera.set_cx(found[2]);
  camera.set_cy(found[3]);
  return true;
}

/// A whole number that a definition may lack; 0 without it.
double field_of(const RosValue& message, std::string_view name) {
  const RosValue* found = message.find(name);
  return found != nullptr && found->kind == RosValue::kNumber && std::isfinite(found->number)
             ? found->number
             : 0;
}

bool differ(const pb::RecordingCamera& a, const pb::RecordingCamera& b) {
  const double most = 1e-6 * std::max(a.fx(), b.fx());
  return std::fabs(a.fx() - b.fx()) > most || std::fabs(a.fy() - b.fy()) > most ||
         std::fabs(a.cx() - b.cx()) > most || std::fabs(a.cy() - b.cy()) > most;
}

}  // namespace

RosCamera ros_camera(const RosValue& message) {
  // Capitals in ROS 1.
  const bool capitals = message.find("K") != nullptr;
  RosCamera camera;
  const RosValue& K = message.numbers_at(capitals ? "K" : "k");
  if (K.size() != 9) throw_error("{} numbers of K, needed 9", K.size());
  set_pinhole(K, {0, 4, 2, 5}, camera.raw);
  const RosValue* P = message.find(capitals ? "P" : "p");
  if (P != nullptr && P->kind == RosValue::kNumbers && P->size() == 12)
    set_pinhole(*P, {0, 5, 2, 6}, camera.rectified);
  if (!camera.calibrated()) throw_error("K and P of the camera are zero: it was not calibrated");
  std::uint32_t width = whole(message, "width", kMostPixels);
  std::uint32_t height = whole(message, "height", kMostPixels);
  // The numbers are those of the whole sensor: first the crop, then the binning.
  double left = 0, top = 0;
  if (const RosValue* roi = message.find("roi"); roi != nullptr) {
    const double wide = field_of(*roi, "width"), high = field_of(*roi, "height");
    if (wide > 0 && high > 0) {
      left = field_of(*roi, "x_offset");
      top = field_of(*roi, "y_offset");
      if (left + wide > width || top + high > height)
        throw_error("a crop of {} x {} at {}, {} of {} x {} pixels", wide, high, left, top, width,
                    height);
      if (wide < width || high < height)
        camera.told = fmt::format("a crop of {} x {} at {}, {}", wide, high, left, top);
      width = static_cast<std::uint32_t>(wide);
      height = static_cast<std::uint32_t>(high);
    }
  }
  const double across = std::clamp(field_of(message, "binning_x"), 1.0, 1e6);
  const double down = std::clamp(field_of(message, "binning_y"), 1.0, 1e6);
  if (across > 1 || down > 1)
    camera.told += fmt::format("{}binning {} x {}", camera.told.empty() ? "" : ", ", across, down);
  for (pb::RecordingCamera* pinhole : {&camera.raw, &camera.rectified}) {
    pinhole->set_width(static_cast<std::uint32_t>(width / across));
    pinhole->set_height(static_cast<std::uint32_t>(height / down));
    if (!(pinhole->fx() > 0)) continue;
    pinhole->set_fx(pinhole->fx() / across);
    pinhole->set_fy(pinhole->fy() / down);
    pinhole->set_cx((pinhole->cx() - left) / across);
    pinhole->set_cy((pinhole->cy() - top) / down);
  }
  const RosValue* d = message.find(capitals ? "D" : "d");
  for (std::size_t k = 0; d != nullptr && d->kind == RosValue::kNumbers && k < d->size(); ++k)
    camera.distorted = camera.distorted || d->at(k) != 0;
  return camera;
}

const pb::RecordingCamera& pinhole_for(const RosCamera& camera, const std::string& topic,
                                       std::string& told) {
  if (!(camera.rectified.fx() > 0)) return camera.raw;
  if (!(camera.raw.fx() > 0)) {
    told = "K is zero: the numbers of P are taken";
    return camera.rectified;
  }
  if (!differ(camera.raw, camera.rectified)) return camera.raw;
  if (topic.find("rect") != std::string::npos) {
    told = "the numbers of P are taken, since the pictures are rectified";
    return camera.rectified;
  }
  told =
      "K and P differ: the numbers of K are taken, since no name says that the pictures are "
      "rectified (image_rect)";
  return camera.raw;
}

}  // namespace omentum
