#pragma once

#include "mismatch/intake/intake.h"

namespace omentum {

/// Offset of `b` against `a` between two times [s] by the largest correlation of their main
/// motions, within 1 s and a quarter of the time. False where nothing moves, there are too few
/// samples or no peak. `sd_s` takes as many samples to be independent as what is left over says.
bool find_offset(const Series& a, const Series& b, double begin, double end, ClockFigures& figures);

}  // namespace omentum
