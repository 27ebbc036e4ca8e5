#include "dvrk_gateway/recording/motion.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <utility>

#include "core/log.h"
#include "core/mcap.h"
#include "core/read_file.h"
#include "core/recording_info.h"
#include "core/table.h"
#include "proto/foxglove.pb.h"
#include "proto/robot_recording.pb.h"

namespace omentum {
namespace {

using Motion = std::vector<MotionSample>;
using Eigen::Vector3d;

constexpr double kNotRecorded = std::numeric_limits<double>::quiet_NaN();
constexpr std::string_view kMcapMagic = "\x89MCAP";
// Loggers of several threads write a stamp a little back now and then (`mismatch import` allows the
// same): such rows are left out, one of so many at most.
constexpr double kSmallBack_s = 1e-6;
constexpr std::size_t kFew = 100;

/// Messages of a topic in the order of their time; a file of several streams need not be in it.
std::vector<const McapMessage*> in_time(const McapContent& content, const char* topic) {
  std::vector<const McapMessage*> messages = content.of_topic(topic);
  std::stable_sort(
      messages.begin(), messages.end(),
      [](const McapMessage* a, const McapMessage* b) { return a->log_time < b->log_time; });
  return messages;
}

double seconds(const McapMessage& message) { return 1e-9 * static_cast<double>(message.log_time); }

/// Poses of a topic, without the jaw.
Result<Motion> tips(const std::string& name, const McapContent& content, const char* topic) {
  Motion motion;
  for (const McapMessage* message : in_time(content, topic)) {
    const auto where = [&] {
      return fmt::format("{}: {} at {} s", name, topic, seconds(*message));
    };
    foxglove::PoseInFrame pose;
    if (!pose.ParseFromString(message->data)) return Failure{where() + ": no foxglove.PoseInFrame"};
    if (pose.frame_id() != "W") return Failure{where() + ": its frame_id is not W"};
    const foxglove::Vector3& p = pose.pose().position();
    const MotionSample sample{seconds(*message), {p.x(), p.y(), p.z()}, kNotRecorded};
    if (!sample.p_WT.allFinite()) return Failure{where() + ": a position that is not finite"};
    if (!motion.empty() && !(sample.t_s > motion.back().t_s))
      return Failure{where() + ": two poses of one time"};
    motion.push_back(sample);
  }
  return motion;
}

/// Fills in the jaw: of the last sample at or before, of the first one for what is earlier.
Result<void> add_jaw(const std::string& name, const McapContent& content, bool commanded,
                     Motion& motion) {
  std::vector<std::pair<double, double>> jaw;
  for (const McapMessage* message : in_time(content, "/jaw")) {
    pb::JawSample sample;
    if (!sample.ParseFromString(message->data)) {
      return Failure{
          fmt::format("{}: /jaw at {} s: no omentum.pb.JawSample", name, seconds(*message))};
    }
    const double value = commanded ? sample.commanded_rad() : sample.measured_rad();
    const bool there = commanded ? sample.has_commanded_rad() : sample.has_measured_rad();
    if (there && std::isfinite(value)) jaw.emplace_back(seconds(*message), value);
  }
  if (jaw.empty()) return {};
  std::size_t k = 0;
  for (MotionSample& sample : motion) {
    while (k + 1 < jaw.size() && jaw[k + 1].first <= sample.t_s) ++k;
    sample.jaw_rad = jaw[k].second;
  }
  return {};
}

/// Seconds of the rows of a table that are later than the row before; `rows` takes their numbers.
std::vector<double> increasing_times(const Table& table, double nominal_rate_hz,
                                     std::vector<std::size_t>& rows) {
  const std::vector<double>* stamps = table.find("t_s");
  std::vector<double> times;
  std::string first;
  std::size_t left_out = 0;
  for (std::size_t i = 0; i < table.rows(); ++i) {
    const double t_s = stamps != nullptr ? (*stamps)[i] : static_cast<double>(i) / nominal_rate_hz;
    if (times.empty() || t_s > times.back()) {
      times.push_back(t_s);
      rows.push_back(i);
      continue;
    }
    if (left_out++ == 0) first = table.place(i, "t_s");
    if (times.back() - t_s > kSmallBack_s || left_out > table.rows() / kFew)
      throw_error("{}: t_s {} after {}, needed increasing", table.place(i, "t_s"), t_s,
                  times.back());
  }
  if (left_out > 0) {
    log().warn("event=motion_left_out first=\"{}\" {} of {} rows no later than the row before",
               first, left_out, table.rows());
  }
  return times;
}

Motion motion_of_table(const std::string& path) {
  const std::string folder = std::filesystem::path(path).parent_path().string();
  const pb::RecordingInfo info = read_recording_info(folder.empty() ? "." : folder);
  if (info.tip_point() != pb::jaw_tip) {
    throw_error(
        "{}: its places are those of the control point (tip_point of recording.txtpb), needed "
        "jaw_tip",
        path);
  }
  const Table table = read_table(path);
  std::vector<std::size_t> rows;
  const std::vector<double> times = increasing_times(table, info.tool_rate_hz(), rows);
  const bool commanded = table.find("tip_commanded_x_m") != nullptr ||
                         table.find("tip_measured_x_m") == nullptr;  // then it is what is missing
  const std::string tip = commanded ? "tip_commanded_" : "tip_measured_";
  const auto& x = table.column(tip + "x_m");
  const auto& y = table.column(tip + "y_m");
  const auto& z = table.column(tip + "z_m");
  const auto* jaw = table.find(commanded ? "jaw_commanded_rad" : "jaw_measured_rad");
  const Eigen::Isometry3d X_WF = transform_to_world(info, "tool.csv");
  Motion motion;
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const std::size_t i = rows[k];
    motion.push_back(
        {times[k], X_WF * Vector3d(x[i], y[i], z[i]), jaw == nullptr ? kNotRecorded : (*jaw)[i]});
  }
  return motion;
}

Result<Motion> long_enough(const std::string& name, Result<Motion> motion) {
  if (motion && motion.value().size() < 2) {
    return Failure{
        fmt::format("{}: {} places of the tip, needed 2 or more", name, motion.value().size())};
  }
  return motion;
}

}  // namespace

Result<Motion> parse_motion(const std::string& name, const std::string& bytes) {
  const McapContent content = read_mcap(bytes);
  const bool commanded = !content.of_topic("/tool_commanded").empty();
  const char* topic = commanded ? "/tool_commanded" : "/tool";
  if (content.of_topic(topic).empty()) {
    const std::string why =
        content.problems.empty() ? "" : fmt::format("; {}", content.problems.front());
    return Failure{fmt::format("{}: neither /tool_commanded nor /tool is in it{}", name, why)};
  }
  Result<Motion> read = tips(name, content, topic);
  if (!read) return read;
  Motion motion = std::move(read).value();
  if (const Result<void> jaw = add_jaw(name, content, commanded, motion); !jaw)
    return Failure{jaw.error()};
  return long_enough(name, std::move(motion));
}

Result<Motion> load_motion(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code failed;
  const std::string file =
      fs::is_directory(path, failed) ? (fs::path(path) / "tool.csv").string() : path;
  const Result<std::string> bytes = read_file(file);
  if (!bytes) return Failure{bytes.error()};
  if (bytes.value().starts_with(kMcapMagic)) return parse_motion(file, bytes.value());
  try {
    return long_enough(file, motion_of_table(file));
  } catch (const Error& error) {
    return Failure{error.what()};
  }
}

}  // namespace omentum
