#pragma once

#include "sim_worker/reference/reference_model.h"

namespace omentum {

/// Frees the clamped nodes that the effects of the anchor release: with a compliance they lie on a
/// bed, else one that is detached in part gets the spring of a grasp that covers it in part, as in
/// the shell. Throws Error where nothing is held any more.
void release_anchors(ReferenceTissueModel& model);

}  // namespace omentum
