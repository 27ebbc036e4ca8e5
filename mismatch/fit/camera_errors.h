#pragma once

#include "mismatch/fit/fit_data.h"

// Registration and clock of the camera, which a fit has among its nuisances and a scene in its
// depth sensor.
namespace omentum {

/// Those of a state into the scene.
void set_camera_errors(const FitData& data, const FitState& state, pb::Scene& scene);
/// Those of the scene into a state.
void take_camera_errors(const FitData& data, const pb::Scene& scene, FitState& state);

}  // namespace omentum
