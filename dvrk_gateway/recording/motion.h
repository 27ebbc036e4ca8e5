#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "core/result.h"

namespace omentum {

/// Where a recording wants the tip at one moment.
struct MotionSample {
  double t_s = 0;                                  ///< on the clock of the recording
  Eigen::Vector3d p_WT = Eigen::Vector3d::Zero();  ///< jaw tip in W [m]
  double jaw_rad = 0;                              ///< opening angle; NaN: not recorded
};

/// The motion of a recording, for replay: t_s increasing, all positions finite, two samples or
/// more. From an MCAP file: the goals of /tool_commanded, where there are none the poses of /tool;
/// the jaw of /jaw alike, held from one of its samples to the next. From tool.csv or the folder
/// that holds it (docs/formats.md 3): the columns tip_commanded, else tip_measured; moved to W as
/// recording.txtpb beside it says; rows up to 1 us back in time are left out with a warning, one of
/// 100 at most. Fails with one line: file, line or topic, and what was expected.
Result<std::vector<MotionSample>> load_motion(const std::string& path);

/// The same of the bytes of an MCAP file; the entry of the fuzz target. Total over any bytes.
Result<std::vector<MotionSample>> parse_motion(const std::string& name, const std::string& bytes);

}  // namespace omentum
