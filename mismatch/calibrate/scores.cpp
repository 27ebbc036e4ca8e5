#include "mismatch/calibrate/scores.h"

#include <algorithm>
#include <cmath>

namespace omentum {
namespace {

constexpr double kFarPoint = 0.03;  // [m] from the surface: no tissue, in figures of fit

double rms_of(const std::vector<std::vector<double>>& distances, double* mean = nullptr) {
  double squares = 0, sum = 0, count = 0;
  for (const auto& frame : distances) {
    for (const double d : frame) {
      if (!std::isfinite(d)) continue;
      squares += d * d;
      sum += std::fabs(d);
      ++count;
    }
  }
  if (mean != nullptr) *mean = sum / count;
  return std::sqrt(squares / count);  // NaN: nothing was simulated
}

}  // namespace

double floor_of(const Observation& seen, const NormalEquations& compared) {
  if (!seen.has_points()) {
    // Of markers that never rest, what is measured in holds is their motion.
    const double in_holds = std::sqrt(3) * seen.marker_noise;
    if (compared.marker_pairs == 0) return in_holds;
    const double changes = std::max(0.0, compared.marker_squares - compared.marker_products);
    return std::min(in_holds, std::sqrt(changes / static_cast<double>(compared.marker_pairs)));
  }
  std::vector<double> steps;
  for (std::size_t k = 1; k < compared.deviation.size(); ++k)
    steps.push_back(std::fabs(compared.deviation[k] - compared.deviation[k - 1]));
  if (steps.size() < 10) return 0;
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return 1.4826 * *middle / std::sqrt(2.0);
}

FitRow score(const FitData& data, const Linearisation& linear, const FitState& state,
             std::size_t recording, const Linearisation& believed) {
  FitRow row;
  row.recording = data.observations[recording].name;
  row.rmse_base = rms_of(distances(data, believed, believed.at, recording, kFarPoint));
  const auto now = distances(data, linear, state, recording, kFarPoint);
  row.rmse_model = rms_of(now, &row.mean_model);
  double far = 0, all = 0;
  for (const auto& frame : now) {
    for (const double d : frame) {
      far += std::isfinite(d) ? 0 : 1;
      ++all;
    }
  }
  row.far = all > 0 ? far / all : 0;
  return row;
}

void add_nuisances(const FitData& data, const Prediction& with_columns, const FitState& state,
                   Prediction& prediction) {
  Eigen::VectorXd x = state.shared.head(data.layout.unknowns.count);
  for (int k = 0; k < data.layout.unknowns.count; ++k) {
    if (data.unknowns[static_cast<std::size_t>(k)].simulated()) x[k] = 0;
  }
  const std::size_t frames = std::min(prediction.frames.size(), with_columns.frames.size());
  for (std::size_t f = 0; f < frames; ++f) {
    const Eigen::MatrixXf& columns = with_columns.frames[f].columns;
    PredictedFrame& frame = prediction.frames[f];
    if (columns.size() == 0 || !frame.valid) continue;
    const Eigen::VectorXf by = columns.leftCols(data.layout.unknowns.count) * x.cast<float>();
    for (std::size_t v = 0; v < frame.vertices.size(); ++v)
      frame.vertices[v] += by.segment<3>(3 * static_cast<Eigen::Index>(v)).cast<double>();
  }
}

ShownRecording show(const FitData& data, const Linearisation& linear, const FitState& state,
                    std::size_t recording, const Linearisation& believed) {
  ShownRecording shown;
  const Observation& seen = data.observations[recording];
  shown.name = seen.name;
  const FitState no_modes = without_difference(data, state, recording);
  const Comparison base = comparison(data, believed, believed.at, recording);
  const Comparison now = comparison(data, linear, no_modes, recording);
  const auto before = data.likelihood.distances(base, kFarPoint);
  const auto after = data.likelihood.distances(now, kFarPoint);
  for (std::size_t f = 0; f < seen.frames.size(); ++f) {
    const PredictedFrame& frame = now.predicted.frames[f];
    if (!base.predicted.frames[f].valid || !frame.valid) continue;
    shown.times.push_back(seen.frames[f].t);
    shown.before.push_back(data.likelihood.vertices(base, f));
    shown.after.push_back(data.likelihood.vertices(now, f));
    shown.tip.push_back(frame.tip);
    shown.rmse_before.push_back(rms_of({before[f]}));
    shown.rmse_after.push_back(rms_of({after[f]}));
    shown.seen.push_back(seen.frames[f].points);
    for (const SeenMarker& marker : seen.frames[f].markers) shown.seen.back().push_back(marker.p);
  }
  return shown;
}

}  // namespace omentum
