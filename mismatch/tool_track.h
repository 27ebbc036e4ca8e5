#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "core/psm.h"
#include "mismatch/recording/recording.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// What the tool was told to do in a recording: the path of the jaw tip T and the jaw.
struct ToolTrack {
  std::vector<double> time;           ///< [s], increasing
  std::vector<Eigen::Vector3d> p_WT;  ///< commanded jaw tip in W [m]
  std::vector<double> jaw_rad;        ///< full opening angle commanded; empty = not recorded
  std::string path;                   ///< of the table or file it was read from
  std::vector<std::uint32_t> lines;   ///< of each row in the table; empty: it is no table

  double begin() const { return time.front(); }
  double end() const { return time.back(); }
  /// Linear between rows, constant before the first and after the last.
  Eigen::Vector3d tip_at(double t) const;
  /// Of the last row at or before t (a jaw command is a step).
  double jaw_at(double t) const;
  /// How far the tip goes from where it begins [m].
  double travel() const;
  /// "path:line" of a row, or "path: at 1.2 s".
  std::string place(std::size_t row) const;
};

/// The commanded tip and jaw of a recording; the measured tip where no command was recorded, which
/// is told. `path`: of the recording. Commands given for the dVRK control point are moved to the
/// jaw tip of `mount`. Throws Error: place and what was expected; what is odd is appended to
/// `warnings`.
ToolTrack tool_track_of(const Recording& recording, const std::string& path, const ToolMount& mount,
                        std::vector<std::string>& warnings);

/// The track against the arm and the tissue of a scene: throws Error for a start that the arm does
/// not reach and a tip that is nowhere near; a later place out of reach is a warning, since what
/// was commanded is what is replayed.
void check_reach(const ToolTrack& track, const Scene& scene, std::vector<std::string>& warnings);

}  // namespace omentum
