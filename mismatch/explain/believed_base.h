#pragma once

#include <vector>

#include "mismatch/explain/base_fit.h"

namespace omentum {

/// A point farther from the surface is no tissue [m].
inline constexpr double kTissueReach = 0.015;

/// Where fit_base() begins: the scene as believed, meshes and stated scales; nothing is simulated.
/// Throws Error where nothing can be fitted.
BaseFit believed_base(const pb::Scene& scene, std::vector<Observation> observations,
                      const ExplainOptions& options);

}  // namespace omentum
