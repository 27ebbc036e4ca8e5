#pragma once

#include <array>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "sim_worker/playback/simulate.h"

namespace omentum {

/// Estimate of the error that the mesh of a reference leaves (docs/decisions/0030).
struct MeshError {
  double rms_m = 0;        ///< over all points and times
  double worst_rms_m = 0;  ///< of the worst time
  double force = 0;  ///< rms over the times, relative to the rms of the force; 0 without force
};

/// From `fine`, a recording on `mesh` with `cells` along x, y and z, and what `run` makes of the
/// same commands on two coarser meshes: with cells 1.5 times as long, and with fewer layers
/// besides. The error falls with the square of the cell, as that of a bent element's chord, and
/// with the cube of the layer. None where the first of them fails; what is missing is told in
/// `warnings`.
std::optional<MeshError> find_mesh_error(
    const SimulatedRecording& fine, const pb::ReferenceModel& mesh, const std::array<int, 3>& cells,
    const std::function<SimulatedRecording(const pb::ReferenceModel&)>& run,
    std::vector<std::string>& warnings);

}  // namespace omentum
