#pragma once

#include <Eigen/Geometry>
#include <string>

#include "core/output_folder.h"
#include "mismatch/recording/recording.h"

namespace omentum {

/// A recording folder (docs/formats.md 3) with the believed scene of its case: scene_believed.txt
/// in it or beside it, or the file that recording.txtpb names. Stated transforms are applied:
/// everything is in W afterwards. Clouds and pictures stay in their files until they are fetched.
/// An empty cell is "not known". Throws Error, one line with file, line, character and what was
/// expected.
Recording read_recording_folder(const std::string& folder);

/// Writes a folder that is not there yet; it appears whole or not at all. Channels of one table are
/// joined by time, cells without a sample stay empty. Throws Error.
void write_recording_folder(const Recording& recording, const std::string& folder);
/// The same into a folder that holds other files too and is finished by the caller.
void write_recording_files(const Recording& recording, const OutputFolder& out);

/// Turns positions, orientations and forces of a table into another frame.
void transform_series(const Eigen::Isometry3d& X_WF, Series& series);

/// Points of a file .ply or .pcd [m]; what of it is not applied goes to `warnings`. Throws Error.
Cloud read_cloud_file(const std::string& path, std::vector<std::string>* warnings = nullptr);

/// Fetches PNG files; of depth only those of one channel of 16 bits.
std::function<std::string(std::size_t)> image_files(std::vector<std::string> paths, bool depth);

}  // namespace omentum
