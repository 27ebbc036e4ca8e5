#include "monitor/robot_figures.h"

#include <fmt/core.h>

#include <array>
#include <cmath>

#include "core/hash.h"

namespace omentum {
namespace {

std::string place(const std::array<double, 3>& p) {
  if (!std::isfinite(p[0] + p[1] + p[2])) return "unknown";
  return fmt::format("({:.1f}, {:.1f}, {:.1f}) mm", 1e3 * p[0], 1e3 * p[1], 1e3 * p[2]);
}

std::string times(double median_ms, double largest_ms) {
  if (!std::isfinite(median_ms)) return "-";
  return fmt::format("{:.2f} (max {:.2f}) ms", median_ms, largest_ms);
}

std::string stops_of(const RobotStatus& s) {
  std::string by_reason;
  for (std::size_t reason = 0; reason < s.refusals.size(); ++reason) {
    if (s.refusals[reason] > 0 && reason < s.refusal_names.size())
      by_reason += fmt::format("{}{} {}", by_reason.empty() ? ": " : ", ", s.refusals[reason],
                               s.refusal_names[reason]);
  }
  return fmt::format("{}{}", s.stops, by_reason);
}

}  // namespace

std::string describe_robot(const RobotRow& row, std::int64_t now_ns) {
  const RobotStatus& s = row.status;
  const Presence presence = RunState::presence_of(row, now_ns);
  return fmt::format("{} of {} (pid {}): {}{}, {}{}{}", s.robot, s.host, s.pid,
                     presence == Presence::kAlive ? name_of(s.phase) : name_of(presence),
                     s.dry_run ? " (dry run)" : "", s.operating_state,
                     s.is_homed ? ", homed" : ", not homed", s.is_busy ? ", busy" : "");
}

std::vector<RobotFigure> robot_figures(const RobotStatus& s) {
  return {
      {"reason", s.reason == 0 ? "none" : fmt::format("{}: {}", s.reason_name, s.reason_text)},
      {"tip", place(s.measured_tip_in_world_m) +
                  (s.registered ? "" : ", by the base of the scene: no registration")},
      {"goal", place(s.goal_cp_in_world_m) + " of the control point, measured " +
                   place(s.measured_cp_in_world_m)},
      {"times",
       fmt::format("latency {}, jitter {}, state age {}", times(s.latency_p50_ms, s.latency_max_ms),
                   times(s.jitter_p50_ms, s.jitter_max_ms),
                   times(s.state_age_p50_ms, s.state_age_max_ms))},
      {"periods", fmt::format("{}, {} late, {} missed, {} not told; {} commands sent, {} unsent",
                              s.periods, s.late, s.missed, s.unwatched, s.sent, s.unsent)},
      {"datagrams",
       fmt::format("{} taken; malformed {}, foreign {}, cut {}, unknown keys {}, not finite {}, "
                   "reordered {}, restarts {}",
                   s.datagrams, s.malformed, s.foreign, s.cut, s.unknown_keys, s.not_finite,
                   s.reordered, s.restarts)},
      {"stops", stops_of(s)},
      {"policy", fmt::format("version {}, weights {}; {} episodes, {} segments, {} writes failed",
                             s.policy_version, hex(s.weights_hash).substr(0, 8), s.episodes,
                             s.segments_published, s.write_failures)}};
}

}  // namespace omentum
