#pragma once

#include "core/policy.h"
#include "core/result.h"
#include "core/types.h"

namespace omentum {

/// Whether a segment answers its task: everything a sender could get wrong. Identity, number of
/// steps, lengths of all arrays, finite numbers, range of actions and flags, order of episode ends,
/// hash of the end state, CRC. A rollout that passes and did not fail (a lane went non-finite) can
/// be assembled into a batch and learned from, an evaluation judged and recorded, without any
/// further check; of a failed one the count of its episodes is true. Total over arbitrary segments.
/// One line says what is wrong.
///
/// Before: task.steps is within the bounds of the wire.
Result<void> check_segment(const RolloutSegment& segment, const PolicyShape& shape,
                           const RolloutTask& task);

}  // namespace omentum
