#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/seen/observation.h"

namespace omentum {

/// What is known of a marker beside where it was seen.
struct MarkerNote {
  enum class On { kTissue, kClamp, kOther };
  On on = On::kTissue;
  std::optional<Eigen::Vector3d> p_B;  ///< its middle on the body at rest, in B [m]
};

/// Of markers by name; of others nothing is known.
struct MarkerNotes {
  std::map<std::string, MarkerNote> by_name;
  /// Where those of the clamp are while it is where the scene has it, p_W [m].
  std::map<std::string, Eigen::Vector3d> clamp;
};

/// Table of name, on (tissue, clamp, other), x_m, y_m, z_m, the last three of it in B or empty.
/// Throws Error: place and what was expected.
MarkerNotes read_marker_notes(const std::string& path);

/// The clamp is where the scene has it while its markers are at the medians of this recording.
/// Nothing is done where there are none of it. Throws Error where there are fewer than three.
void find_clamp(const Recording& recording, MarkerNotes& notes);

/// At most so many frames of a recording and markers of all are looked at, evenly chosen.
inline constexpr std::size_t kMostMarkerFrames = 400, kMostMarkers = 60;

/// Adds frames of the markers that may be on tissue, their noise, and of a body that was held when
/// it was let go; a motion of the clamp is taken off. Frames are in the order of time. What is odd
/// is appended to `warnings`.
void add_markers(const Recording& recording, const std::string& path, const MarkerNotes& notes,
                 Observation& made, std::vector<std::string>& warnings);

/// Commands of a recording that has markers and no tool: open jaws that stand aside.
ToolTrack standing_track(const Series& markers, const std::string& path, const Scene& scene);

/// Numbers the markers through all recordings, in the order of their names.
void number_markers(std::vector<Observation>& observations, std::vector<std::string>& warnings);

}  // namespace omentum
