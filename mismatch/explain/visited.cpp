#include "mismatch/explain/visited.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace omentum {
namespace {

/// What the commands of a recording visit while the jaws hold.
struct Reach {
  const char* name;
  const char* unit;
  double low, high;
};

std::vector<Reach> reach_of(const Observation& seen) {
  constexpr double kStep = 0.02, kOver = 0.1;  // [s]; speeds are means over the latter
  const ToolTrack& track = seen.track;
  const auto closed = [&](double t) {
    return track.jaw_rad.empty() || track.jaw_at(t) <= seen.grasp.closed_rad;
  };
  double from = track.begin();
  while (from < track.end() && !closed(from)) from += kStep;
  const Eigen::Vector3d first = track.tip_at(from);
  double lift = 0, sideways = 0, speed = 0, until = from;
  for (double t = from; t <= track.end() + 1e-9; t += kStep) {
    if (!closed(t)) continue;
    const Eigen::Vector3d p = track.tip_at(t);
    lift = std::max(lift, p.z() - first.z());
    sideways = std::max(sideways, (p - first).head<2>().norm());
    if (t - kOver >= from) speed = std::max(speed, (p - track.tip_at(t - kOver)).norm() / kOver);
    until = t;
  }
  return {{"lift", "m", 0, lift},
          {"sideways", "m", 0, sideways},
          {"speed", "m/s", 0, speed},
          {"hold", "s", 0, until - from},
          {"pinch_x", "m", seen.pinch.x(), seen.pinch.x()},
          {"pinch_y", "m", seen.pinch.y(), seen.pinch.y()}};
}

/// Lengths in mm, for a person.
std::string told(double value, const std::string& unit) {
  if (unit == "s") return fmt::format("{:.2f} s", value);
  return fmt::format("{:.1f} {}", 1e3 * value, unit == "m" ? "mm" : "mm/s");
}

}  // namespace

void add_visited(std::span<const Observation> observations, pb::Verdict& verdict) {
  for (const Observation& seen : observations) {
    if (seen.held_out || !seen.pinched) continue;
    const std::vector<Reach> all = reach_of(seen);
    const bool first = verdict.visited_size() == 0;
    for (std::size_t k = 0; k < all.size(); ++k) {
      pb::VerdictVisited& row =
          first ? *verdict.add_visited() : *verdict.mutable_visited(static_cast<int>(k));
      row.set_name(all[k].name);
      row.set_unit(all[k].unit);
      row.set_low(first ? all[k].low : std::min(row.low(), all[k].low));
      row.set_high(first ? all[k].high : std::max(row.high(), all[k].high));
    }
  }
}

std::vector<std::string> beyond_visited(const Observation& seen, const pb::Verdict& verdict) {
  constexpr double kAlike = 0.02;  // of the range: as far
  std::vector<std::string> list;
  if (!seen.pinched) return list;
  for (const Reach& reach : reach_of(seen)) {
    const auto row = std::ranges::find(verdict.visited(), reach.name, &pb::VerdictVisited::name);
    if (row == verdict.visited().end()) continue;
    const double slack = kAlike * (row->high() - row->low());
    if (reach.high > row->high() + slack) {
      list.push_back(fmt::format("{} {}, up to {} were fitted ({} beyond)", reach.name,
                                 told(reach.high, reach.unit), told(row->high(), reach.unit),
                                 told(reach.high - row->high(), reach.unit)));
    } else if (reach.low < row->low() - slack) {
      list.push_back(fmt::format("{} {}, from {} on were fitted ({} beyond)", reach.name,
                                 told(reach.low, reach.unit), told(row->low(), reach.unit),
                                 told(row->low() - reach.low, reach.unit)));
    }
  }
  return list;
}

}  // namespace omentum
