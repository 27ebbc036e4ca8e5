#pragma once

#include <map>
#include <optional>
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

/// The farthest pull that no fold is alone with, of `pulls` in their order: of a shared number, or
/// of one that recordings have of their own the farthest of a second fold. With fewer than five
/// folds simply the first. Nothing where there is none. `folds` of recordings, by their names.
std::optional<Pull> repeated_pull(std::span<const Pull> pulls,
                                  const std::map<std::string, std::string>& folds);

/// Nuisances and numerics have pulls in the fit to all recordings, atoms at zero (docs/mismatch.md
/// 5.4); free numbers have none. The largest stands first, equal ones by key and owner.
Result<std::vector<Pull>> pulls(std::span<const Evidence> recordings);

}  // namespace omentum
