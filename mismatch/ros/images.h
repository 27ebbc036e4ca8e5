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

/// sensor_msgs/CompressedImage: what its format says, and what lies in it. kDepthCut is a PNG of 8
/// bits that says it had 16.
enum class PackedImage { kColorPng, kDepthPng, kDepthInvertedPng, kDepthCut, kJpeg, kOther };
PackedImage packed_image(const RosValue& message);
/// The PNG of a packed image, behind the header of compressedDepth where it has one.
std::string_view packed_png(const RosValue& message);
/// PNG of a packed depth image (behind its header of 12 bytes where it is compressedDepth), in
/// metres of steps of `unit_m` where it holds inverted depth.
std::string unpacked_depth_png(const RosValue& message, double unit_m);
/// A PNG as it is.
std::string packed_color_png(const RosValue& message);

/// sensor_msgs/PointCloud2: x, y, z of FLOAT32 or FLOAT64 by their offsets, any byte order, X
/// applied; points that are not finite are left out.
Cloud ros_cloud(const RosValue& message, const Eigen::Isometry3d& X_WF);

/// Whether the picture that a message of PointCloud2 claims lies in its bytes; throws Error. `told`
/// is what was taken other than it says.
void check_ros_cloud(const RosValue& message, std::string& told);

/// sensor_msgs/CameraInfo: pinholes of the picture as the camera gives it (K) and of the rectified
/// one (P), each with crop and binning taken into it. fx is 0 of one that is not stated.
struct RosCamera {
  pb::RecordingCamera raw, rectified;
  bool distorted = false;  ///< a distortion that is not zero
  std::string told;        ///< of crop and binning
  bool calibrated() const { return raw.fx() > 0 || rectified.fx() > 0; }
};
/// Throws Error where it is none, or neither pinhole is stated.
RosCamera ros_camera(const RosValue& message);
/// The pinhole of the pictures of a topic: that of P where its name says that it is rectified, else
/// that of K; the other one where one alone is stated. `told` is why, where they differ.
const pb::RecordingCamera& pinhole_for(const RosCamera& camera, const std::string& topic,
                                       std::string& told);

}  // namespace omentum
