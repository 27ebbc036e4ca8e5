#pragma once

#include <span>
#include <string>
#include <vector>

#include "mismatch/evidence/evidence.h"

namespace omentum {

/// How far the fit moves a number from what was believed.
struct Pull {
  std::string key;
  std::string owner;  ///< recording; empty: shared
  NumberRole role = NumberRole::kNuisance;
  double value = 0;  ///< posterior mean [unit of the number]
  double pull = 0;   ///< from the prior's mean, in the prior's standard deviations

  std::string name() const { return owner.empty() ? key : owner + ": " + key; }
};

/// Nuisances and numerics have pulls in the fit to all recordings, atoms at zero (docs/mismatch.md
/// 5.4); free numbers have none. The largest stands first, equal ones by key and owner.
Result<std::vector<Pull>> pulls(std::span<const Evidence> recordings);

}  // namespace omentum
