#pragma once

#include <Eigen/Geometry>
#include <string>

#include "proto/recording_folder.pb.h"

namespace omentum {

/// recording.txtpb of a recording folder (docs/formats.md 3); defaults where there is no such file.
/// Throws Error with file:line:column for what is unknown or cannot be meant: units other than SI,
/// a frame other than W without the transform of tool.csv, a transform that is none.
pb::RecordingInfo read_recording_info(const std::string& folder);

/// X_WF of the frame F of a file of the folder, as the recording states it; else the identity.
Eigen::Isometry3d transform_to_world(const pb::RecordingInfo& info, const std::string& file);

}  // namespace omentum
