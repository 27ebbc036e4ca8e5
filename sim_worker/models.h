#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/reference/reference_model.h"

namespace omentum {

/// The model that the scene names (scene.tissue.model). Throws Error where the scene does not fit
/// it; remarks are appended to `warnings`. The mesh of the reference is graded at `pinches`.
std::shared_ptr<const TissueModel> make_tissue_model(const Scene& scene, double control_period,
                                                     std::vector<std::string>& warnings,
                                                     std::span<const PinchCircle> pinches = {});

/// Widest kernel this CPU runs, or the one of the asked width (1, 8, 16; 0 = widest). Throws Error
/// if it cannot.
const LaneKernel<float>& choose_kernel(unsigned width);

}  // namespace omentum
