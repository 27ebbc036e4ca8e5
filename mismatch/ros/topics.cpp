#include "mismatch/ros/topics.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <map>
#include <optional>

#include "core/check.h"
#include "core/table.h"

namespace omentum {
namespace {

struct CrtkName {
  std::string_view name;  ///< below the arm
  std::string_view to;
  bool planned = false;
};
// The longer names first: jaw/measured_js ends in measured_js too.
constexpr std::array<CrtkName, 14> kCrtk = {{{"jaw/measured_js", "jaw"},
                                             {"jaw/setpoint_js", "jaw_setpoint"},
                                             {"jaw/servo_jp", "jaw_commanded"},
                                             {"jaw/move_jp", "jaw_commanded", true},
                                             {"body/measured_cf", "force_body"},
                                             {"spatial/measured_cf", "force_spatial"},
                                             {"measured_cp", "tool"},
                                             {"setpoint_cp", "tool_setpoint"},
                                             {"servo_cp", "tool_commanded"},
                                             {"move_cp", "tool_commanded", true},
                                             {"measured_js", "joints"},
                                             {"setpoint_js", "joints_setpoint"},
                                             {"servo_jp", "joints_commanded"},
                                             {"move_jp", "joints_commanded", true}}};

const std::vector<std::string>& channels_of(RosKind kind) {
  static const std::map<RosKind, std::vector<std::string>> kChannels = {
      {RosKind::kPose, {"tool", "tool_commanded", "tool_setpoint", "tracker", "markers"}},
      {RosKind::kTransforms, {"tool", "tool_commanded", "tool_setpoint", "tracker", "markers"}},
      {RosKind::kJoints,
       {"joints", "joints_commanded", "joints_setpoint", "jaw", "jaw_commanded", "jaw_setpoint"}},
      {RosKind::kWrench, {"force", "force_body", "force_spatial"}},
      {RosKind::kCloud, {"cloud"}},
      {RosKind::kImage, {"depth", "color"}},
      {RosKind::kPackedImage, {"depth", "color"}},
      {RosKind::kCamera, {"camera"}}};
  static const std::vector<std::string> kNone;
  const auto found = kChannels.find(kind);
  return found == kChannels.end() ? kNone : found->second;
}

bool lists(const std::vector<std::string>& list, std::string_view name) {
  return std::find(list.begin(), list.end(), name) != list.end();
}

/// measured of "joints", commanded of "tool_commanded".
std::string source_in(std::string_view to) {
  const std::size_t at = to.find('_');
  return std::string(at == std::string_view::npos ? "measured" : to.substr(at + 1));
}

void fill_columns(RosRole& role) {
  role.columns.source = source_in(role.to);
  role.columns.stem =
      role.to == "tracker" ? "tip_optical_" : fmt::format("tip_{}_", role.columns.source);
  // One channel of a recording has all that is known of the jaw.
  if (role.to.starts_with("jaw")) role.to = "jaw";
}

std::string last_part(const std::string& topic) { return topic.substr(topic.rfind('/') + 1); }

}  // namespace

RosKind ros_kind(std::string_view type) {
  static const std::map<std::string_view, RosKind> kKinds = {
      {"geometry_msgs/PoseStamped", RosKind::kPose},
      {"geometry_msgs/TransformStamped", RosKind::kPose},
      {"tf2_msgs/TFMessage", RosKind::kTransforms},
      {"tf/tfMessage", RosKind::kTransforms},
      {"sensor_msgs/JointState", RosKind::kJoints},
      {"geometry_msgs/WrenchStamped", RosKind::kWrench},
      {"sensor_msgs/PointCloud2", RosKind::kCloud},
      {"sensor_msgs/Image", RosKind::kImage},
      {"sensor_msgs/CompressedImage", RosKind::kPackedImage},
      {"sensor_msgs/CameraInfo", RosKind::kCamera},
      {"crtk_msgs/operating_state", RosKind::kState},
      {"crtk_msgs/OperatingState", RosKind::kState},
  };
  const auto found = kKinds.find(type);
  return found == kKinds.end() ? RosKind::kOther : found->second;
}

void check_ros_map(const pb::RosMap& map) {
  std::set<std::string> names;
  for (const pb::RosTopicMap& topic : map.topic()) {
    const std::string where = fmt::format("ros.topic {}", shown(topic.name()));
    if (topic.name().empty() || topic.to().empty()) throw_error("{}: needed name and to", where);
    if (topic.child().empty() && !names.insert(topic.name()).second)
      throw_error("{}: twice", where);
    if ((topic.to() == "markers") == topic.marker().empty())
      throw_error("{}: markers have a name, marker: \"...\", and nothing else has", where);
  }
  for (const pb::RosFrameMap& frame : map.frame()) {
    if (frame.name().empty()) throw_error("ros.frame: needed name");
  }
}

namespace {

RosRole stated_role(const pb::RosTopicMap& stated, const std::string& type) {
  const RosKind kind = ros_kind(type);
  if (!lists(channels_of(kind), stated.to())) {
    throw_error("ros.topic {}: to \"{}\", allowed of {}: {}", stated.name(), shown(stated.to()),
                type, fmt::join(channels_of(kind), ", "));
  }
  if ((kind == RosKind::kTransforms) == stated.child().empty())
    throw_error("ros.topic {}: child names a frame of a TFMessage, and this is a {}", stated.name(),
                type);
  RosRole role;
  role.to = stated.to();
  role.marker = stated.marker();
  role.child = stated.child();
  if (stated.has_log_time()) role.clock = stated.log_time() ? RosClock::kLog : RosClock::kStamps;
  // A robot states what its motors press with, the recording what presses on the tool.
  role.factor = stated.has_factor() ? stated.factor() : role.to.starts_with("force_") ? -1 : 1;
  role.columns.linear_known = stated.linear_size() > 0;
  role.columns.linear.assign(stated.linear().begin(), stated.linear().end());
  fill_columns(role);
  return role;
}

/// By the name that CRTK gives it below an arm.
std::optional<RosRole> crtk_role(const std::string& topic, RosKind kind) {
  for (const CrtkName& known : kCrtk) {
    const std::string ending = fmt::format("/{}", known.name);
    if (!topic.ends_with(ending) || !lists(channels_of(kind), known.to)) continue;
    RosRole role;
    role.arm = topic.substr(0, topic.size() - ending.size());
    const std::string part = last_part(role.arm);
    if (role.arm.empty() || part == "local" || part == "jaw" || part == "body" || part == "spatial")
      return std::nullopt;
    role.to = known.to;
    role.planned = known.planned;
    if (role.to.starts_with("force")) role.factor = -1;
    fill_columns(role);
    return role;
  }
  return std::nullopt;
}

}  // namespace

bool names_topic(const pb::RosMap& map, const std::string& topic) {
  return std::any_of(map.topic().begin(), map.topic().end(),
                     [&](const pb::RosTopicMap& stated) { return stated.name() == topic; });
}

std::vector<RosRole> ros_roles(const std::string& topic, const std::string& type,
                               const pb::RosMap& map) {
  std::vector<RosRole> roles;
  for (const pb::RosTopicMap& stated : map.topic()) {
    if (stated.name() == topic && stated.to() != "none") roles.push_back(stated_role(stated, type));
  }
  if (names_topic(map, topic)) return roles;
  if (auto role = crtk_role(topic, ros_kind(type))) roles.push_back(std::move(*role));
  return roles;
}

std::string choose_arm(const std::set<std::string>& arms, const pb::RosMap& map) {
  if (map.has_arm()) {
    if (!arms.contains(map.arm()))
      throw_error("ros.arm: \"{}\", the bag has {}", shown(map.arm()), fmt::join(arms, ", "));
    return map.arm();
  }
  if (arms.size() == 1) return *arms.begin();
  std::vector<std::string> instruments;
  for (const std::string& arm : arms) {
    if (last_part(arm).starts_with("PSM")) instruments.push_back(arm);
  }
  if (instruments.size() != 1)
    throw_error("arms {}: a recording has one, needed --map with ros {{ arm: \"{}\" }}",
                fmt::join(arms, ", "), instruments.empty() ? *arms.begin() : instruments.front());
  return instruments.front();
}

}  // namespace omentum
