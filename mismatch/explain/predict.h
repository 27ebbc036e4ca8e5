#pragma once

#include <string>
#include <vector>

#include "mismatch/explain/explain.h"

namespace omentum {

/// Surfaces that two scenes foretell of commands.
struct Foretold {
  std::vector<PredictedRecording> recordings;  ///< in the order of the observations; nothing seen
  std::vector<std::string> failures;           ///< why each ends before its commands do, or empty
  std::vector<Eigen::Vector2d> uv_B;           ///< places of the grid, x_B, y_B at rest [m]
};

/// The upper face in the frame of the clouds at the frames of `observations`, of which no point is
/// looked at, by the reference on a mesh of `tolerance_m`, without and with what was named: `base`
/// and `model` are scenes that explain() left, registration and clock of the camera in them. The
/// same on any number of threads. Throws Error for a scene that cannot be.
Foretold predict_commands(const pb::Scene& base, const pb::Scene& model,
                          const std::vector<Observation>& observations, const FitSetup& setup,
                          double tolerance_m);

}  // namespace omentum
