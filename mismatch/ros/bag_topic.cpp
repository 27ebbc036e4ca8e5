#include "mismatch/ros/bag_topic.h"

#include <fmt/format.h>

#include <cmath>

#include "core/check.h"
#include "core/mcap_chunk.h"
#include "core/table.h"
#include "mismatch/recording/depth_image.h"

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
  joint_names.resize(roles.size());
  stamps_.resize(roles.size() + 1);
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
  if (encoding == RosEncoding::kCdr && mcap::is_packed_frame(data)) {
    constexpr std::uint64_t kMost = std::uint64_t{1} << 30;
    const Result<std::string_view> unpacked = mcap::unpack_frame(data, kMost, unpacked_);
    if (!unpacked)
      throw_error(
          "{}: {}: a message that is compressed by itself: {}; `ros2 bag convert` makes a "
          "bag without",
          name, type, unpacked.error());
    data = unpacked.value();
  }
  Result<RosValue> value = decode_ros_message(*schema, encoding, data);
  if (!value) throw_error("{}: {}: {}", name, type, value.error());
  return std::move(value).value();
}

/// The number of its stamp, in the place of its time until all are known.
std::int64_t BagTopic::stamp_of(const RosValue& header, const McapView& message,
                                std::vector<RosStamp>& stamps) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  const double sec = header.number_at("stamp.sec"), nanosec = header.number_at("stamp.nanosec");
  // Whatever type a definition gives them; 64 bits hold the difference of two such times.
  if (!(std::fabs(sec) <= 4.4e9 && std::fabs(nanosec) <= 4.4e9))
    throw_error("header.stamp: {} s and {} ns", sec, nanosec);
  const std::int64_t stamped =
      static_cast<std::int64_t>(sec) * kSecond + static_cast<std::int64_t>(nanosec);
  constexpr std::uint64_t kLatest = 4'400'000'000ULL * kSecond;
  if (message.log_time > kLatest)
    throw_error("a log time of {} s", static_cast<double>(message.log_time) / 1e9);
  stamps.push_back({static_cast<std::int64_t>(message.log_time), stamped, stamped != 0});
  return static_cast<std::int64_t>(stamps.size() - 1);
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

void BagTopic::take(const McapView& message, std::size_t part, FrameTree& tree) {
  ++messages;
  if (schema == nullptr) return;
  const bool wanted = !roles.empty() || is_picture(kind) || kind == RosKind::kCamera ||
                      kind == RosKind::kTransforms;
  if (!wanted || (kind == RosKind::kCamera && camera)) return;
  try {
    take_known(message, part, tree);
  } catch (const Error& error) {
    if (damaged++ == 0)
      first_damage = fmt::format("byte {}: {}", message.place.record, error.what());
  }
}

void BagTopic::take_known(const McapView& message, std::size_t part, FrameTree& tree) {
  const RosValue value = decode(message.data);
  if (kind == RosKind::kTransforms) return take_transforms(value, message, tree);
  if (is_picture(kind)) return take_frame(value, message, part);
  if (kind == RosKind::kCamera) {
    camera = ros_camera(value);
    frame = frame_name(value.text_at("header.frame_id"));
    return;
  }
  for (std::size_t role = 0; role < roles.size(); ++role) take_row(value, message, role);
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
      const std::int64_t time = stamp_of(stamped.get("header"), message, stamps_[k]);
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
  const std::int64_t time = stamp_of(header, message, stamps_[k]);
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
    taken = add_joint_row(value, time, role.columns, joint_names[k], to);
  }
  not_finite += taken == RowTaken::kNothing ? 1 : 0;
  in_part += taken == RowTaken::kPart ? 1 : 0;
}

/// What the first picture of a topic is.
void BagTopic::begin_pictures(const RosValue& value) {
  bool grey = false;
  if (kind == RosKind::kImage) {
    const RosImage image = ros_image(value);
    picture = image.encoding;
    is_depth = is_depth_encoding(picture);
    is_color = is_color_encoding(picture);
    grey = picture == "mono8" || picture == "8UC1";
    width = image.width;
    height = image.height;
  } else if (kind == RosKind::kPackedImage) {
    const PackedImage packed = packed_image(value);
    is_depth = packed == PackedImage::kDepthPng || packed == PackedImage::kDepthInvertedPng;
    is_color = packed == PackedImage::kColorPng;
    if (is_depth || is_color) {
      const Result<PngSize> size = parse_png_size(name, packed_png(value));
      if (!size) throw_error("{}", size.error());
      width = size.value().width;
      height = size.value().height;
      grey = size.value().channels == 1;
    }
    picture = value.text_at("format");
    if (packed == PackedImage::kJpeg) left_out = "JPEG, and a recording holds PNG";
    if (packed == PackedImage::kDepthCut)
      left_out = fmt::format(
          "{} in a PNG of 8 bits: half of each depth was lost when it was packed; needed "
          "compressedDepth or raw pictures",
          shown(picture));
  }
  // 8 bits of depth are no depth, and no colours.
  if (is_color && grey && roles.empty() && name.find("depth") != std::string::npos) {
    left_out = fmt::format(
        "it is called depth, and its pictures {} are of 8 bits; to: \"color\" of a map takes them "
        "as colours",
        shown(picture));
  }
  if (kind != RosKind::kCloud && !is_depth && !is_color && left_out.empty())
    left_out = fmt::format("pictures {}, which are not read", shown(picture));
}

/// Whether a picture can be fetched as the first one is. Throws Error where it is damaged.
bool BagTopic::is_like_first(const RosValue& value) {
  if (kind == RosKind::kCloud) {
    std::string odd;
    check_ros_cloud(value, odd);
    if (!odd.empty()) told.insert(odd);
    return true;
  }
  if (!left_out.empty()) return true;  // nothing is fetched of it
  if (kind == RosKind::kImage) {
    const RosImage image = ros_image(value);
    if (!is_depth) return is_color_encoding(image.encoding);
    return is_depth_encoding(image.encoding) && image.width == width && image.height == height &&
           (image.encoding == "32FC1") == (picture == "32FC1");
  }
  const PackedImage packed = packed_image(value);
  const bool depth = packed == PackedImage::kDepthPng || packed == PackedImage::kDepthInvertedPng;
  if (!is_depth) return packed == PackedImage::kColorPng;
  if (!depth) return false;
  const Result<DepthImage> image = parse_depth_png(name, packed_png(value));
  if (!image) throw_error("{}", image.error());
  return image.value().width == width && image.value().height == height;
}

void BagTopic::take_frame(const RosValue& value, const McapView& message, std::size_t part) {
  const RosValue& header = value.get("header");
  const std::string in = frame_name(header.text_at("frame_id"));
  if (kind == RosKind::kCloud) {
    std::string odd;
    check_ros_cloud(value, odd);  // one without fields is no first one
  }
  if (frames.empty() && other_frame == 0 && picture.empty()) {
    begin_pictures(value);
    frame = in;
  }
  if (in != frame) {
    ++other_frame;
    return;
  }
  if (!is_like_first(value)) {
    ++other_kind;
    return;
  }
  frames.push_back({stamp_of(header, message, stamps_.back()), message.place, part});
}

void BagTopic::settle() {
  for (std::size_t k = 0; k < stamps_.size(); ++k) {
    const bool pictures = k == roles.size();
    const std::size_t role = pictures ? 0 : k;
    times_.push_back(
        settle_times(stamps_[k], role < roles.size() ? roles[role].clock : RosClock::kEither));
    if (stamps_[k].empty()) continue;
    of_log = of_log || times_.back().of_log;
    told.insert(times_.back().told.begin(), times_.back().told.end());
    stamps_[k] = {};
  }
  if (times_.empty()) return;
  const RosTimes& pictures = times_.back();
  std::vector<Found> kept;
  for (Found& found : frames) {
    const auto at = static_cast<std::size_t>(found.time_ns);
    if (pictures.left_out[at]) continue;
    found.time_ns = pictures.time_ns[at];
    kept.push_back(found);
  }
  frames = std::move(kept);
}

Series BagTopic::rows_of(std::size_t role, RosRows& found) const {
  Series all = found.take(), kept;
  kept.columns = all.columns;
  for (std::size_t row = 0; row < all.rows(); ++row) {
    const auto at = static_cast<std::size_t>(all.time_ns[row]);
    if (times_[role].left_out[at]) continue;
    kept.time_ns.push_back(times_[role].time_ns[at]);
    for (std::size_t k = 0; k < all.columns.size(); ++k) kept.values.push_back(all.at(row, k));
  }
  return kept;
}

}  // namespace omentum
