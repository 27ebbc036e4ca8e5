#pragma once

#include <string>
#include <vector>

#include "mismatch/calibrate/observation.h"
#include "mismatch/recording/recording.h"

namespace omentum {

/// What the clouds of a recording show beyond what the scene's model makes of its own commands:
/// mean distance of the points from the simulated upper face along its normal [m], in 4 x 4 cells
/// of the body at rest, a row a frame, NaN where a cell has fewer than five points within 25 mm.
/// Repeats whose commands differ are compared by these. `why` says where the simulation ends early.
/// Throws Error for a scene that cannot be simulated.
Series residuals_of_model(const Observation& seen, const pb::Scene& scene,
                          const std::string& folder, std::string& why);

}  // namespace omentum
