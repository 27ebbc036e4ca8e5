#include "learner/advantage.h"

#include <cmath>

#include "core/check.h"

namespace omentum {

void estimate_advantages(const Batch& batch, std::span<const float> rewards,
                         const AdvantageSettings& settings, std::span<float> advantages,
                         std::span<float> returns) {
  const auto steps = static_cast<std::size_t>(batch.steps);
  OMENTUM_CHECK(rewards.size() == batch.rows() && advantages.size() == batch.rows() &&
                returns.size() == batch.rows());
  OMENTUM_CHECK(batch.bootstrap_values.size() == static_cast<std::size_t>(batch.slots),
                "batch is not completed");
  for (std::size_t slot = 0; slot < static_cast<std::size_t>(batch.slots); ++slot) {
    double later = 0;  // advantage of the next step
    for (std::size_t step = steps; step-- > 0;) {
      const std::size_t row = slot * steps + step;
      const std::uint8_t flags = batch.flags[row];
      double next = static_cast<double>(step + 1 == steps ? batch.bootstrap_values[slot]
                                                          : batch.values[row + 1]);
      bool cut = step + 1 == steps;
      if ((flags & step_flag::kTerminated) != 0) {
        next = 0;
        cut = true;
      } else if ((flags & step_flag::kTruncated) != 0) {
        const auto index = static_cast<std::size_t>(batch.final_index[row]);
        next = settings.bootstrap_truncation ? static_cast<double>(batch.final_values[index]) : 0;
        cut = true;
      } else if (settings.time_horizon != 0 &&
                 (batch.episode_step[row] + 1) % settings.time_horizon == 0) {
        cut = true;
      }
      const auto value = static_cast<double>(batch.values[row]);
      const double delta = static_cast<double>(rewards[row]) + settings.gamma * next - value;
      later = delta + (cut ? 0 : settings.gamma * settings.lambda * later);
      advantages[row] = static_cast<float>(later);
      returns[row] = static_cast<float>(later + value);
    }
  }
}

std::vector<float> discounted_returns(std::span<const std::uint8_t> flags,
                                      std::span<const float> rewards, double gamma) {
  OMENTUM_CHECK(flags.size() == rewards.size());
  std::vector<float> returns(rewards.size());
  double after = 0;
  for (std::size_t row = rewards.size(); row-- > 0;) {
    const auto reward = static_cast<double>(rewards[row]);
    if ((flags[row] & step_flag::kTerminated) != 0) {
      after = 0;
    } else if ((flags[row] & step_flag::kTruncated) != 0) {
      after = gamma < 1 ? reward / (1 - gamma) : 0;
    }
    after = reward + gamma * after;
    returns[row] = static_cast<float>(after);
  }
  return returns;
}

MeanDeviation mean_deviation(std::span<const float> values, std::span<const std::uint32_t> indices,
                             bool population) {
  const std::size_t count = indices.empty() ? values.size() : indices.size();
  const auto at = [&](std::size_t i) {
    return static_cast<double>(indices.empty() ? values[i] : values[indices[i]]);
  };
  double sum = 0;
  for (std::size_t i = 0; i < count; ++i) sum += at(i);
  const auto n = static_cast<double>(count);
  MeanDeviation result;
  result.mean = sum / n;
  double squares = 0;
  for (std::size_t i = 0; i < count; ++i) squares += (at(i) - result.mean) * (at(i) - result.mean);
  const double divisor = population ? n : n - 1;
  result.deviation = divisor > 0 ? std::sqrt(squares / divisor) : 0;
  return result;
}

}  // namespace omentum
