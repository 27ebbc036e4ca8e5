#pragma once

#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "mismatch/ros/rows.h"
#include "mismatch/ros/stamps.h"
#include "proto/import_map.pb.h"

namespace omentum {

/// Types of messages that become channels.
enum class RosKind {
  kPose,         ///< geometry_msgs PoseStamped, TransformStamped
  kTransforms,   ///< tf2_msgs, tf TFMessage
  kJoints,       ///< sensor_msgs/JointState
  kWrench,       ///< geometry_msgs/WrenchStamped
  kCloud,        ///< sensor_msgs/PointCloud2
  kImage,        ///< sensor_msgs/Image
  kPackedImage,  ///< sensor_msgs/CompressedImage
  kCamera,       ///< sensor_msgs/CameraInfo
  kState,        ///< crtk_msgs operating_state: read by people, no channel of a recording
  kOther
};
/// Of a short name, package/Type.
RosKind ros_kind(std::string_view type);
/// Clouds too.
inline bool is_picture(RosKind kind) {
  return kind == RosKind::kCloud || kind == RosKind::kImage || kind == RosKind::kPackedImage;
}

/// What a topic is taken for.
struct RosRole {
  std::string to;      ///< channel of a recording; of forces force, force_body, force_spatial
  RosColumns columns;  ///< of poses, joints, jaw
  std::string marker;  ///< its name
  std::string child;   ///< frame of a TFMessage
  std::string arm;     ///< by whose name it was found; empty: by the map
  double factor = 1;   ///< of a force
  RosClock clock = RosClock::kEither;
  bool planned = false;  ///< goals of motions that the robot plans, not a path
};

/// By the map, else by the name of CRTK: "/PSM1/measured_cp" and others below an arm
/// (docs/import.md 8). None where neither knows it, or where it is left out ("none"); several of a
/// TFMessage. Throws Error where the map wants what the type is not.
std::vector<RosRole> ros_roles(const std::string& topic, const std::string& type,
                               const pb::RosMap& map);
/// Whether the map names the topic, be it to leave it out.
bool names_topic(const pb::RosMap& map, const std::string& topic);

/// The arm of the recording: the one of the map, the only one, or the only PSM. Throws Error where
/// there are several, or not that of the map.
std::string choose_arm(const std::set<std::string>& arms, const pb::RosMap& map);

/// Why a map cannot be meant, whatever the bag; throws Error.
void check_ros_map(const pb::RosMap& map);

}  // namespace omentum
