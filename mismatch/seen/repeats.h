#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "mismatch/recording/recording.h"
#include "mismatch/seen/observation.h"

namespace omentum {

/// What the clouds of a recording show beyond what a model makes of its own commands: mean distance
/// of the points from the simulated upper face along its normal [m], in 4 x 4 cells of the body at
/// rest, a row a frame, NaN where a cell has fewer than five points within 25 mm. Repeats whose
/// commands differ are compared by these. `surfaces`: vertices of every frame as those of
/// close_sheet() [m], empty where the simulation did not get.
Series residuals_of_surfaces(const Observation& seen, const Scene& scene,
                             std::span<const std::vector<Eigen::Vector3d>> surfaces);

}  // namespace omentum
