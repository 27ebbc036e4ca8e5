// Behaviour cloning [Pomerleau89] before PPO begins: the part of Ppo that learns from
// demonstrations.

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "learner/advantage.h"
#include "learner/ppo.h"

namespace omentum {

namespace {

/// Number of the batch for the shuffle's counter, which no update reaches.
constexpr std::uint64_t kDemonstrations = std::numeric_limits<std::uint32_t>::max();

}  // namespace

CloningStats Ppo::clone(Batch demonstrations) {
  const std::size_t rows = demonstrations.rows();
  OMENTUM_CHECK(updates_ == 0 && rows > 0 && demonstrations.slots == 1 &&
                demonstrations.observation_size == shape_.observations);
  normalise_inputs(demonstrations);
  rewards_ = demonstrations.rewards;
  if (settings_.scale_rewards()) {
    RewardScaler scaler(1, settings_.gamma());
    scaler.scale(demonstrations, rewards_);
    reward_scaler_.restore(scaler.moments(),
                           std::vector<double>(reward_scaler_.discounted().size(), 0.0));
  }
  returns_ = discounted_returns(demonstrations.flags, rewards_, settings_.gamma());
  advantages_.assign(rows, 0);
  // What the loss reads of a behaviour policy and maximum likelihood has no use for.
  demonstrations.log_probs.assign(rows, 0);
  demonstrations.branch_log_probs.assign(rows * shape_.columns(), 0);
  demonstrations.values = returns_;

  const auto count = static_cast<std::uint32_t>(rows);
  const std::uint32_t size = std::min(cloning_.minibatch(), count);
  const std::uint32_t epochs = cloning_.epochs();
  CloningStats stats;
  for (std::uint32_t epoch = 0; epoch < epochs; ++epoch) {
    const std::vector<std::uint32_t> order =
        shuffled_rows(run_seed_, kDemonstrations, epoch, count);
    Step step;
    step.learning_rate = cloning_.learning_rate() * (1 - static_cast<double>(epoch) / epochs);
    step.loss.likelihood = true;
    step.loss.entropy = 0;
    step.loss.value_coefficient = 1;
    LossSums sums;
    for (std::uint32_t first = 0; first < count; first += size) {
      const std::uint32_t samples = std::min(size, count - first);
      const MinibatchView view{&demonstrations,
                               inputs_,
                               advantages_,
                               0,
                               1,
                               returns_,
                               std::span(order).subspan(first, samples)};
      step.loss.per_sample = static_cast<float>(1.0 / samples);
      double norm = 0;
      sums.add(minibatch_step(view, step, norm));
      ++stats.minibatches;
    }
    stats.surprise = sums.policy_loss / sums.samples;
    stats.value_error = std::sqrt(sums.value_loss / sums.samples);
    if (epoch > 0) continue;
    stats.first_surprise = stats.surprise;
    stats.first_value_error = stats.value_error;
  }
  adam_ = Adam(settings_, layout_.count());
  return stats;
}

}  // namespace omentum
