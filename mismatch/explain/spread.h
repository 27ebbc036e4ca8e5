#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "mismatch/evidence/evidence.h"

namespace omentum {

/// Standard deviations of shared numbers, numerics and nuisances integrated: beside the
/// posterior's, how far the recordings would still move them from where they are, and how far
/// leaving out one fold after the other does (jackknife, with three folds or more). A model that is
/// not quite right contradicts itself from recording to recording, of which no posterior knows.
/// `folds` [recordings] as in make_folds(). It fails on an unknown number and where evidence does
/// not determine one.
Result<std::vector<double>> spread_of(std::span<const std::string> keys,
                                      std::span<const Evidence> recordings,
                                      std::span<const std::string> folds);

}  // namespace omentum
