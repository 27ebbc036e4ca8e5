#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

#include "core/output_folder.h"
#include "mismatch/simulate.h"
#include "proto/recording_folder.pb.h"

namespace omentum {

/// Point cloud of one moment of a simulated recording, p_W [m].
using CloudOf = std::function<std::vector<Eigen::Vector3f>(std::size_t step)>;

/// Fills and finishes a folder with a recording (docs/formats.md 3): recording.txtpb, tool.csv,
/// joints.csv (where the arm has effects), force.csv, markers.csv with every node, and clouds.csv
/// with clouds/*.ply every `cloud_stride` steps (0 = none). Precondition: folder.begin(). Throws
/// Error.
void write_recording(OutputFolder& folder, const pb::RecordingInfo& info, const ToolTrack& commands,
                     const SimulatedRecording& recording, const CloudOf& cloud,
                     std::size_t cloud_stride);

}  // namespace omentum
