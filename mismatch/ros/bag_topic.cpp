#include "mismatch/ros/bag_topic.h"

#include <fmt/format.h>

#include <cmath>

#include "core/check.h"
#include "core/table.h"

namespace omentum {

BagTopic::BagTopic(const McapChannel& channel, const pb::RosMap& map)
    : name(channel.topic), type(short_ros_name(channel.schema.name)), kind(ros_kind(type)) {
  const bool one = channel.encoding == "ros1" && channel.schema.encoding == "ros1msg";
  const bool two = channel.encoding == "cdr" && channel.schema.encoding == "ros2msg";
  if (!one && !two) {
    left_out = fmt::format("messages {} defined by {}, needed ros1 by ros1msg or cdr by ros2msg",
                           shown(channel.encoding), shown(channel.schema.encoding));
    return;
  }
  encoding = one ? RosEncoding::kRos1 : RosEncoding::kCdr;
  roles = ros_roles(name, type, map);
  if (names_topic(map, name) && roles.empty()) {
    left_out = "as the map says";
    return;
  }
  rows.resize(roles.size());
  if (kind == RosKind::kState) {
    left_out = "a recording has no state of the robot";
    return;
  }
  if (kind == RosKind::kOther) {
    left_out = "no channel of a recording has this type";
    return;
  }
  Result<RosSchema> made = parse_ros_schema(channel.schema.name, channel.schema.data,
                                            one ? RosVersion::kOne : RosVersion::kTwo);
  if (made) {
    schema = std::make_shared<const RosSchema>(std::move(made).value());
  } else {
    left_out = fmt::format("its definition: {}", made.error());
  }
}

RosValue BagTopic::decode(std::string_view data) const {
  Result<RosValue> value = decode_ros_message(*schema, encoding, data);
  if (!value) throw_error("{}: {}: {}", name, type, value.error());
  return std::move(value).value();
}

std::int64_t BagTopic::time_of(const RosValue& header, const McapView& message, bool log_time) {
  const auto logged = static_cast<std::int64_t>(message.log_time);
  if (log_time) return logged;
  constexpr std::int64_t kSecond = 1'000'000'000;
  const double sec = header.number_at("stamp.sec"), nanosec = header.number_at("stamp.nanosec");
  // Whatever type a definition gives them; 64 bits hold 292 years.
  if (!(std::fabs(sec) <= 9e9 && std::fabs(nanosec) <= 4e9))
    throw_error("header.stamp: {} s and {} ns", sec, nanosec);
  const auto seconds = static_cast<std::int64_t>(sec);
  const auto fraction = static_cast<std::int64_t>(nanosec);
  if (seconds != 0 || fraction != 0) return seconds * kSecond + fraction;
  ++unstamped;
  return logged;
}

bool rigid_of(const RosValue& transform, Eigen::Isometry3d& X) {
  X.setIdentity();
  const RosValue& p = transform.get("translation");
  const RosValue& q = transform.get("rotation");
  const Eigen::Vector3d shift(p.number_at("x"), p.number_at("y"), p.number_at("z"));
  const Eigen::Quaterniond turn(q.number_at("w"), q.number_at("x"), q.number_at("y"),
                                q.number_at("z"));
  constexpr double kUnit = 1e-3;  // three digits
  if (!shift.allFinite() || !(std::fabs(turn.norm() - 1) <= kUnit)) return false;
  X.linear() = turn.normalized().toRotationMatrix();
  X.translation() = shift;
  return true;
}

void BagTopic::take(const McapView& message, FrameTree& tree) {
  ++messages;
  if (schema == nullptr) return;
  const bool pictures = is_picture(kind);
  const bool camera_again = kind == RosKind::kCamera && camera.width() > 0;
  if (camera_again ||
      (roles.empty() && !pictures && kind != RosKind::kCamera && kind != RosKind::kTransforms))
    return;
  const RosValue value = decode(message.data);
  try {
    if (kind == RosKind::kTransforms) return take_transforms(value, message, tree);
    if (pictures) return take_frame(value, message);
    if (kind == RosKind::kCamera) {
      distorted = ros_camera(value, camera);
      frame = frame_name(value.text_at("header.frame_id"));
      return;
    }
    for (std::size_t role = 0; role < roles.size(); ++role) take_row(value, message, role);
  } catch (const Error& error) {
    throw_error("{}: {}", name, error.what());
  }
}

void BagTopic::take_transforms(const RosValue& value, const McapView& message, FrameTree& tree) {
  for (const RosValue& stamped : value.get("transforms").items) {
    const std::string parent(stamped.text_at("header.frame_id"));
    const std::string child(stamped.text_at("child_frame_id"));
    Eigen::Isometry3d X_PC;
    if (!rigid_of(stamped.get("transform"), X_PC)) {
      ++not_finite;
      continue;
    }
    tree.add(parent, child, X_PC);
    for (std::size_t k = 0; k < roles.size(); ++k) {
      if (frame_name(roles[k].child) != frame_name(child)) continue;
      const std::int64_t time = time_of(stamped.get("header"), message, roles[k].log_time);
      RosRows& to = rows[k][frame_name(parent)];
      const RosValue& pose = stamped.get("transform");
      if (roles[k].to == "markers") {
        add_marker_row(pose, time, roles[k].marker, to);
      } else {
        add_pose_row(pose, time, roles[k].columns.stem, to);
      }
    }
  }
}

void BagTopic::take_row(const RosValue& value, const McapView& message, std::size_t k) {
  const RosRole& role = roles[k];
  const RosValue& header = value.get("header");
  const std::int64_t time = time_of(header, message, role.log_time);
  RosRows& to = rows[k][frame_name(header.text_at("frame_id"))];
  RowTaken taken = RowTaken::kNothing;
  if (kind == RosKind::kPose) {
    const RosValue& pose = value.get(value.find("pose") != nullptr ? "pose" : "transform");
    taken = role.to == "markers" ? add_marker_row(pose, time, role.marker, to)
                                 : add_pose_row(pose, time, role.columns.stem, to);
  } else if (kind == RosKind::kWrench) {
    taken = add_wrench_row(value.get("wrench"), time, role.factor, to);
  } else if (role.to == "jaw") {
    taken = add_jaw_row(value, time, role.columns.source, to);
  } else {
    taken = add_joint_row(value, time, role.columns, to);
  }
  not_finite += taken == RowTaken::kNothing ? 1 : 0;
  in_part += taken == RowTaken::kPart ? 1 : 0;
}

void BagTopic::take_frame(const RosValue& value, const McapView& message) {
  const RosValue& header = value.get("header");
  const std::string in = frame_name(header.text_at("frame_id"));
  if (frames.empty() && other_frame == 0) {
    frame = in;
    if (kind == RosKind::kImage) {
      const RosImage image = ros_image(value);
      picture = image.encoding;
      is_depth = is_depth_encoding(picture);
      is_color = is_color_encoding(picture);
      width = image.width;
      height = image.height;
    } else if (kind == RosKind::kPackedImage) {
      const PackedImage packed = packed_image(value);
      picture = value.text_at("format");
      is_depth = packed == PackedImage::kDepthPng || packed == PackedImage::kDepthInvertedPng;
      is_color = packed == PackedImage::kColorPng;
      if (packed == PackedImage::kJpeg) left_out = "JPEG, and a recording holds PNG";
    }
    if (kind != RosKind::kCloud && !is_depth && !is_color && left_out.empty())
      left_out = fmt::format("pictures {}, which are not read", shown(picture));
  }
  if (in != frame) {
    ++other_frame;
    return;
  }
  const bool log_time = !roles.empty() && roles.front().log_time;
  frames.push_back({time_of(header, message, log_time), message.place});
}

}  // namespace omentum
