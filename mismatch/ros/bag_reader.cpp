#include "mismatch/ros/bag_reader.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

#include "core/check.h"
#include "core/regular_file.h"
#include "mismatch/import/import_map.h"
#include "mismatch/import/rigid.h"
#include "mismatch/recording/depth_image.h"

namespace omentum {

namespace fs = std::filesystem;

BagReader::BagReader(const std::string& path, const pb::ImportMap& map, Values values)
    : path_(path), map_(map), values_(std::move(values)) {}

Recording BagReader::read() {
  state_frames();
  scan();
  keep_one_arm();
  const Result<std::string> name = fill_in(map_.name(), values_);
  if (!name) throw_error("name: {}", name.error());
  recording_.info = mapped_info(map_, values_, name.value());
  // measured_cp of the dVRK is the pose of its control point, behind the tip of the jaws.
  if (!arm_.empty() && !recording_.info.has_tip_point())
    recording_.info.set_tip_point(pb::control_point);
  depth_ = choose("depth", [](const BagTopic& topic) { return topic.is_depth; });
  color_ = choose("color", [](const BagTopic& topic) { return topic.is_color; });
  cloud_ = choose("cloud", [](const BagTopic& topic) { return topic.kind == RosKind::kCloud; });
  set_camera();
  add_series();
  add_frames();
  shift_times();
  tell();
  if (recording_.series.empty() && recording_.clouds.size() == 0 && recording_.depth.size() == 0)
    throw_error("{}: nothing of a recording in it, topics {}", path_, topic_names());
  return std::move(recording_);
}

void BagReader::warn(const std::string& text) {
  recording_.warnings.push_back(fmt::format("{}: {}", path_, text));
}

std::string BagReader::topic_names() const {
  std::vector<std::string> names;
  for (const auto& topic : topics_) names.push_back(topic->name);
  return fmt::format("{}", fmt::join(names, ", "));
}

void BagReader::state_frames() {
  if (map_.ros().has_world()) tree_.set_world(map_.ros().world());
  const std::string folder = fs::path(path_).parent_path().string();
  for (const pb::RosFrameMap& frame : map_.ros().frame()) {
    tree_.state(frame.name(), make_transform(frame.transform(), folder.empty() ? "." : folder,
                                             values_, recording_.notes));
  }
  stated_ = map_.ros().has_world() || map_.ros().frame_size() > 0;
}

/// One message after the other; of pictures and clouds only their places are kept.
void BagReader::scan() {
  if (const Result<void> regular = require_regular_file(path_); !regular)
    throw_error("{}", regular.error());
  std::ifstream in(path_, std::ios::binary);
  if (!in) throw_error("{}: cannot be opened", path_);
  McapReader reader(in);
  std::map<std::uint16_t, std::shared_ptr<BagTopic>> by_channel;
  for (McapView message; reader.next(message);) {
    auto& topic = by_channel[message.channel];
    if (topic == nullptr) topic = topic_of(reader.channels().at(message.channel));
    try {
      topic->take(message, tree_);
    } catch (const Error& error) {
      throw_error("{}: byte {}: {}", path_, message.place.record, error.what());
    }
  }
  for (const std::string& problem : reader.problems()) warn(problem);
  for (const pb::RosTopicMap& stated : map_.ros().topic()) {
    if (std::none_of(topics_.begin(), topics_.end(),
                     [&](const auto& topic) { return topic->name == stated.name(); }))
      throw_error("{}: ros.topic {}: none, the bag has {}", path_, stated.name(), topic_names());
  }
}

/// Several publishers of one topic have channels of their own.
std::shared_ptr<BagTopic> BagReader::topic_of(const McapChannel& channel) {
  auto made = std::make_shared<BagTopic>(channel, map_.ros());
  for (const auto& topic : topics_) {
    if (topic->name == made->name && topic->type == made->type && topic->encoding == made->encoding)
      return topic;
  }
  topics_.push_back(made);
  return made;
}

void BagReader::keep_one_arm() {
  std::set<std::string> arms;
  for (const auto& topic : topics_) {
    for (const RosRole& role : topic->roles) {
      if (!role.arm.empty()) arms.insert(role.arm);
    }
  }
  if (arms.empty()) return;
  const std::string arm = choose_arm(arms, map_.ros());
  arm_ = arm;
  // A channel that the map gives is not found by name as well.
  std::set<std::string> given;
  for (const auto& topic : topics_) {
    for (const RosRole& role : topic->roles) {
      if (role.arm.empty()) given.insert(role.to + role.columns.source);
    }
  }
  bool body = false;
  for (const auto& topic : topics_)
    body = body || (!topic->roles.empty() && topic->roles.front().to == "force_body");
  for (const auto& topic : topics_) {
    if (topic->roles.empty() || topic->roles.front().arm.empty()) continue;
    const RosRole& role = topic->roles.front();
    if (role.arm != arm) topic->left_out = fmt::format("not of the arm {}", arm);
    if (given.contains(role.to + role.columns.source))
      topic->left_out = fmt::format("the map gives /{}", role.to);
    if (role.to == "force_spatial" && body) topic->left_out = "body/measured_cf is that force";
  }
}

/// The topic of pictures or clouds that the map names, or the only one that fits.
std::shared_ptr<BagTopic> BagReader::choose(const std::string& to, bool (*fits)(const BagTopic&)) {
  std::shared_ptr<BagTopic> named;
  Topics others;
  for (const auto& topic : topics_) {
    if (!is_picture(topic->kind) || topic->frames.empty()) continue;
    if (!topic->roles.empty() && topic->roles.front().to == to) {
      if (!fits(*topic))
        throw_error("{}: {}: {}, which cannot be /{}", path_, topic->name, topic->picture, to);
      if (named) throw_error("ros.topic: {} and {} are both {}", named->name, topic->name, to);
      named = topic;
    } else if (topic->roles.empty() && topic->left_out.empty() && fits(*topic)) {
      others.push_back(topic);
    }
  }
  if (named == nullptr && others.size() == 1) return others.front();
  for (const auto& topic : others) {
    topic->left_out = named != nullptr ? fmt::format("{} is /{}", named->name, to)
                                       : fmt::format("{} topics could be /{}: a map says which",
                                                     others.size(), to);
  }
  return named;
}

/// How a frame stands to W. Where nothing is stated of W, the root of its transforms is taken for
/// W, and said so.
Eigen::Isometry3d BagReader::pose_of(const std::string& frame, const std::string& topic) {
  Result<Eigen::Isometry3d> X = tree_.to_world(frame);
  if (X) return X.value();
  if (stated_) throw_error("{}: {}: {}, needed ros.frame", path_, topic, X.error());
  const std::string root = tree_.root(frame);
  if (taken_for_W_.insert(root).second) {
    warn(fmt::format("{}: {}: {} is taken for W; ros {{ frame ... }} of a map says what it is",
                     topic, X.error(), root.empty() ? "it" : root));
  }
  const Result<Eigen::Isometry3d> in_root = tree_.pose_in(root, frame);
  return in_root ? in_root.value() : Eigen::Isometry3d::Identity();
}

void BagReader::set_camera() {
  pb::RecordingCamera& camera = *recording_.info.mutable_camera();
  const std::shared_ptr<BagTopic> topic = camera_topic();
  for (const auto& other : topics_) {
    if (other->kind == RosKind::kCamera && other != topic && other->left_out.empty())
      other->left_out = "no depth image is of this camera";
  }
  if (topic == nullptr && depth_ == nullptr) {
    if (!map_.info().has_camera()) recording_.info.clear_camera();
    return;
  }
  if (topic != nullptr && !has_intrinsics(camera)) {
    camera.MergeFrom(topic->camera);
    if (topic->distorted)
      warn(fmt::format("{}: lens distortion is stated and not taken out", topic->name));
  }
  if (!has_intrinsics(camera))
    throw_error(
        "{}: {}: depth without intrinsics, needed sensor_msgs/CameraInfo in the bag, or --map "
        "with info {{ camera ... }}, or with ros {{ topic {{ name: \"{}\" to: \"none\" }} }}",
        path_, depth_->name, depth_->name);
  if (depth_ != nullptr && depth_->width > 0 &&
      (depth_->width != camera.width() || depth_->height != camera.height()))
    throw_error("{}: {}: {} x {} pixels, the camera has {} x {}", path_, depth_->name,
                depth_->width, depth_->height, camera.width(), camera.height());
  if (camera.p_m_size() > 0) return;
  const std::string& of = depth_ != nullptr ? depth_->name : topic->name;
  const Eigen::Isometry3d X_WC = pose_of(depth_ != nullptr ? depth_->frame : topic->frame, of);
  for (Eigen::Index k = 0; k < 3; ++k) {
    camera.add_p_m(X_WC.translation()[k]);
    camera.add_view_direction(X_WC.linear()(k, 2));
    camera.add_up(-X_WC.linear()(k, 1));
  }
}

/// The one that the map names; that of the folder of the depth topic; the only one of its size.
std::shared_ptr<BagTopic> BagReader::camera_topic() const {
  std::shared_ptr<BagTopic> best;
  std::size_t longest = 0;
  Topics all;
  for (const auto& topic : topics_) {
    if (topic->kind != RosKind::kCamera || topic->camera.width() == 0) continue;
    if (!topic->roles.empty()) return topic;
    if (!topic->left_out.empty()) continue;
    all.push_back(topic);
    const std::string folder = topic->name.substr(0, topic->name.rfind('/') + 1);
    if (depth_ == nullptr || !depth_->name.starts_with(folder) || folder.size() < 2) continue;
    if (folder.size() > longest) best = topic;
    longest = std::max(longest, folder.size());
  }
  if (best != nullptr || all.size() != 1) return best;
  const pb::RecordingCamera& camera = all.front()->camera;
  const bool fits = depth_ == nullptr || depth_->width == 0 ||
                    (depth_->width == camera.width() && depth_->height == camera.height());
  return fits ? all.front() : nullptr;
}

}  // namespace omentum
