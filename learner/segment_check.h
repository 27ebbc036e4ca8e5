#pragma once

#include "core/policy.h"
#include "core/result.h"
#include "core/types.h"

namespace omentum {

/// Checks a segment of any content against its task: identity, number of steps, lengths of all
/// arrays, finite numbers, range of actions and flags, order of episode ends, hash of the end
/// state, CRC. A rollout that passes and did not fail (a lane went non-finite) can be assembled
/// into a batch, an evaluation judged and recorded, without further checks; of a failed one the
/// count of episodes is valid. Precondition: task.steps is within the bounds of the wire.
Result<void> check_segment(const RolloutSegment& segment, const PolicyShape& shape,
                           const RolloutTask& task);

}  // namespace omentum
