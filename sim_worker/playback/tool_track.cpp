#include "sim_worker/playback/tool_track.h"

#include <fmt/format.h>

#include <algorithm>

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

double ToolTrack::travel() const {
  double most = 0;
  for (const Vector3d& p : p_WT) most = std::max(most, (p - p_WT.front()).norm());
  return most;
}

std::string ToolTrack::place(std::size_t row) const {
  if (row < lines.size()) return fmt::format("{}:{}", path, lines[row]);
  return fmt::format("{}: at {:.6g} s", path, time[row]);
}

}  // namespace omentum
