#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "core/psm.h"
#include "proto/recording_folder.pb.h"

namespace omentum {

/// What the tool was told to do in a recording: the path of the jaw tip T and the jaw.
struct ToolTrack {
  std::vector<double> time;           ///< [s], increasing
  std::vector<Eigen::Vector3d> p_WT;  ///< commanded jaw tip in W [m]
  std::vector<double> jaw_rad;        ///< full opening angle commanded; empty = not recorded

  double begin() const { return time.front(); }
  double end() const { return time.back(); }
  /// Linear between rows, constant before the first and after the last.
  Eigen::Vector3d tip_at(double t) const;
  /// Of the last row at or before t (a jaw command is a step).
  double jaw_at(double t) const;
};

/// recording.txtpb of a recording folder; defaults where there is no such file. Throws Error with
/// file:line:column.
pb::RecordingInfo read_recording_info(const std::string& folder);

/// tool.csv of a recording folder. Commands given for the dVRK control point are moved to the jaw
/// tip of `mount`. Throws Error: file, line, column and what was expected.
ToolTrack read_tool_track(const std::string& folder, const pb::RecordingInfo& info,
                          const ToolMount& mount);

}  // namespace omentum
