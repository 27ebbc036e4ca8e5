#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "mismatch/fit/fit_data.h"
#include "mismatch/recording/recording.h"

namespace omentum {

/// Markers whose place on the body at rest is known sit on its surface at rest. Throws Error for a
/// place that is nowhere near it. `names`: of `markers`; `rest`: in W.
void place_known_markers(const MarkerNotes& notes, const std::vector<std::string>& names,
                         const Eigen::Isometry3d& X_WB,
                         const std::vector<Eigen::Vector3i>& triangles,
                         const std::vector<Eigen::Vector3d>& rest,
                         std::vector<MarkerPlace>& markers);

/// Not all markers have a known place.
bool needs_binding(const FitData& data);
/// Where the markers are on the body: at the places that are known of them; else over the nearest
/// point of the surface in the first frame that shows them, of `predictions` as believed with
/// columns. Those farther from it than 20 mm are on no tissue.
std::vector<MarkerPlace> bind_markers(const FitData& data,
                                      const std::vector<Prediction>& predictions,
                                      std::vector<std::string>& warnings);

/// Markers of a recording, a row a frame: where they were seen and where they are predicted,
/// NAME_seen_x_m ... and NAME_simulated_x_m ...; without columns where it has none on tissue.
Series marker_table(const FitData& data, const Linearisation& linear, const FitState& state,
                    std::size_t recording);

}  // namespace omentum
