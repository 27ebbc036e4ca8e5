#pragma once

#include <vector>

#include "mismatch/explain/base_fit.h"
#include "mismatch/explain/drawn_clouds.h"
#include "proto/verdict.pb.h"

namespace omentum {

/// Limits of commands that were not run yet (docs/mismatch.md 5.9): the believed scene is simulated
/// under them, clouds of it are drawn, and what explain() would know of every effect is asked by
/// the same evidence. Frames of `observations` have times alone. Of the verdict there are settings,
/// recordings, limits and warnings. The same on any number of threads. Throws Error where nothing
/// can be simulated.
pb::Verdict planned_limits(const pb::Scene& scene, std::vector<Observation> observations,
                           const ExplainOptions& options, const DrawnClouds& clouds);

}  // namespace omentum
