#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <string_view>

#include "mismatch/recording/recording.h"
#include "mismatch/ros/message.h"

namespace omentum {

// Pictures and clouds of ROS messages. Everything here throws Error, one line, where a message
// lacks a field, says what is not known, or claims more bytes than it has.

/// sensor_msgs/Image: rows of pixels as they lie in the message.
struct RosImage {
  std::uint32_t width = 0, height = 0;
  std::size_t step = 0;  ///< bytes of a row
  std::string_view encoding, data;
  bool big_endian = false;
};
RosImage ros_image(const RosValue& message);

/// 16UC1, mono16, 32FC1.
bool is_depth_encoding(std::string_view encoding);
/// rgb8, bgr8, rgba8, bgra8, mono8, 8UC1.
bool is_color_encoding(std::string_view encoding);

/// A PNG of 16 bits. Whole numbers stay as they are; metres of 32FC1 become steps of `unit_m`, and
/// 0 (none) where they are not finite, not positive or beyond 65535 steps.
std::string depth_png(const RosImage& image, double unit_m);
/// A PNG of 8 bits: grey, or red, green and blue. Transparency is left out.
std::string color_png(const RosImage& image);

/// sensor_msgs/CompressedImage: what its format says, and what lies in it.
enum class PackedImage { kColorPng, kDepthPng, kDepthInvertedPng, kJpeg, kOther };
PackedImage packed_image(const RosValue& message);
/// PNG of a packed depth image (behind its header of 12 bytes where it is compressedDepth), in
/// metres of steps of `unit_m` where it holds inverted depth.
std::string unpacked_depth_png(const RosValue& message, double unit_m);
/// A PNG as it is.
std::string packed_color_png(const RosValue& message);

/// sensor_msgs/PointCloud2: x, y, z of FLOAT32 or FLOAT64 by their offsets, any byte order, X
/// applied; points that are not finite are left out.
Cloud ros_cloud(const RosValue& message, const Eigen::Isometry3d& X_WF);

/// sensor_msgs/CameraInfo: pinhole and size; true where it states a distortion that is not zero.
bool ros_camera(const RosValue& message, pb::RecordingCamera& camera);

}  // namespace omentum
