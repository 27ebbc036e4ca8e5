#pragma once

#include <cstdint>
#include <optional>

#include "core/backend.h"
#include "core/rng.h"
#include "proto/config.pb.h"

namespace omentum {

/// What is drawn for an episode from the ranges of config.randomise. Pure functions: every worker
/// draws the same, and the learner knows it.

/// What the draws of an episode follow from.
struct DrawKey {
  std::uint64_t run_seed = 0;
  std::uint32_t slot = 0;
  std::uint64_t episode = 0;
  Purpose purpose = Purpose::kDynamics;
  std::optional<int> alone;  ///< index in config.randomise: the others stay as the scene has them
};

/// The key of an episode; none where its scene is that of the configuration. Training draws by slot
/// and episode. StartSet::kGridDrawn draws by the start of the grid, with draws of its own: of
/// `grid_starts` = n starts, start_index below n draws everything, n (1 + k) + start draws
/// parameter k alone, with the value that it has in the first. Aborts for such a start without a
/// grid.
std::optional<DrawKey> draw_key(const EpisodeStart& start, std::size_t grid_starts);

bool is_drawn(const DrawKey& key, int parameter);

/// The value of config.randomise(parameter), in its unit. Precondition: there is such a parameter.
double drawn_value(const pb::Config& config, int parameter, const DrawKey& key);

}  // namespace omentum
