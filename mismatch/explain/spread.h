#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "mismatch/evidence/evidence.h"

namespace omentum {

/// What recordings say of numbers that they share, numerics and nuisances integrated.
struct Spread {
  /// Standard deviations: beside the posterior's, how far the recordings would still move a number
  /// from where it is, and how far leaving out one fold after the other does (jackknife). A model
  /// that is not quite right contradicts itself from recording to recording, of which no posterior
  /// knows.
  std::vector<double> sd;
  /// The variance of that jackknife over the posterior's, the mean over all directions of these
  /// numbers; at least 1. It does not depend on their scales.
  double dispersion = 1;
};

/// `folds` [recordings] as in make_folds(); a jackknife needs three. It fails on an unknown number
/// and where evidence does not determine one.
Result<Spread> spread_of(std::span<const std::string> keys, std::span<const Evidence> recordings,
                         std::span<const std::string> folds);

}  // namespace omentum
