#include <utility>

#include "mismatch/fit/forward_model.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {

std::vector<Prediction> ForwardModel::simulate(const FitData& data, const FitState& state,
                                               const Numerics& numerics, bool with_columns,
                                               const Which& which) {
  std::vector<Prediction> predictions = predict_all(data, state, numerics, with_columns, which);
  for (const std::size_t r : which) {
    for (std::size_t f = 0; f < predictions[r].frames.size(); ++f) {
      PredictedFrame& frame = predictions[r].frames[f];
      if (frame.columns.size() == 0) continue;
      for (const DifferenceColumn& d : data.differences) {
        if (d.by[r][f].size() > 0) frame.columns.col(d.column) = d.by[r][f];
      }
    }
  }
  return predictions;
}

Linearisation ForwardModel::linearise(const FitData& data, const FitState& state,
                                      const Numerics& numerics, const Which& which) {
  return {state, simulate(data, state, numerics, true, which)};
}

std::vector<Prediction> ReferenceForward::predict_all(const FitData& data, const FitState& state,
                                                      const Numerics& numerics, bool with_columns,
                                                      const Which& which) {
  std::vector<Prediction> predictions;
  const auto simulate_all = [&] {
    predictions.assign(data.observations.size(), {});
    Numerics with = numerics;
    with.slip_speed_m_per_s = slip_speed_;
    run_parallel(which.size(), data.setup.simulator->at_once(), [&](std::size_t k) {
      predictions[which[k]] = predict_at(data, state, which[k], with, with_columns);
    });
    std::ptrdiff_t valid = 0;
    for (const std::size_t r : which) valid += count_valid(predictions[r]);
    return valid;
  };
  std::size_t wanted = 0;
  for (const std::size_t r : which) wanted += data.observations[r].frames.size();
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
  if (with_columns && holds_pad(data.scene))
    add_pad_columns(data, state, numerics, which, predictions);
  return predictions;
}

void ReferenceForward::add_pad_columns(const FitData& data, const FitState& state,
                                       const Numerics& numerics, const Which& which,
                                       std::vector<Prediction>& predictions) {
  constexpr double kStep = 1e-3;  // [m] of the pad: what its place is believed to
  if (pad_elements_ != numerics.elements) pad_columns_.clear();
  pad_elements_ = numerics.elements;
  pad_columns_.resize(data.observations.size());
  Which missing;
  for (const std::size_t r : which) {
    if (pad_columns_[r].size() != predictions[r].frames.size()) missing.push_back(r);
  }
  Numerics with = numerics;
  with.slip_speed_m_per_s = slip_speed_;
  std::vector<Prediction> moved(missing.size() * kOwnColumns);
  run_parallel(moved.size(), data.setup.simulator->at_once(), [&](std::size_t k) {
    const std::size_t r = missing[k / kOwnColumns];
    FitState there = state;
    there.own[r][static_cast<Eigen::Index>(k % kOwnColumns)] += kStep;
    moved[k] = predict_at(data, there, r, with, false);
  });
  for (std::size_t k = 0; k < moved.size(); ++k) {
    const std::size_t r = missing[k / kOwnColumns];
    const std::vector<PredictedFrame>& base = predictions[r].frames;
    pad_columns_[r].resize(base.size());
    for (std::size_t f = 0; f < base.size(); ++f) {
      if (base[f].valid && moved[k].frames[f].valid) {
        pad_columns_[r][f][k % kOwnColumns] = difference(moved[k].frames[f], base[f], 1 / kStep);
      }
    }
  }
  for (const std::size_t r : which) {
    for (std::size_t f = 0; f < predictions[r].frames.size(); ++f) {
      PredictedFrame& frame = predictions[r].frames[f];
      for (int k = 0; k < kOwnColumns && frame.columns.size() > 0; ++k) {
        const Eigen::VectorXf& by = pad_columns_[r][f][static_cast<std::size_t>(k)];
        if (by.size() > 0) frame.columns.col(data.layout.unknowns.count + k) = by;
      }
    }
  }
}

}  // namespace omentum
