#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "core/result.h"

namespace omentum {

/// A recording of a robot (docs/formats.md 10) as far as its page shows it.
struct RobotRecording {
  struct Path {
    std::vector<double> t_s, x_mm, y_mm, z_mm;  ///< tip in W, at log times
    std::vector<double> stamp_s;                ///< by the robot's own clock
  };
  struct Event {
    double t_s = 0;
    std::string phase, reason, text;
    bool stopped = false;
  };
  struct Episode {
    double t_s = 0;  ///< of its first decision
    std::uint32_t steps = 0;
    double exposure = 0;  ///< NaN: not known
    std::string outcome;
  };
  std::string name, about;  ///< about: mode, date, instrument, program
  bool complete = false;    ///< the file has its end
  Path commanded, setpoint, measured;
  std::vector<double> latency_ms, jitter_ms, state_age_ms;  ///< of the periods that have one
  std::uint64_t periods = 0;
  std::vector<Event> events;
  std::vector<Episode> episodes;
  std::vector<std::pair<std::string, std::uint64_t>> counters;  ///< those above 0
  std::vector<std::string> problems;                            ///< one line each
};

/// Total over any bytes: what cannot be read of a file is in `problems`. Fails where there is
/// nothing to show.
Result<RobotRecording> read_robot_recording(const std::string& name, const std::string& bytes);

/// The page of recordings, one HTML text that loads nothing: paths commanded, set-point and
/// measured, error over time, latency, safety events, episodes.
std::string make_recording_page(const std::vector<RobotRecording>& recordings);

}  // namespace omentum
