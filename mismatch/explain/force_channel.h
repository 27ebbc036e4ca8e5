#pragma once

#include <optional>
#include <vector>

#include "mismatch/explain/base_fit.h"

namespace omentum {

/// Forces on the tool, which no fit of explain sees, against those that two fits of the clouds
/// foretell (docs/mismatch.md 5.6).
struct ForceChannel {
  std::size_t rows = 0;        ///< frames with a force while the tissue is held away from rest
  double base = 0, model = 0;  ///< rms of what each leaves [N]
  double gain = 0;             ///< log density that `model` adds, trimmed over recordings [nats]
  bool contradicts = false;    ///< the gain is clearly below zero
};

/// Each fit has one factor of its own on all forces: clouds tell a stiffness against the weight
/// alone. Nothing where fewer than two recordings have a force.
std::optional<ForceChannel> compare_forces(const BaseFit& base, const BaseFit& model);

}  // namespace omentum
