#pragma once

#include <functional>
#include <span>
#include <vector>

#include "core/backend.h"
#include "core/policy.h"
#include "core/types.h"

namespace omentum {

/// The one rollout loop. Runs `tasks` (at most backend.lanes(), all of the same policy version,
/// kind and length) to their end and returns one segment per task in the same order. segment =
/// run_task(policy, task): the result of a task does not depend on the other tasks, the backend's
/// lane count, or anything outside the arguments. `stop` is polled once per step; when it turns
/// true the loop returns an empty vector (nothing half-done). With `recorded` a single task takes
/// these actions, one per step, in place of those of the policy: a replay.
std::vector<RolloutSegment> run_rollout(Backend& backend, Policy& policy,
                                        std::span<const RolloutTask> tasks,
                                        const std::function<bool()>& stop,
                                        std::span<const Action> recorded = {});

}  // namespace omentum
