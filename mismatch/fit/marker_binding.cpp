#include "mismatch/fit/marker_binding.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/check.h"
#include "sim_worker/geometry/surface_search.h"

namespace omentum {

using Eigen::Vector3d;

void place_known_markers(const MarkerNotes& notes, const std::vector<std::string>& names,
                         const Eigen::Isometry3d& X_WB,
                         const std::vector<Eigen::Vector3i>& triangles,
                         const std::vector<Vector3d>& rest, std::vector<MarkerPlace>& markers) {
  constexpr double kAnywhere = 1;   // [m]
  constexpr double kKnown = 0.002;  // [m] of a place that is stated
  SurfaceSearch search(triangles, rest);
  search.fit(rest);
  for (std::size_t k = 0; k < markers.size(); ++k) {
    const auto note = notes.by_name.find(names[k]);
    if (note == notes.by_name.end() || !note->second.p_B) continue;
    const Vector3d p = X_WB * *note->second.p_B;
    const TrianglePoint foot = search.find(p, rest, kAnywhere);
    if (foot.triangle < 0) throw_error("--markers: {} is nowhere near the body", note->first);
    markers[k] =
        put_marker(triangles[static_cast<std::size_t>(foot.triangle)], foot.share, rest, p);
    markers[k].sd.setConstant(kKnown);
  }
}

bool needs_binding(const FitData& data) {
  return !std::ranges::all_of(data.likelihood.markers(), &MarkerPlace::on_tissue);
}

std::vector<MarkerPlace> bind_markers(const FitData& data,
                                      const std::vector<Prediction>& predictions,
                                      std::vector<std::string>& warnings) {
  constexpr double kFar = 0.02;  // [m] from the surface: on no tissue
  const std::vector<Eigen::Vector3i>& triangles = data.likelihood.triangles();
  const Layout& layout = data.layout;
  const std::vector<Observation>& observations = data.observations;
  std::vector<MarkerPlace> markers = data.likelihood.markers();
  std::vector<double> distance(markers.size(), -1);  // of those that are not placed
  std::vector<bool> looked_at(markers.size());
  for (std::size_t k = 0; k < markers.size(); ++k) looked_at[k] = markers[k].on_tissue();
  for (std::size_t r = 0; r < predictions.size(); ++r) {
    for (std::size_t f = 0; f < predictions[r].frames.size(); ++f) {
      const PredictedFrame& frame = predictions[r].frames[f];
      if (!frame.valid || observations[r].frames[f].markers.empty()) continue;
      std::optional<SurfaceSearch> search;
      for (const SeenMarker& seen : observations[r].frames[f].markers) {
        const auto k = static_cast<std::size_t>(seen.marker);
        if (looked_at[k]) continue;
        looked_at[k] = true;
        if (!search) {
          search.emplace(triangles, frame.vertices);
          search->fit(frame.vertices);
        }
        const TrianglePoint foot = search->find(seen.p, frame.vertices, 1);
        distance[k] = foot.triangle < 0 ? 1 : std::sqrt(foot.squared);
        if (!(distance[k] < kFar)) continue;
        const Eigen::Vector3i& corner = triangles[static_cast<std::size_t>(foot.triangle)];
        MarkerPlace& place = markers[k];
        const Vector3d sd = place.sd;
        place = put_marker(corner, foot.share, frame.vertices, seen.p);
        // Where the surface is there is only believed.
        Vector3d squares = sd.cwiseAbs2();
        const auto add = [&](int column, double belief) {
          Vector3d by = Vector3d::Zero();
          for (int c = 0; c < 3; ++c) {
            by += foot.share[c] *
                  frame.columns.col(column).segment<3>(3 * corner[c]).cast<double>() * belief;
          }
          squares += (place_marker(place, frame.vertices, Vector3d::Zero()).frame.transpose() * by)
                         .cwiseAbs2();
        };
        for (int c = 0; c < layout.unknowns.count; ++c)
          add(c, data.unknowns[static_cast<std::size_t>(c)].sd);
        for (int c = 0; c < layout.held_place.count; ++c) {
          add(layout.unknowns.count + kOwnColumns + c,
              data.beliefs.own_sd[layout.among_own(layout.held_place) + c]);
        }
        place.sd = squares.cwiseSqrt();
      }
    }
  }
  std::string far;
  for (std::size_t k = 0; k < markers.size(); ++k) {
    if (markers[k].on_tissue()) continue;
    far += fmt::format("{}{} ({})", far.empty() ? "" : ", ", observations.front().markers[k],
                       distance[k] < 0 ? "seen in no frame that is simulated"
                                       : fmt::format("{:.0f} mm", 1e3 * distance[k]));
  }
  if (!far.empty()) {
    warnings.push_back(
        fmt::format("markers farther than {:.0f} mm from the simulated body are taken "
                    "for none of tissue and left out: {}",
                    1e3 * kFar, far));
  }
  return markers;
}

Series marker_table(const FitData& data, const Linearisation& linear, const FitState& state,
                    std::size_t recording) {
  const Observation& seen = data.observations[recording];
  const std::vector<MarkerPlace>& markers = data.likelihood.markers();
  const Comparison at = comparison(data, linear, state, recording);
  Series table;
  std::vector<std::size_t> first(markers.size());  // column of each
  for (std::size_t m = 0; m < markers.size(); ++m) {
    first[m] = table.columns.size();
    for (const char* what : {"seen", "simulated"}) {
      for (const char axis : {'x', 'y', 'z'}) {
        if (markers[m].on_tissue())
          table.columns.push_back(fmt::format("{}_{}_{}_m", seen.markers[m], what, axis));
      }
    }
  }
  for (std::size_t k = 0; k < seen.frames.size() && !table.columns.empty(); ++k) {
    const SeenFrame& frame = seen.frames[k];
    if (frame.markers.empty()) continue;
    const std::vector<Vector3d> places = data.likelihood.marker_places(at, k);
    table.time_ns.push_back(std::llround(1e9 * frame.t));
    table.values.resize(table.rows() * table.columns.size(), std::nan(""));
    double* row = &table.values[(table.rows() - 1) * table.columns.size()];
    for (std::size_t i = 0; i < frame.markers.size(); ++i) {
      const auto m = static_cast<std::size_t>(frame.markers[i].marker);
      if (!markers[m].on_tissue()) continue;
      Eigen::Map<Vector3d>(row + first[m]) = frame.markers[i].p;
      Eigen::Map<Vector3d>(row + first[m] + 3) = places[i];
    }
  }
  return table;
}

}  // namespace omentum
