#pragma once

#include <string>
#include <vector>

#include "mismatch/calibrate/calibration.h"
#include "mismatch/fit/search.h"

namespace omentum {

/// A finished fit, to be put into words and numbers.
struct Findings {
  const FitData& data;
  const SearchState& found;
  const FitPosterior& posterior;             ///< there
  const Which& fitted;                       ///< recordings
  Range clock;                               ///< of 90 % of the camera's [s]
  double mesh_m = 0, step_m = 0, law_m = 0;  ///< rms of the surface
};

/// A nuisance whose value is its x, believed to be 0 with `prior_sd`, all in `unit`.
CalibratedNumber plain_number(const std::string& name, const std::string& unit, double x, double sd,
                              double prior_sd, const std::string& source);
/// Numbers that a recording has of its own, the one in Findings::fitted of that place.
void add_own_numbers(const Findings& findings, std::size_t fitted, const Layout::Columns& columns,
                     const std::string& source, Calibration& result);
/// Parameters and nuisances with intervals.
void add_numbers(const Findings& findings, Calibration& result);
/// What recordings of this kind see only together, and what they do not see.
void add_groups(const Findings& findings, Calibration& result);
/// Signs that something is wrong with a recording, the belief or the physics.
void add_warnings(const Findings& findings, Calibration& result);
/// Registration and clock into the scene; a model that trains.
void finish_scene(const Findings& findings, Calibration& result);

}  // namespace omentum
