#pragma once

#include <string>
#include <vector>

#include "core/psm.h"
#include "mismatch/recording/recording.h"
#include "sim_worker/playback/tool_track.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

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
