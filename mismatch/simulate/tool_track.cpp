#include "mismatch/simulate/tool_track.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/constants.h"

namespace omentum {

using Eigen::Vector3d;

namespace {

// Rows of commands are some 1 ms to 1 s apart; a longer pause is odd, an hour is another unit.
constexpr double kOddPause = 60, kLongestPause = 3600;  // [s]
// The arm moves at up to 0.5 m/s; a thousand times that is another unit.
constexpr double kOddSpeed = 1, kHighestSpeed = 100;  // [m/s]
// Full opening angle: the dVRK commands -20 ... 80 deg, negative to press the jaws together.
constexpr double kLowestJaw = -kPi / 2, kWidestJaw = kPi;  // [rad]
constexpr double kFarthestTip = 1;                         // [m] from the tissue at rest

double seconds(std::int64_t time_ns) { return static_cast<double>(time_ns) / 1e9; }

std::string place_of(const Series& series, const std::string& path, std::size_t row) {
  if (row < series.lines.size()) return fmt::format("{}:{}", series.path, series.lines[row]);
  return fmt::format("{}: at {:.6g} s", path, seconds(series.time_ns[row]));
}

/// Of the distances in time between rows.
double median_pause(const std::vector<double>& time) {
  std::vector<double> pauses;
  for (std::size_t i = 1; i < time.size(); ++i) pauses.push_back(time[i] - time[i - 1]);
  const auto middle = pauses.begin() + static_cast<std::ptrdiff_t>((pauses.size() - 1) / 2);
  std::nth_element(pauses.begin(), middle, pauses.end());
  return *middle;
}

/// Time in another unit shows in the distance of the rows.
void check_times(const ToolTrack& track, const pb::RecordingInfo& info,
                 std::vector<std::string>& warnings) {
  const std::vector<double>& time = track.time;
  const double median = median_pause(time);
  const double stated = 1 / info.tool_rate_hz();
  const double ratio = median / stated;
  if (info.has_tool_rate_hz() && !(ratio < 500 && ratio > 1.0 / 500)) {
    throw_error(
        "{}: rows are {:.3g} s apart, tool_rate_hz of recording.txtpb says {:.3g} s: is t_s "
        "in seconds?",
        track.place(1), median, stated);
  }
  if (info.has_tool_rate_hz() && !(ratio < 2 && ratio > 0.5)) {
    warnings.push_back(
        fmt::format("{}: rows are {:.3g} s apart, tool_rate_hz of recording.txtpb says {:.3g} s",
                    track.place(1), median, stated));
  } else if (!info.has_tool_rate_hz() && median >= 1) {
    warnings.push_back(
        fmt::format("{}: rows are {:.3g} s apart, usual up to 1 s: is t_s in seconds?",
                    track.place(1), median));
  }
  std::size_t longest = 1;
  for (std::size_t i = 1; i < time.size(); ++i) {
    if (time[i] - time[i - 1] > time[longest] - time[longest - 1]) longest = i;
  }
  const double pause = time[longest] - time[longest - 1];
  if (!(pause <= kLongestPause)) {
    throw_error("{}: {:.6g} s after the row before, allowed up to {} s", track.place(longest),
                pause, kLongestPause);
  }
  if (pause > kOddPause) {
    warnings.push_back(fmt::format("{}: {:.6g} s after the row before, usual up to {} s",
                                   track.place(longest), pause, kOddPause));
  }
}

void check_speeds(const ToolTrack& track, std::vector<std::string>& warnings) {
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
  const std::string text =
      fmt::format("{}: the tip moves at {:.3g} m/s from the row before", track.place(row), fastest);
  if (!(fastest <= kHighestSpeed))
    throw_error("{}, allowed up to {} m/s: metres and seconds?", text, kHighestSpeed);
  warnings.push_back(fmt::format("{}, usual up to {} m/s", text, kOddSpeed));
}

/// Opening angle commanded at each row of the track; none where none was recorded.
std::vector<double> jaw_of(const Recording& recording, const ToolTrack& track) {
  const Series* series = recording.find("jaw");
  const std::size_t column = series != nullptr ? series->find("jaw_commanded_rad") : 0;
  if (series == nullptr || column == series->columns.size()) return {};
  std::vector<double> time, angle;
  for (std::size_t row = 0; row < series->rows(); ++row) {
    const double jaw = series->at(row, column);
    if (std::isnan(jaw)) continue;
    if (!(jaw >= kLowestJaw && jaw <= kWidestJaw)) {
      throw_error("{}: jaw_commanded_rad {:.6g} rad, allowed {:.4g} ... {:.4g} rad: in radians?",
                  place_of(*series, track.path, row), jaw, kLowestJaw, kWidestJaw);
    }
    time.push_back(seconds(series->time_ns[row]));
    angle.push_back(jaw);
  }
  std::vector<double> jaw;
  for (const double t : track.time) {
    const auto after = std::upper_bound(time.begin(), time.end(), t) - time.begin();
    jaw.push_back(angle[static_cast<std::size_t>(std::max<std::ptrdiff_t>(after - 1, 0))]);
  }
  return jaw;
}

}  // namespace

ToolTrack tool_track_of(const Recording& recording, const std::string& path, const ToolMount& mount,
                        std::vector<std::string>& warnings) {
  const pb::RecordingInfo& info = recording.info;
  const bool commanded = recording.find("tool_commanded") != nullptr;
  const Series* series = recording.find(commanded ? "tool_commanded" : "tool");
  if (series == nullptr) {
    throw_error(
        "{}: no path of the tool, needed tip_commanded_x_m, _y_m, _z_m in tool.csv or "
        "/tool_commanded",
        path);
  }
  ToolTrack track;
  track.path = series->path.empty() ? path : series->path;
  if (series->rows() < 2) throw_error("{}: {} rows, needed 2 or more", track.path, series->rows());
  if (!commanded)
    warnings.push_back(
        fmt::format("{}: no commanded tip: the measured one is replayed", track.path));
  const std::size_t x = series->find(commanded ? "tip_commanded_x_m" : "tip_measured_x_m");
  OMENTUM_CHECK(x + 2 < series->columns.size(), "no tip in {}", track.path);
  track.lines = series->lines;
  for (std::size_t row = 0; row < series->rows(); ++row) {
    track.time.push_back(seconds(series->time_ns[row]));
    const Vector3d p(series->at(row, x), series->at(row, x + 1), series->at(row, x + 2));
    if (!p.allFinite()) throw_error("{}: a part of the tip is not known", track.place(row));
    track.p_WT.push_back(info.tip_point() == pb::control_point ? mount.tip(p) : p);
  }
  check_times(track, info, warnings);
  check_speeds(track, warnings);
  track.jaw_rad = jaw_of(recording, track);
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
      return fmt::format("{}: the tip at ({:.6g}, {:.6g}, {:.6g}) m", track.place(i), p.x(), p.y(),
                         p.z());
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
