#pragma once

#include "mismatch/evidence/evidence.h"
#include "mismatch/fit/search.h"

namespace omentum {

/// What a recording says of the numbers of a fit, as changes from `at`: its normal equations there
/// with names and beliefs, each row worth `information` (row_information()). Numerics are each
/// recording's own. Modes that are not looked for are left out. An atom's effect is its name up to
/// the first dot.
Evidence evidence_of(const FitData& data, const NormalEquations& equations, const SearchState& at,
                     std::size_t recording, double information);

}  // namespace omentum
