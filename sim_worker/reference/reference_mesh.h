#pragma once

#include "sim_worker/reference/reference_model.h"

namespace omentum {

/// Grid lines and nodes of the model of a scene's sheet, and which of these a clamp holds
/// (docs/decisions/0030): denser at the edge of each clamp and at the sides of the pinches, with a
/// line on each of them; where numerics states no count of cells, as fine as its tolerance_m asks
/// for. With `mesh_of` the lines along x and y are that model's, with as many layers. Takes body,
/// numerics, material, effects and surroundings of the model; throws Error where nothing holds the
/// sheet any more.
void make_mesh(const Scene& scene, std::span<const PinchCircle> pinches,
               const ReferenceTissueModel* mesh_of, ReferenceTissueModel& model);

}  // namespace omentum
