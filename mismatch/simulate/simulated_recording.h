#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "mismatch/recording/recording.h"
#include "sim_worker/playback/simulate.h"

namespace omentum {

/// The cloud seen at a control step.
using CloudOf = std::function<Cloud(std::size_t step)>;

/// What a recording of the simulated set-up would hold, numbers to 1e-9 of their unit: commands,
/// encoders, joints where the arm has effects, force, markers (the particles) and, every
/// `cloud_stride` steps, a cloud (0 = none), which is made when it is fetched; `cloud` must live
/// until then.
Recording make_recording(const pb::RecordingInfo& info, const ToolTrack& commands,
                         const SimulatedRecording& simulated, const CloudOf& cloud,
                         std::size_t cloud_stride);

}  // namespace omentum
