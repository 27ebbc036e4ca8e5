#pragma once

#include <memory>
#include <string>
#include <vector>

#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// The model that the scene names (scene.tissue.model). Throws Error where the scene does not fit
/// it; remarks are appended to `warnings`.
std::shared_ptr<const TissueModel> make_tissue_model(const Scene& scene, double control_period,
                                                     std::vector<std::string>& warnings);

/// Widest kernel this CPU runs, or the one of the asked width (1, 8, 16; 0 = widest). Throws Error
/// if it cannot.
const LaneKernel<float>& choose_kernel(unsigned width);

}  // namespace omentum
