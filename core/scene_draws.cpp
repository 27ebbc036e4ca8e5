#include "core/scene_draws.h"

#include "core/check.h"

namespace omentum {

std::optional<DrawKey> draw_key(const EpisodeStart& start, std::size_t grid_starts) {
  if (start.start_set == StartSet::kTraining)
    return DrawKey{start.run_seed, start.slot, start.episode, Purpose::kDynamics, std::nullopt};
  if (start.start_set != StartSet::kGridDrawn) return std::nullopt;
  OMENTUM_CHECK(grid_starts > 0, "start {} of no grid", start.start_index);
  const auto starts = static_cast<std::uint32_t>(grid_starts);
  DrawKey key{start.run_seed, start.start_index % starts, 0, Purpose::kEvaluationDynamics,
              std::nullopt};
  if (start.start_index >= starts) key.alone = static_cast<int>(start.start_index / starts) - 1;
  return key;
}

bool is_drawn(const DrawKey& key, int parameter) { return !key.alone || *key.alone == parameter; }

double drawn_value(const pb::Config& config, int parameter, const DrawKey& key) {
  const pb::Randomise& range = config.randomise(parameter);
  const PhiloxWords words = random_words(key.run_seed, key.slot, key.purpose,
                                         static_cast<std::uint32_t>(parameter), key.episode, 0);
  return uniform_between(words[0], range.min(), range.max());
}

}  // namespace omentum
