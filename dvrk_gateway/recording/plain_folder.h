#pragma once

#include <string>

namespace omentum {

/// Writes the plain folder (docs/formats.md 3) of an MCAP file of a robot, as `mismatch` reads it:
/// recording.txtpb, tool.csv, joints.csv, the scene, and force.csv, markers.csv, tracker.csv,
/// clouds where the file has them. Times are log times. A commanded value is the goal sent in the
/// last 0.1 s, else the robot's set-point, which it then holds. Throws Error, one line: the folder
/// is there already, the file cannot be read or has no sample of the tool.
void write_plain_folder(const std::string& mcap_path, const std::string& folder);

}  // namespace omentum
