#pragma once

#include <Eigen/Core>

#include "sim_worker/backend/sim_setup.h"
#include "sim_worker/instrument/jaw.h"

namespace omentum {

/// A jaw in W: its tip, p_WT [m], direction from C to T, and angle.
struct Jaw {
  Eigen::Vector3d tip, direction;
  double angle_deg = 0;
};

/// The contact of a jaw with the tissue of one lane: what judge_pinch() asks for. `nearest`: the
/// particle of the tissue nearest to the tip.
PinchContact pinch_contact(const SimSetup& setup, const Tissue<float>& tissue, int lane,
                           const Jaw& jaw, const Nearest& nearest);

}  // namespace omentum
