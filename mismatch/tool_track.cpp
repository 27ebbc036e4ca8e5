#include "mismatch/tool_track.h"

#include <Eigen/Geometry>
#include <algorithm>

#include "core/check.h"
#include "core/constants.h"
#include "core/recording_info.h"
#include "core/table.h"

namespace omentum {

using Eigen::Vector3d;

Vector3d ToolTrack::tip_at(double t) const {
  const auto after = std::upper_bound(time.begin(), time.end(), t);
  if (after == time.begin()) return p_WT.front();
  if (after == time.end()) return p_WT.back();
  const auto k = static_cast<std::size_t>(after - time.begin());
  const double share = (t - time[k - 1]) / (time[k] - time[k - 1]);
  return p_WT[k - 1] + share * (p_WT[k] - p_WT[k - 1]);
}

double ToolTrack::jaw_at(double t) const {
  const auto after = std::upper_bound(time.begin(), time.end(), t);
  return jaw_rad[after == time.begin() ? 0 : static_cast<std::size_t>(after - time.begin()) - 1];
}

namespace {

// Rows of commands are some 1 ms to 1 s apart; a longer pause is odd, an hour is another unit.
constexpr double kOddPause = 60, kLongestPause = 3600;  // [s]
// The arm moves at up to 0.5 m/s; a thousand times that is another unit.
constexpr double kOddSpeed = 1, kHighestSpeed = 100;  // [m/s]
// Full opening angle: the dVRK commands -20 ... 80 deg, negative to press the jaws together.
constexpr double kLowestJaw = -kPi / 2, kWidestJaw = kPi;  // [rad]
constexpr double kFarthestTip = 1;                         // [m] from the tissue at rest

/// Of the distances in time between rows.
double median_pause(const std::vector<double>& time) {
  std::vector<double> pauses;
  for (std::size_t i = 1; i < time.size(); ++i) pauses.push_back(time[i] - time[i - 1]);
  const auto middle = pauses.begin() + static_cast<std::ptrdiff_t>((pauses.size() - 1) / 2);
  std::nth_element(pauses.begin(), middle, pauses.end());
  return *middle;
}

/// Time in another unit shows in the distance of the rows.
void check_times(const Table& table, const pb::RecordingInfo& info, const std::vector<double>& time,
                 std::vector<std::string>& warnings) {
  if (table.find("t_s") == nullptr) {
    if (!info.has_tool_rate_hz()) {
      warnings.push_back(fmt::format(
          "{}:1: no column t_s and no tool_rate_hz in recording.txtpb: rows are taken to "
          "be {:g} s apart",
          table.path, 1 / info.tool_rate_hz()));
    }
    return;
  }
  const double median = median_pause(time);
  const double stated = 1 / info.tool_rate_hz();
  const double ratio = median / stated;
  if (info.has_tool_rate_hz() && !(ratio < 500 && ratio > 1.0 / 500)) {
    throw_error(
        "{}: rows are {:.3g} s apart, tool_rate_hz of recording.txtpb says {:.3g} s: is t_s "
        "in seconds?",
        table.place(1, "t_s"), median, stated);
  }
  if (info.has_tool_rate_hz() && !(ratio < 2 && ratio > 0.5)) {
    warnings.push_back(
        fmt::format("{}: rows are {:.3g} s apart, tool_rate_hz of recording.txtpb says {:.3g} s",
                    table.place(1, "t_s"), median, stated));
  } else if (!info.has_tool_rate_hz() && median >= 1) {
    warnings.push_back(
        fmt::format("{}: rows are {:.3g} s apart, usual up to 1 s: is t_s in seconds?",
                    table.place(1, "t_s"), median));
  }
  std::size_t longest = 1;
  for (std::size_t i = 1; i < time.size(); ++i) {
    if (time[i] - time[i - 1] > time[longest] - time[longest - 1]) longest = i;
  }
  const double pause = time[longest] - time[longest - 1];
  if (!(pause <= kLongestPause)) {
    throw_error("{}: {:.6g} s after the row before, allowed up to {} s",
                table.place(longest, "t_s"), pause, kLongestPause);
  }
  if (pause > kOddPause) {
    warnings.push_back(fmt::format("{}: {:.6g} s after the row before, usual up to {} s",
                                   table.place(longest, "t_s"), pause, kOddPause));
  }
}

void check_speeds(const Table& table, const ToolTrack& track, std::vector<std::string>& warnings) {
  double fastest = 0;
  std::size_t row = 0;
  for (std::size_t i = 1; i < track.time.size(); ++i) {
    const double speed =
        (track.p_WT[i] - track.p_WT[i - 1]).norm() / (track.time[i] - track.time[i - 1]);
    if (speed > fastest) {
      fastest = speed;
      row = i;
    }
  }
  if (fastest <= kOddSpeed) return;
  const std::string text = fmt::format("{}: the tip moves at {:.3g} m/s from the row before",
                                       table.place(row, "tip_commanded_x_m"), fastest);
  if (!(fastest <= kHighestSpeed))
    throw_error("{}, allowed up to {} m/s: metres and seconds?", text, kHighestSpeed);
  warnings.push_back(fmt::format("{}, usual up to {} m/s", text, kOddSpeed));
}

void check_jaw(const Table& table, const std::vector<double>& jaw) {
  for (std::size_t i = 0; i < jaw.size(); ++i) {
    if (jaw[i] >= kLowestJaw && jaw[i] <= kWidestJaw) continue;
    throw_error("{}: jaw_commanded_rad {:.6g} rad, allowed {:.4g} ... {:.4g} rad: in radians?",
                table.place(i, "jaw_commanded_rad"), jaw[i], kLowestJaw, kWidestJaw);
  }
}

}  // namespace

ToolTrack read_tool_track(const std::string& folder, const pb::RecordingInfo& info,
                          const ToolMount& mount, std::vector<std::string>& warnings) {
  const Table table = read_table(folder + "/tool.csv");
  if (table.rows() < 2) throw_error("{}: {} rows, needed 2 or more", table.path, table.rows());
  ToolTrack track;
  track.path = table.path;
  track.lines = table.lines;
  track.time = table_times(table, info.tool_rate_hz());
  check_times(table, info, track.time, warnings);
  const auto& x = table.column("tip_commanded_x_m");
  const auto& y = table.column("tip_commanded_y_m");
  const auto& z = table.column("tip_commanded_z_m");
  const Eigen::Isometry3d X_WF = transform_to_world(info, "tool.csv");
  for (std::size_t i = 0; i < table.rows(); ++i) {
    const Vector3d p = X_WF * Vector3d(x[i], y[i], z[i]);
    track.p_WT.push_back(info.tip_point() == pb::control_point ? mount.tip(p) : p);
  }
  check_speeds(table, track, warnings);
  if (const auto* jaw = table.find("jaw_commanded_rad")) {
    check_jaw(table, *jaw);
    track.jaw_rad = *jaw;
  }
  if (table.open_end) {
    warnings.push_back(
        fmt::format("{}:{}: the last line has no end: is a part of its last number missing?",
                    table.path, table.lines.back()));
  }
  return track;
}

void check_reach(const ToolTrack& track, const Scene& scene, std::vector<std::string>& warnings) {
  Eigen::AlignedBox3d tissue;
  for (const Vector3d& p : scene.tissue.particles) tissue.extend(scene.tissue.X_WB * p);
  const ToolMount mount = scene_tool_mount(scene);
  bool told = false;
  for (std::size_t i = 0; i < track.p_WT.size(); ++i) {
    const Vector3d& p = track.p_WT[i];
    const auto place = [&] {
      return fmt::format("{}:{}: the tip at ({:.6g}, {:.6g}, {:.6g}) m", track.path, track.lines[i],
                         p.x(), p.y(), p.z());
    };
    if (const double gap = tissue.exteriorDistance(p); !(gap <= kFarthestTip)) {
      throw_error("{} is {:.3g} m from the tissue at rest, allowed up to {} m: in metres, in W?",
                  place(), gap, kFarthestTip);
    }
    if (!scene.config.tool().has_base()) continue;  // no arm, whose reach this would be
    const Result<PsmJoints> joints = joints_for_tip(mount, p);
    if (joints || told) continue;
    if (i == 0) throw_error("{} is out of reach of the arm: {}", place(), joints.error());
    warnings.push_back(fmt::format("{} is out of reach of the arm: {}", place(), joints.error()));
    told = true;
  }
}

}  // namespace omentum
