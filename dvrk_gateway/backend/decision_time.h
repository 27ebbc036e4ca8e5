#pragma once

#include "core/config.h"
#include "core/policy.h"
#include "core/result.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {

/// Of one decision on this machine, policy included [s]: the median of some in `scene`, one lane,
/// which it moves.
double measure_decision_s(SimBackend& scene, Policy& policy);

/// A decision that takes so long is ready in the control periods it is for; else one line with what
/// it needs, what is allowed and what to do.
Result<void> check_decision_time(const pb::Task& task, double decision_s);

}  // namespace omentum
