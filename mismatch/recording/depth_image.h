#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "mismatch/recording/recording.h"
#include "proto/recording_folder.pb.h"

namespace omentum {

/// What the first bytes of a PNG say.
struct PngSize {
  std::uint32_t width = 0, height = 0;
  int bits = 0, channels = 0;
};
/// Total over any bytes; fails with one line that begins with `name`.
Result<PngSize> parse_png_size(const std::string& name, std::string_view png);

/// Depth along the optical axis, row by row, the upper row first, in units of the file; 0 = none.
struct DepthImage {
  std::uint32_t width = 0, height = 0;
  std::vector<std::uint16_t> depth;
};
/// A PNG of one channel of 16 bits, at most 64 million pixels. Total over any bytes; fails with one
/// line that begins with `name`.
Result<DepthImage> parse_depth_png(const std::string& name, std::string_view png);
/// The inverse.
std::string encode_depth_png(const DepthImage& image);

/// fx, fy, cx, cy or the field of view, and the size.
bool has_intrinsics(const pb::RecordingCamera& camera);

/// Points in W seen at the pixels of a depth image: pinhole, no distortion; pixel (0, 0) has its
/// centre at (0, 0), as OpenCV has it; the camera looks along view_direction, `up` is up in the
/// image. Throws Error naming `name` where the size is not the camera's or the pose is none.
Cloud cloud_of_depth(const std::string& name, const DepthImage& image,
                     const pb::RecordingCamera& camera, double depth_unit_m);

/// Clouds of a recording: its own, else those of its depth images.
Frames<Cloud> seen_clouds(const Recording& recording);

}  // namespace omentum
