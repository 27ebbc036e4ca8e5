#pragma once

#include <filesystem>
#include <vector>

#include "mismatch/explain/explain.h"

namespace omentum {

/// A file NAME.npz of every recording in a new folder (docs/formats.md 15). `uv_B`: places of the
/// grid of `scene`. Throws Error.
void write_predictions(const std::vector<PredictedRecording>& recordings,
                       const std::vector<Eigen::Vector2d>& uv_B, const pb::Scene& scene,
                       const std::filesystem::path& folder);

}  // namespace omentum
