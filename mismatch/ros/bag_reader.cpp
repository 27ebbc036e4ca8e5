#include "mismatch/ros/bag_reader.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

#include "core/check.h"
#include "core/regular_file.h"
#include "core/table.h"
#include "mismatch/import/import_map.h"
#include "mismatch/import/rigid.h"
#include "mismatch/recording/depth_image.h"

namespace omentum {

namespace fs = std::filesystem;

BagReader::BagReader(std::vector<std::string> parts, const pb::ImportMap& map, Values values)
    : parts_(std::move(parts)),
      path_(parts_.size() == 1 ? parts_.front() : fs::path(parts_.front()).parent_path().string()),
      map_(map),
      values_(std::move(values)) {}

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
  set_reference();
  leave_out_apart(depth_);
  leave_out_apart(cloud_);
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
  const std::string folder = fs::path(parts_.front()).parent_path().string();
  for (const pb::RosFrameMap& frame : map_.ros().frame()) {
    tree_.state(frame.name(), make_transform(frame.transform(), folder.empty() ? "." : folder,
                                             values_, recording_.notes));
  }
  stated_ = map_.ros().has_world() || map_.ros().frame_size() > 0;
}

/// One message after the other; of pictures and clouds only their places are kept.
void BagReader::scan(std::size_t part) {
  const std::string& path = parts_[part];
  if (const Result<void> regular = require_regular_file(path); !regular)
    throw_error("{}", regular.error());
  std::ifstream in(path, std::ios::binary);
  if (!in) throw_error("{}: cannot be opened", path);
  McapReader reader(in);
  std::map<std::uint16_t, std::shared_ptr<BagTopic>> by_channel;
  for (McapView message; reader.next(message);) {
    auto& topic = by_channel[message.channel];
    if (topic == nullptr) topic = topic_of(reader.channels().at(message.channel));
    topic->take(message, part, tree_);
  }
  for (const std::string& problem : reader.problems())
    recording_.warnings.push_back(fmt::format("{}: {}", path, problem));
}

void BagReader::scan() {
  for (std::size_t part = 0; part < parts_.size(); ++part) scan(part);
  for (const auto& topic : topics_) topic->settle();
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

/// Where the chain of its transforms ends, without what moves.
std::string BagReader::anchor_of(const std::string& frame) const {
  return tree_.to_world(frame) ? "W" : tree_.root(frame);
}

/// The tool says in which frame a recording stands; without one, what else has a place.
void BagReader::set_reference() {
  const auto take = [&](const std::string& frame, const std::string& topic) {
    if (frame.empty() || !reference_.empty()) return;
    reference_ = anchor_of(frame);
    reference_topic_ = topic;
  };
  for (const char* to :
       {"tool", "tool_commanded", "tool_setpoint", "force_spatial", "tracker", "markers"}) {
    for (const auto& topic : topics_) {
      if (!topic->left_out.empty()) continue;
      for (std::size_t k = 0; k < topic->roles.size(); ++k) {
        if (topic->roles[k].to != to) continue;
        for (const auto& [frame, rows] : topic->rows[k]) {
          if (rows.rows() == 0) continue;
          take(frame, topic->name);
          const bool of_arm = !topic->roles[k].arm.empty() && std::string_view(to) != "tracker";
          if (of_arm && arm_frame_.empty()) arm_frame_ = frame;
        }
      }
    }
  }
  if (cloud_ != nullptr) take(cloud_->frame, cloud_->name);
  if (depth_ != nullptr) take(depth_->frame, depth_->name);
}

/// Whether no transform joins a frame to that of the tool: both would be called W, and be apart.
bool BagReader::stands_apart(const std::string& frame, std::string& why) const {
  if (stated_ || frame.empty() || reference_.empty()) return false;
  const std::string anchor = anchor_of(frame);
  if (anchor == reference_) return false;
  why = fmt::format(
      "it stands in {}, {} in {}, and no transform that does not move joins them; needed --map "
      "with ros {{ frame {{ name: \"{}\" transform {{ ... }} }} ... }}",
      anchor, reference_topic_, reference_, shown(frame));
  return true;
}

bool BagReader::leave_out_apart(std::shared_ptr<BagTopic>& topic) {
  if (topic == nullptr) return false;
  // A camera whose pose is stated needs no frame.
  const bool posed = map_.info().camera().p_m_size() > 0 && topic->kind != RosKind::kCloud;
  if (posed || !stands_apart(topic->frame, topic->left_out)) return false;
  topic = nullptr;
  return true;
}

void BagReader::set_camera() {
  pb::RecordingCamera& camera = *recording_.info.mutable_camera();
  std::shared_ptr<BagTopic> topic = camera_topic();
  if (depth_ == nullptr) leave_out_apart(topic);
  for (const auto& other : topics_) {
    if (other->kind == RosKind::kCamera && other != topic && other->left_out.empty() &&
        other->camera)
      other->left_out = "no depth image is of this camera";
  }
  if (topic == nullptr && depth_ == nullptr) {
    if (!map_.info().has_camera()) recording_.info.clear_camera();
    return;
  }
  if (topic != nullptr && !has_intrinsics(camera)) {
    std::string told;
    const auto& pictures = depth_ != nullptr ? depth_ : color_;
    const pb::RecordingCamera& pinhole =
        pinhole_for(*topic->camera, pictures == nullptr ? "" : pictures->name, told);
    camera.MergeFrom(pinhole);
    if (!told.empty()) warn(fmt::format("{}: {}", topic->name, told));
    if (!topic->camera->told.empty())
      warn(fmt::format("{}: {}: cx, cy, fx, fy are those of what is left of the picture",
                       topic->name, topic->camera->told));
    if (topic->camera->distorted && &pinhole == &topic->camera->raw)
      warn(fmt::format("{}: lens distortion is stated and not taken out", topic->name));
  }
  if (!has_intrinsics(camera)) {
    std::string trouble;
    for (const auto& other : topics_) {
      if (other->kind == RosKind::kCamera && !other->first_damage.empty())
        trouble = fmt::format(" ({}: {})", other->name, other->first_damage);
    }
    throw_error(
        "{}: {}: depth without intrinsics{}, needed sensor_msgs/CameraInfo in the bag, or --map "
        "with info {{ camera ... }}, or with ros {{ topic {{ name: \"{}\" to: \"none\" }} }}",
        path_, depth_->name, trouble, depth_->name);
  }
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
    if (topic->kind != RosKind::kCamera || !topic->camera) continue;
    if (!topic->roles.empty()) return topic;
    if (!topic->left_out.empty()) continue;
    all.push_back(topic);
    const std::string folder = topic->name.substr(0, topic->name.rfind('/') + 1);
    if (depth_ == nullptr || !depth_->name.starts_with(folder) || folder.size() < 2) continue;
    if (folder.size() > longest) best = topic;
    longest = std::max(longest, folder.size());
  }
  if (best != nullptr || all.size() != 1) return best;
  const pb::RecordingCamera& camera = all.front()->camera->raw;
  const bool fits = depth_ == nullptr || depth_->width == 0 ||
                    (depth_->width == camera.width() && depth_->height == camera.height());
  return fits ? all.front() : nullptr;
}

}  // namespace omentum
