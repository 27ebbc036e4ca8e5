#pragma once

#include <optional>
#include <vector>

#include "mismatch/explain/base_fit.h"

namespace omentum {

/// The force on the tool at one frame, in W [N].
struct ForceRow {
  Eigen::Vector3d seen, base, model;  ///< recorded; foretold by two fits of the clouds
  double change = 0;                  ///< how fast the recorded one changes [N/s]
};

/// Forces on the tool, which no fit of explain sees, against those that two fits of the clouds
/// foretell (docs/mismatch.md 5.6).
struct ForceChannel {
  std::size_t rows = 0;        ///< frames with a force while the tissue is held away from rest
  double base = 0, model = 0;  ///< rms of what each leaves [N]
  double gain = 0;             ///< log density that `model` adds, trimmed over recordings [nats]
  bool contradicts = false;    ///< the gain is clearly below zero
};

/// Rows of recordings that were fitted and have a force, while the tool is away from where it
/// began: before that the force is that of jaws on what lies below.
std::vector<std::vector<ForceRow>> force_rows(const BaseFit& base, const BaseFit& model);

/// Each fit has one factor of its own on all forces: clouds tell a stiffness against the weight
/// alone. Nothing of fewer than two recordings.
std::optional<ForceChannel> compare_forces(const std::vector<std::vector<ForceRow>>& recordings);

}  // namespace omentum
