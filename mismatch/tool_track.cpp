#include "mismatch/tool_track.h"

#include <algorithm>
#include <filesystem>

#include "core/check.h"
#include "core/config.h"
#include "mismatch/table.h"

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

pb::RecordingInfo read_recording_info(const std::string& folder) {
  pb::RecordingInfo info;
  const std::string path = folder + "/recording.txtpb";
  if (std::filesystem::exists(path)) read_text_proto(path, info);
  return info;
}

ToolTrack read_tool_track(const std::string& folder, const pb::RecordingInfo& info,
                          const ToolMount& mount) {
  const Table table = read_table(folder + "/tool.csv");
  if (table.rows() < 2) throw_error("{}: {} rows, needed 2 or more", table.path, table.rows());
  ToolTrack track;
  track.time = table_times(table, info.tool_rate_hz());
  const auto& x = table.column("tip_commanded_x_m");
  const auto& y = table.column("tip_commanded_y_m");
  const auto& z = table.column("tip_commanded_z_m");
  for (std::size_t i = 0; i < table.rows(); ++i) {
    const Vector3d p(x[i], y[i], z[i]);
    track.p_WT.push_back(info.tip_point() == pb::control_point ? mount.tip(p) : p);
  }
  if (const auto* jaw = table.find("jaw_commanded_rad")) track.jaw_rad = *jaw;
  return track;
}

}  // namespace omentum
