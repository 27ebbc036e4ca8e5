#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "mismatch/recording/recording.h"

namespace omentum {

// What can be known of a recording before anything is simulated (docs/import.md 9).

/// Samples of a channel in time.
struct SamplingFigures {
  std::string topic;
  std::size_t rows = 0;
  double begin_s = 0, end_s = 0, period_s = 0;  ///< median period; 0 of one row
  std::size_t gaps = 0;                         ///< longer than 2.5 periods
  double longest_gap_s = 0;
};

/// When a channel shows the motion of another one.
struct ClockFigures {
  std::string topic, reference;
  double offset_s = 0;  ///< the channel shows it so much later: clock and delay together
  double sd_s = 0;
  double drift_ppm = 0, drift_sd_ppm = 0;  ///< second half against the first
  double correlation = 0;
};

/// Scatter while nothing moves.
struct NoiseFigures {
  std::string topic, unit;
  std::size_t windows = 0;   ///< stretches it was taken from
  bool in_holds = false;     ///< commands held still; else the quietest tenth of the stretches
  double sd = 0;             ///< about a line, of one number
  double correlation_s = 0;  ///< time in which the scatter forgets, of a first-order process
  std::size_t outliers = 0;  ///< farther than 8 sd from the middle of their neighbours
};

/// A command that stays at its largest or smallest value as if it were cut off there.
struct ClippedFigures {
  std::string column;
  double value = 0;
  std::size_t rows = 0, stretches = 0;
};

struct IntakeFigures {
  std::vector<SamplingFigures> sampling;
  std::vector<ClockFigures> clocks;
  std::vector<NoiseFigures> noise;
  std::vector<ClippedFigures> clipped;
};

/// Of clouds the motion of their centre counts (topic "cloud"); fetches all of them.
IntakeFigures take_in(const Recording& recording);

/// Centre of every cloud; without rows where there are none.
Series cloud_centres(const Recording& recording);

/// How far repeats of one motion are apart in a channel.
struct FloorFigures {
  std::string topic, unit;
  std::size_t repeats = 0;
  /// What was taken off before they were compared; empty: nothing, commands that differ are in it.
  std::string less = {};
  double rms = 0;      ///< of one repeat about their mean, over time and columns
  double largest = 0;  ///< of a difference of two
};
/// Of recordings of one `repeat_of`, from the begin of each; channels that all have with the same
/// columns. Of tool and joints once more less what each was commanded: repeats whose commands
/// differ are compared by what the robot made of them.
std::vector<FloorFigures> repeatability(const std::vector<const Recording*>& repeats);

/// The same of one channel with equal columns, those of `floor.unit`. False where nothing can be
/// compared.
bool compare_repeats(const std::vector<const Series*>& all, FloorFigures& floor);

/// One line each, for people.
std::string print_intake(const IntakeFigures& figures);
std::string print_floor(const std::vector<FloorFigures>& floor);

}  // namespace omentum
