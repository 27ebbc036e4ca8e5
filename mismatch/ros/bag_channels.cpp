// What the topics of a bag become: channels of numbers, pictures and clouds.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <optional>

#include "core/check.h"
#include "mismatch/import/source.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/ros/bag_reader.h"

namespace omentum {
namespace {

std::string messages(std::size_t count) {
  return fmt::format("{} message{}", count, count == 1 ? "" : "s");
}

}  // namespace

void BagReader::add_series() {
  std::map<std::string, std::vector<Series>> parts;
  std::vector<std::pair<Series, std::optional<Eigen::Isometry3d>>> at_tip;
  for (const auto& topic : topics_) {
    if (!topic->left_out.empty()) continue;
    for (std::size_t k = 0; k < topic->rows.size(); ++k) {
      const std::string& to = topic->roles[k].to;
      for (auto& [said, rows] : topic->rows[k]) {
        Series part = topic->rows_of(k, rows);
        if (part.rows() == 0) continue;
        // Goals are told to an arm in its own frame, and many programs leave its name out.
        const bool of_arm = said.empty() && !topic->roles[k].arm.empty() && to != "force_body";
        const std::string& frame = of_arm ? arm_frame_ : said;
        if (of_arm && !frame.empty() && topic->kind != RosKind::kJoints)
          recording_.notes.push_back(
              fmt::format("{}: no frame_id: that of the arm, {}", topic->name, frame));
        std::string why;
        const bool placed = topic->kind != RosKind::kJoints && to != "force_body";
        if (placed && stands_apart(frame, why)) {
          warn(fmt::format("{}: {}: left out: {}", topic->name, messages(part.rows()), why));
          continue;
        }
        if (to == "force_body") {
          at_tip.emplace_back(std::move(part), std::nullopt);
        } else if (to == "force_spatial") {
          at_tip.emplace_back(std::move(part), pose_of(frame, topic->name));
        } else {
          if (placed) transform_series(pose_of(frame, topic->name), part);
          parts[to].push_back(std::move(part));
        }
      }
    }
  }
  const auto merge = [&](const std::string& to, std::vector<Series> list) {
    std::size_t dropped = 0;
    std::map<std::string, Series> merged;
    merged[to] = merge_rows(std::move(list), dropped);
    if (dropped > 0) warn(fmt::format("/{}: {} samples at the time of another one", to, dropped));
    if (merged[to].columns.empty()) return;
    omentum::add_series(path_, Eigen::Isometry3d::Identity(), std::move(merged), recording_);
  };
  for (auto& [to, list] : parts) {
    if (to != "force") merge(to, std::move(list));
  }
  const Series* tool = recording_.find("tool");
  std::size_t unknown = 0;
  for (const auto& [wrench, X_WB] : at_tip)
    parts["force"].push_back(
        wrench_at_tip(wrench, tool == nullptr ? Series() : *tool, X_WB, unknown));
  if (unknown > 0)
    warn(fmt::format("/force: {} samples at times when the tip is not known: left out", unknown));
  if (parts.contains("force")) merge("force", std::move(parts["force"]));
}

template <typename T, typename Decode>
void BagReader::set_frames(const std::shared_ptr<BagTopic>& topic, const char* to,
                           Frames<T>& frames, Decode decode) {
  if (topic == nullptr) return;
  std::vector<BagTopic::Found>& found = topic->frames;
  std::stable_sort(found.begin(), found.end(),
                   [](const auto& a, const auto& b) { return a.time_ns < b.time_ns; });
  const auto same = [](const auto& a, const auto& b) { return a.time_ns == b.time_ns; };
  const auto end = std::unique(found.begin(), found.end(), same);
  if (end != found.end())
    warn(fmt::format("/{}: {} frames at the time of another one", to, found.end() - end));
  found.erase(end, found.end());
  for (const BagTopic::Found& frame : found) frames.time_ns.push_back(frame.time_ns);
  frames.number.resize(found.size());
  std::iota(frames.number.begin(), frames.number.end(), 0U);
  for (std::size_t part = fetchers_.size(); part < parts_.size(); ++part)
    fetchers_.push_back(std::make_shared<McapFetcher>(parts_[part]));
  frames.fetch = [topic, decode, fetchers = fetchers_, parts = parts_](std::size_t k) {
    const BagTopic::Found& frame = topic->frames[k];
    try {
      return decode(topic->decode(fetchers[frame.part]->fetch(frame.place)));
    } catch (const Error& error) {
      throw_error("{}: byte {}: {}: {}", parts[frame.part], frame.place.record, topic->name,
                  error.what());
    }
  };
}

void BagReader::add_frames() {
  if (depth_ != nullptr) {
    const bool whole = depth_->picture != "32FC1" && !depth_->picture.starts_with("32FC1;");
    // Whole numbers are mm, where nothing else is stated (REP 118).
    const double unit = recording_.info.has_depth_unit_m() ? recording_.info.depth_unit_m()
                        : whole                            ? 1e-3
                                                           : 1e-4;
    recording_.info.set_depth_unit_m(unit);
    if (!whole) {
      warn(fmt::format("{}: {}: metres become steps of {:g} mm, beyond {:g} m none", depth_->name,
                       depth_->picture, 1e3 * unit, 65535 * unit));
    }
    const bool packed = depth_->kind == RosKind::kPackedImage;
    set_frames(depth_, "depth", recording_.depth, [packed, unit](const RosValue& value) {
      return packed ? unpacked_depth_png(value, unit) : depth_png(ros_image(value), unit);
    });
  }
  if (color_ != nullptr) {
    const bool packed = color_->kind == RosKind::kPackedImage;
    set_frames(color_, "color", recording_.color, [packed](const RosValue& value) {
      return packed ? packed_color_png(value) : color_png(ros_image(value));
    });
  }
  if (cloud_ != nullptr) {
    const Eigen::Isometry3d X_WF = pose_of(cloud_->frame, cloud_->name);
    set_frames(cloud_, "cloud", recording_.clouds,
               [X_WF](const RosValue& value) { return ros_cloud(value, X_WF); });
  }
}

/// Times of an epoch begin at 0; when that was is kept.
void BagReader::shift_times() {
  std::vector<std::pair<std::string, std::vector<std::int64_t>*>> all;
  for (auto& [to, series] : recording_.series) all.emplace_back(to, &series.time_ns);
  all.emplace_back("cloud", &recording_.clouds.time_ns);
  all.emplace_back("depth", &recording_.depth.time_ns);
  all.emplace_back("color", &recording_.color.time_ns);
  std::erase_if(all, [](const auto& times) { return times.second->empty(); });
  if (all.empty()) return;
  std::int64_t first = std::numeric_limits<std::int64_t>::max();
  for (const auto& [to, times] : all) first = std::min(first, times->front());
  constexpr std::int64_t kEpoch = 1'000'000'000'000'000'000;  // 2001; simulated time is far below
  if (first > kEpoch) {
    recording_.info.set_start_unix_ns(static_cast<std::uint64_t>(first));
    for (const auto& [to, times] : all) {
      for (std::int64_t& time : *times) time -= first;
    }
  }
  // Of clocks that have nothing in common.
  const auto& [reference, times] = all.front();
  for (const auto& [to, other] : all) {
    if (other->front() <= times->back() && times->front() <= other->back()) continue;
    warn(fmt::format("/{} at {} ... {} s, /{} at {} ... {} s: no time in common, other clocks?", to,
                     print_seconds(other->front()), print_seconds(other->back()), reference,
                     print_seconds(times->front()), print_seconds(times->back())));
  }
}

/// What became of each topic, one line each.
void BagReader::tell() {
  for (const auto& topic : topics_) tell(*topic);
}

void BagReader::tell(const BagTopic& topic) {
  const std::string what =
      fmt::format("{} ({}): {}", topic.name, topic.type, messages(topic.messages));
  if (topic.left_out.empty() && topic.damaged > 0 && topic.damaged == topic.messages) {
    warn(fmt::format("{} left out: {}", what, topic.first_damage));
    return;
  }
  if (!topic.left_out.empty()) {
    warn(fmt::format("{} left out: {}", what, topic.left_out));
    return;
  }
  std::vector<std::string> to;
  for (const RosRole& role : topic.roles) to.push_back("/" + role.to);
  for (const auto& [chosen, name] :
       {std::pair{depth_, "/depth"}, {color_, "/color"}, {cloud_, "/cloud"}}) {
    if (chosen.get() == &topic && topic.roles.empty()) to.push_back(name);
  }
  if (topic.kind == RosKind::kCamera && topic.roles.empty()) to.push_back("camera");
  if (topic.kind == RosKind::kTransforms && topic.roles.empty()) to.push_back("frames");
  if (to.empty()) {
    warn(
        fmt::format("{} left out: it is no name of CRTK; a map with ros {{ topic ... }} says "
                    "what it is",
                    what));
    return;
  }
  const bool timed = topic.kind != RosKind::kCamera && !topic.roles.empty();
  std::string line = fmt::format("{} -> {}", what, fmt::join(to, ", "));
  if (timed || is_picture(topic.kind))
    line += topic.of_log ? ", times of the log" : ", times of header.stamp";
  recording_.notes.push_back(line);
  tell_odd(topic);
}

void BagReader::tell_odd(const BagTopic& topic) {
  for (const std::string& odd : topic.told) warn(fmt::format("{}: {}", topic.name, odd));
  if (topic.damaged > 0)
    warn(fmt::format("{}: {} that cannot be read: left out; the first at {}", topic.name,
                     messages(topic.damaged), topic.first_damage));
  for (std::size_t k = 0; k < topic.joint_names.size(); ++k) {
    const RosJointNames& names = topic.joint_names[k];
    if (names.reordered() > 0)
      warn(fmt::format("{}: {} with the joints in another order: taken by their names, {}",
                       topic.name, messages(names.reordered()), names.told()));
    else if (const std::string told = names.told(); !told.empty())
      recording_.notes.push_back(fmt::format("{}: joints by their names, {}", topic.name, told));
  }
  if (topic.other_kind > 0)
    warn(fmt::format("{}: {} of another size or encoding than the first: left out", topic.name,
                     messages(topic.other_kind)));
  if (topic.not_finite > 0)
    warn(fmt::format("{}: {} without finite numbers: left out", topic.name,
                     messages(topic.not_finite)));
  if (topic.in_part > 0)
    warn(fmt::format("{}: {} {}: the rest is taken", topic.name, messages(topic.in_part),
                     topic.kind == RosKind::kJoints ? "with more than 9 joints"
                                                    : "whose orientation is no unit quaternion"));
  if (topic.other_frame > 0)
    warn(fmt::format("{}: {} in another frame than {}: left out", topic.name,
                     messages(topic.other_frame), topic.frame));
  if (!topic.roles.empty() && topic.roles.front().planned)
    warn(fmt::format("{}: goals of motions that the robot plans, not the path of the tool",
                     topic.name));
}

}  // namespace omentum
