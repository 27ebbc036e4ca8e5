#pragma once

#include <Eigen/Core>

#include "sim_worker/backend/sim_setup.h"
#include "sim_worker/instrument/jaw.h"

namespace omentum {

/// The contact of a jaw at `tip`, p_WT [m], with the tissue of one lane: what judge_pinch() asks
/// for. `nearest`: the particle of the tissue nearest to the tip; `jaw_deg`: angle of the jaw.
PinchContact pinch_contact(const SimSetup& setup, const Tissue<float>& tissue, int lane,
                           const Eigen::Vector3d& tip, const Nearest& nearest, double jaw_deg);

}  // namespace omentum
