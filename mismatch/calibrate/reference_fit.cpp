#include "mismatch/calibrate/reference_fit.h"

#include <utility>

#include "sim_worker/playback/simulation.h"

namespace omentum {

std::vector<Prediction> ReferenceFit::predict_all(const FitState& state, const Numerics& numerics,
                                                  bool with_columns,
                                                  const std::vector<std::size_t>& which) {
  std::vector<Prediction> predictions;
  const auto simulate_all = [&] {
    predictions.assign(observations.size(), {});
    Numerics with = numerics;
    with.slip_speed_m_per_s = slip_speed_;
    run_parallel(which.size(), options.simulator->at_once(), [&](std::size_t k) {
      predictions[which[k]] = predict_one(state, which[k], with, with_columns);
    });
    std::ptrdiff_t valid = 0;
    for (const std::size_t r : which) valid += count_valid(predictions[r]);
    return valid;
  };
  std::size_t wanted = 0;
  for (const std::size_t r : which) wanted += observations[r].frames.size();
  const std::ptrdiff_t valid = simulate_all();
  // Large cells that rub may not come to rest under sharp friction. What is smooth once stays so:
  // the difference of two simulations must not be one of friction.
  constexpr double kSmooth = 1e-4;  // [m/s]
  if (valid < static_cast<std::ptrdiff_t>(wanted) && slip_speed_ < kSmooth &&
      numerics.model == pb::TISSUE_REFERENCE) {
    const std::vector<Prediction> sharp = std::move(predictions);
    slip_speed_ = kSmooth;
    if (simulate_all() <= valid) {
      slip_speed_ = 0;
      predictions = sharp;
    }
  }
  return predictions;
}

}  // namespace omentum
