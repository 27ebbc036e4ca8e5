#include "mismatch/explain/force_channel.h"

#include <algorithm>
#include <cmath>

#include "mismatch/explain/left_out_gains.h"
#include "mismatch/fit/frame_rows.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

struct ForceRow {
  Vector3d seen, base, model;  ///< [N]
  double sd = 0;
};

/// Of a recording, those without which the force is that of jaws on what lies below.
std::vector<ForceRow> rows_of(const BaseFit& base, const BaseFit& model, std::size_t r) {
  constexpr double kAway = 1e-3;    // [m] from where the tool began
  constexpr double kSensor = 2e-3;  // [N]
  constexpr double kClock = 0.05;   // [s] between camera and sensor
  constexpr double kModels = 0.05;  // of the largest: what two correct models differ by
  const std::vector<std::optional<SeenForce>>& forces = base.forces[r];
  std::vector<ForceRow> rows;
  double largest = 0;
  for (std::size_t f = 0; f < forces.size(); ++f) {
    if (f >= base.surfaces[r].frames.size() || f >= model.surfaces[r].frames.size()) break;
    const PredictedFrame& before = base.surfaces[r].frames[f];
    const PredictedFrame& after = model.surfaces[r].frames[f];
    const PredictedFrame& first = base.surfaces[r].frames.front();
    if (!forces[f] || !before.valid || !after.valid || !first.valid) continue;
    if ((before.tip - first.tip).norm() < kAway) continue;
    rows.push_back({forces[f]->value, before.force, after.force, kClock * forces[f]->change});
    largest = std::max(largest, forces[f]->value.norm());
  }
  for (ForceRow& row : rows) row.sd = std::hypot(row.sd, kSensor, kModels * largest);
  return rows;
}

/// - log density of the rows with forces times `factor`.
double cost_of_rows(const std::vector<ForceRow>& rows, Vector3d ForceRow::*foretold,
                    double factor) {
  constexpr double kFreedom = 4;
  double cost = 0;
  for (const ForceRow& row : rows) {
    for (int axis = 0; axis < 3; ++axis)
      cost += cost_of(std::pow((row.seen - factor * row.*foretold)[axis] / row.sd, 2), kFreedom);
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
      for (const ForceRow& row : rows) {
        for (int axis = 0; axis < 3; ++axis) {
          const double foretells = (row.*foretold)[axis] / row.sd;
          const double e = row.seen[axis] / row.sd - factor * foretells;
          const double weight = weight_of(e * e, kFreedom);
          information += weight * foretells * foretells;
          score += weight * foretells * row.seen[axis] / row.sd;
        }
      }
    }
    factor = score / information;
  }
  return factor;
}

}  // namespace

std::optional<ForceChannel> compare_forces(const BaseFit& base, const BaseFit& model) {
  std::vector<std::vector<ForceRow>> recordings;
  for (const std::size_t r : base.fitted) {
    std::vector<ForceRow> rows = rows_of(base, model, r);
    if (!rows.empty()) recordings.push_back(std::move(rows));
  }
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
