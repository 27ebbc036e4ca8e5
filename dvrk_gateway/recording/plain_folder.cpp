#include "dvrk_gateway/recording/plain_folder.h"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <optional>
#include <vector>

#include "core/check.h"
#include "core/cloud_message.h"
#include "core/mcap.h"
#include "core/output_folder.h"
#include "core/ply.h"
#include "core/read_file.h"
#include "proto/foxglove.pb.h"
#include "proto/recording_folder.pb.h"
#include "proto/robot_recording.pb.h"

namespace omentum {
namespace {

/// Goals come every 20 ms; after such a pause none is in force.
constexpr double kGoalLasts_s = 0.1;

template <typename Message>
struct Timed {
  double t_s = 0;
  Message message;
};

/// A topic in the order of time; a repeated time is dropped, tables want time to increase.
template <typename Message>
std::vector<Timed<Message>> samples(const std::string& path, const McapContent& content,
                                    const char* topic) {
  std::vector<Timed<Message>> found;
  for (const McapMessage* message : content.of_topic(topic)) {
    Timed<Message> sample;
    sample.t_s = 1e-9 * static_cast<double>(message->log_time);
    if (!sample.message.ParseFromString(message->data))
      throw_error("{}: {} at {} s is no {}", path, topic, sample.t_s,
                  Message::descriptor()->full_name());
    found.push_back(std::move(sample));
  }
  const auto earlier = [](const auto& a, const auto& b) { return a.t_s < b.t_s; };
  std::stable_sort(found.begin(), found.end(), earlier);
  const auto same = [](const auto& a, const auto& b) { return !(a.t_s < b.t_s); };
  found.erase(std::unique(found.begin(), found.end(), same), found.end());
  return found;
}

/// The newest at or before t; null where there is none.
template <typename Message>
const Timed<Message>* at(const std::vector<Timed<Message>>& samples, double t_s) {
  const auto after = std::upper_bound(samples.begin(), samples.end(), t_s,
                                      [](double t, const auto& sample) { return t < sample.t_s; });
  return after == samples.begin() ? nullptr : &*std::prev(after);
}

/// What the robot is to do at t: the goal of the gateway, else the set-point that it keeps.
template <typename Message>
const Message* commanded_at(const std::vector<Timed<Message>>& goals,
                            const std::vector<Timed<Message>>& setpoints, double t_s) {
  const Timed<Message>* goal = at(goals, t_s);
  if (goal != nullptr && t_s - goal->t_s <= kGoalLasts_s) return &goal->message;
  const Timed<Message>* setpoint = at(setpoints, t_s);
  return setpoint != nullptr ? &setpoint->message : nullptr;
}

void add(std::string& line, std::initializer_list<double> values) {
  for (const double value : values) fmt::format_to(std::back_inserter(line), ",{:.15g}", value);
}
void add(std::string& line, const foxglove::Pose& pose) {
  const foxglove::Vector3& p = pose.position();
  const foxglove::Quaternion& q = pose.orientation();
  add(line, {p.x(), p.y(), p.z(), q.w(), q.x(), q.y(), q.z()});
}

std::string tool_table(const std::string& path, const McapContent& content) {
  const auto measured = samples<foxglove::PoseInFrame>(path, content, "/tool");
  const auto goals = samples<foxglove::PoseInFrame>(path, content, "/tool_commanded");
  const auto setpoints = samples<foxglove::PoseInFrame>(path, content, "/tool_setpoint");
  auto jaws = samples<pb::JawSample>(path, content, "/jaw");
  std::erase_if(jaws, [](const auto& jaw) { return !std::isfinite(jaw.message.measured_rad()); });
  std::string text = "t_s";
  for (const char* kind : {"commanded", "measured"}) {
    text += fmt::format(
        ",tip_{0}_x_m,tip_{0}_y_m,tip_{0}_z_m,tip_{0}_qw,tip_{0}_qx,tip_{0}_qy,tip_{0}_qz", kind);
  }
  text += jaws.empty() ? "\n" : ",jaw_commanded_rad,jaw_measured_rad\n";
  std::size_t rows = 0;
  for (const auto& [t_s, pose] : measured) {
    const foxglove::PoseInFrame* commanded = commanded_at(goals, setpoints, t_s);
    if (commanded == nullptr) continue;  // the set-point comes within a period
    std::string line = fmt::format("{:.15g}", t_s);
    add(line, commanded->pose());
    add(line, pose.pose());
    if (!jaws.empty()) {
      const Timed<pb::JawSample>* jaw = at(jaws, t_s);
      const pb::JawSample& now = jaw != nullptr ? jaw->message : jaws.front().message;
      const double goal = std::isfinite(now.commanded_rad())  ? now.commanded_rad()
                          : std::isfinite(now.setpoint_rad()) ? now.setpoint_rad()
                                                              : now.measured_rad();
      add(line, {goal, now.measured_rad()});
    }
    text += line + '\n';
    ++rows;
  }
  if (rows == 0) throw_error("{}: no pose of the tool with a set-point", path);
  return text;
}

/// Six joints, or nothing: while a robot homes there are others.
std::optional<foxglove::JointStates> six(const foxglove::JointStates* joints) {
  if (joints == nullptr || joints->joints_size() != 6) return std::nullopt;
  return *joints;
}

std::string joint_table(const std::string& path, const McapContent& content) {
  const auto measured = samples<foxglove::JointStates>(path, content, "/joints");
  const auto goals = samples<foxglove::JointStates>(path, content, "/joints_commanded");
  const auto setpoints = samples<foxglove::JointStates>(path, content, "/joints_setpoint");
  // Columns that some rows would leave empty are left out.
  const auto all = [&measured](auto&& has) {
    return std::all_of(measured.begin(), measured.end(), [&](const auto& sample) {
      const auto& joints = sample.message.joints();
      return joints.size() != 6 || std::all_of(joints.begin(), joints.end(), has);
    });
  };
  const bool velocity = all([](const foxglove::JointState& j) { return j.has_velocity(); });
  const bool effort = all([](const foxglove::JointState& j) { return j.has_effort(); });
  std::string text = "t_s";
  for (int j = 1; j <= 6; ++j) {
    const char* unit = j == 3 ? "m" : "rad";
    text += fmt::format(",q{0}_commanded_{1},q{0}_measured_{1}", j, unit);
    if (velocity) text += fmt::format(",dq{}_measured_{}_per_s", j, unit);
    if (effort) text += fmt::format(",effort{}_{}", j, j == 3 ? "N" : "Nm");
  }
  text += '\n';
  for (const auto& [t_s, states] : measured) {
    const auto now = six(&states);
    const auto commanded = six(commanded_at(goals, setpoints, t_s));
    if (!now || !commanded) continue;
    std::string line = fmt::format("{:.15g}", t_s);
    for (int j = 0; j < 6; ++j) {
      const foxglove::JointState& joint = now->joints(j);
      add(line, {commanded->joints(j).position(), joint.position()});
      if (velocity) add(line, {joint.velocity()});
      if (effort) add(line, {joint.effort()});
    }
    text += line + '\n';
  }
  return text;
}

std::string force_table(const std::vector<Timed<pb::ForceSample>>& samples) {
  std::string text = "t_s,fx_N,fy_N,fz_N,tx_Nm,ty_Nm,tz_Nm\n";
  for (const auto& [t_s, f] : samples) {
    std::string line = fmt::format("{:.15g}", t_s);
    add(line, {f.fx_n(), f.fy_n(), f.fz_n(), f.tx_nm(), f.ty_nm(), f.tz_nm()});
    text += line + '\n';
  }
  return text;
}

/// Rows of as many markers as the first one has; others are left out, since tables have one width,
/// and told in `notes`.
std::string marker_table(const std::vector<Timed<pb::MarkersSample>>& samples, std::string& notes) {
  std::size_t left_out = 0;
  const int width = samples.front().message.position_m_size();
  std::string text = "t_s";
  for (int k = 0; k < width / 3; ++k)
    text += fmt::format(",marker{0}_x_m,marker{0}_y_m,marker{0}_z_m", k);
  text += '\n';
  for (const auto& [t_s, markers] : samples) {
    if (markers.position_m_size() != width) {
      ++left_out;
      continue;
    }
    std::string line = fmt::format("{:.15g}", t_s);
    for (const double value : markers.position_m()) add(line, {value});
    text += line + '\n';
  }
  if (left_out > 0) notes += fmt::format("markers.csv: {} rows of another width. ", left_out);
  return text;
}

std::string tracker_table(const std::vector<Timed<pb::TrackerSample>>& samples,
                          std::string& notes) {
  std::size_t left_out = 0;
  const bool turned = samples.front().message.orientation_wxyz_size() == 4;
  std::string text = "t_s,tip_optical_x_m,tip_optical_y_m,tip_optical_z_m";
  text += turned ? ",tip_optical_qw,tip_optical_qx,tip_optical_qy,tip_optical_qz\n" : "\n";
  for (const auto& [t_s, tip] : samples) {
    if (tip.position_m_size() != 3 || (tip.orientation_wxyz_size() == 4) != turned) {
      ++left_out;
      continue;
    }
    std::string line = fmt::format("{:.15g}", t_s);
    for (const double value : tip.position_m()) add(line, {value});
    for (const double value : tip.orientation_wxyz()) add(line, {value});
    text += line + '\n';
  }
  if (left_out > 0) notes += fmt::format("tracker.csv: {} rows of another width. ", left_out);
  return text;
}

void write_clouds(const OutputFolder& out, const std::vector<Timed<foxglove::PointCloud>>& clouds) {
  std::filesystem::create_directory(out.path() / "clouds");
  std::string index = "t_s,file\n";
  for (std::size_t k = 0; k < clouds.size(); ++k) {
    const std::string name = fmt::format("clouds/{:06}.ply", k);
    const std::string& data = clouds[k].message.data();
    std::vector<Eigen::Vector3f> points(data.size() / kCloudPointBytes);
    for (std::size_t i = 0; i < points.size(); ++i)
      std::memcpy(points[i].data(), data.data() + i * kCloudPointBytes, kCloudPointBytes);
    out.write(name, encode_ply(points));
    index += fmt::format("{:.15g},{}\n", clouds[k].t_s, name);
  }
  out.write("clouds.csv", index);
}

}  // namespace

void write_plain_folder(const std::string& mcap_path, const std::string& folder) {
  OutputFolder out(folder);
  const Result<std::string> bytes = read_file(mcap_path);
  if (!bytes) throw_error("{}", bytes.error());
  const McapContent content = read_mcap(bytes.value());
  const auto infos = samples<pb::RecordingInfo>(mcap_path, content, "/recording");
  if (infos.empty()) throw_error("{}: no /recording in it", mcap_path);
  pb::RecordingInfo info = infos.front().message;
  const std::string tool = tool_table(mcap_path, content);

  out.begin();
  out.write("tool.csv", tool);
  out.write("joints.csv", joint_table(mcap_path, content));
  const auto force = samples<pb::ForceSample>(mcap_path, content, "/force");
  const auto markers = samples<pb::MarkersSample>(mcap_path, content, "/markers");
  const auto tracker = samples<pb::TrackerSample>(mcap_path, content, "/tracker");
  const auto clouds = samples<foxglove::PointCloud>(mcap_path, content, "/cloud");
  if (!force.empty()) out.write("force.csv", force_table(force));
  if (!markers.empty()) out.write("markers.csv", marker_table(markers, *info.mutable_notes()));
  if (!tracker.empty()) out.write("tracker.csv", tracker_table(tracker, *info.mutable_notes()));
  if (!clouds.empty()) write_clouds(out, clouds);
  if (!info.scene_text().empty()) {
    out.write("scene.txtpb", info.scene_text());
    info.set_scene("scene.txtpb");
    info.clear_scene_text();
  }
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(info, &text));
  out.write("recording.txtpb", text);
  out.finish();
}

}  // namespace omentum
