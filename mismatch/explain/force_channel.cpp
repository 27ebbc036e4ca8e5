#include "mismatch/explain/force_channel.h"

#include <algorithm>
#include <cmath>

#include "mismatch/explain/left_out_gains.h"
#include "mismatch/fit/frame_rows.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

/// Standard deviation of each row [N].
std::vector<double> spreads_of(const std::vector<ForceRow>& rows) {
  constexpr double kSensor = 2e-3;  // [N]
  constexpr double kClock = 0.05;   // [s] between camera and sensor
  constexpr double kModels = 0.05;  // of the largest: what two correct models differ by
  double largest = 0;
  for (const ForceRow& row : rows) largest = std::max(largest, row.seen.norm());
  std::vector<double> sd;
  for (const ForceRow& row : rows)
    sd.push_back(std::hypot(kClock * row.change, kSensor, kModels * largest));
  return sd;
}

/// - log density of the rows with forces times `factor`.
double cost_of_rows(const std::vector<ForceRow>& rows, Vector3d ForceRow::*foretold,
                    double factor) {
  constexpr double kFreedom = 4;
  const std::vector<double> sd = spreads_of(rows);
  double cost = 0;
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const Vector3d e = (rows[k].seen - factor * rows[k].*foretold) / sd[k];
    for (int axis = 0; axis < 3; ++axis) cost += cost_of(e[axis] * e[axis], kFreedom);
  }
  return cost;
}

/// The factor that fits best, by Gauss and Newton with weights of Student's t.
double factor_of(const std::vector<std::vector<ForceRow>>& recordings,
                 Vector3d ForceRow::*foretold) {
  constexpr int kSteps = 20;
  constexpr double kFreedom = 4, kBelieved = 0.1;  // density and calibration of the sensor
  double factor = 1;
  for (int step = 0; step < kSteps; ++step) {
    double information = 1 / (kBelieved * kBelieved), score = information;
    for (const std::vector<ForceRow>& rows : recordings) {
      const std::vector<double> sd = spreads_of(rows);
      for (std::size_t k = 0; k < rows.size(); ++k) {
        const Vector3d seen = rows[k].seen / sd[k], foretells = rows[k].*foretold / sd[k];
        for (int axis = 0; axis < 3; ++axis) {
          const double e = seen[axis] - factor * foretells[axis];
          const double weight = weight_of(e * e, kFreedom);
          information += weight * foretells[axis] * foretells[axis];
          score += weight * foretells[axis] * seen[axis];
        }
      }
    }
    factor = score / information;
  }
  return factor;
}

}  // namespace

std::vector<std::vector<ForceRow>> force_rows(const BaseFit& base, const BaseFit& model) {
  constexpr double kAway = 1e-3;  // [m]
  std::vector<std::vector<ForceRow>> recordings;
  for (const std::size_t r : base.fitted) {
    std::vector<ForceRow> rows;
    const std::vector<PredictedFrame>& before = base.surfaces[r].frames;
    const std::vector<PredictedFrame>& after = model.surfaces[r].frames;
    for (std::size_t f = 0; f < std::min(before.size(), after.size()); ++f) {
      const std::optional<SeenForce>& seen = base.forces[r][f];
      if (!seen || !before.front().valid || !before[f].valid || !after[f].valid) continue;
      if ((before[f].tip - before.front().tip).norm() < kAway) continue;
      rows.push_back({seen->value, before[f].force, after[f].force, seen->change});
    }
    if (!rows.empty()) recordings.push_back(std::move(rows));
  }
  return recordings;
}

std::optional<ForceChannel> compare_forces(const std::vector<std::vector<ForceRow>>& recordings) {
  if (recordings.size() < 2) return std::nullopt;
  const double before = factor_of(recordings, &ForceRow::base);
  const double after = factor_of(recordings, &ForceRow::model);
  ForceChannel made;
  std::vector<double> gains;
  for (const std::vector<ForceRow>& rows : recordings) {
    // What models differ by is alike in the frames of about half a second, and in the axes.
    constexpr double kAlike = 15;
    gains.push_back((cost_of_rows(rows, &ForceRow::base, before) -
                     cost_of_rows(rows, &ForceRow::model, after)) /
                    kAlike);
    made.rows += rows.size();
    for (const ForceRow& row : rows) {
      made.base += (row.seen - before * row.base).squaredNorm();
      made.model += (row.seen - after * row.model).squaredNorm();
    }
  }
  constexpr double kClear = 5;  // [nats]
  made.base = std::sqrt(made.base / static_cast<double>(made.rows));
  made.model = std::sqrt(made.model / static_cast<double>(made.rows));
  made.gain = trimmed_sum(std::move(gains));
  made.contradicts = made.gain < -kClear;
  return made;
}

}  // namespace omentum
