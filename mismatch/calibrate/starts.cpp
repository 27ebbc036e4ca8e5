#include "mismatch/calibrate/starts.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace omentum {
namespace {

using Eigen::Vector3d;
using Which = std::vector<std::size_t>;

constexpr int kStarts = 5;
constexpr int kMirrored = 3;  ///< of them simulated on the other side, too
const Numerics kShell{pb::TISSUE_ELASTIC, {}, 1};
constexpr NoiseModel kSearched{3e-3, 5e-4, 0.025, 4};  ///< where a fit begins
constexpr NoiseModel kCompared{2e-3, 5e-4, 0.025, 4};  ///< common to fits that are compared

/// Least cost of a recording by itself.
double cost_alone(SurfaceFit& fit, const std::vector<Simulated>& all, std::size_t recording) {
  constexpr int kSteps = 4;
  double least = std::numeric_limits<double>::infinity();
  FitState state;
  for (const Simulated& simulated : all)
    least = std::min(least, fit_start(fit, simulated, {recording}, kSteps, state));
  return least;
}

/// Recordings that can be told from their mirror image: held some way from the middle.
Which off_the_middle(const SurfaceFit& fit, const Which& which) {
  constexpr double kNear = 0.01;  // [m]
  Which list;
  for (const std::size_t r : which) {
    const Observation& seen = fit.observations[r];
    if (seen.pinched && std::fabs(seen.pinch.x()) >= kNear) list.push_back(r);
  }
  return list;
}

void mirror_tracks(SurfaceFit& fit, const Which& which) {
  const Eigen::Isometry3d& X_WB = fit.made.tissue.X_WB;
  for (const std::size_t r : which) {
    for (Vector3d& p : fit.observations[r].track.p_WT) {
      Vector3d p_B = X_WB.inverse() * p;
      p_B.x() = -p_B.x();
      p = X_WB * p_B;
    }
  }
}

Which find_mirrored(SurfaceFit& fit, const std::vector<Simulated>& all, const Which& which,
                    const std::function<void()>& simulated) {
  constexpr double kClear = 0.2;  // of a log likelihood, per point
  // A wrong side is no matter of stiffness: a soft, a believed and a stiff body tell it.
  const std::vector<Simulated> told = {all[1], all[kStarts / 2], all[kStarts - 2]};
  const Which candidates = off_the_middle(fit, which);
  std::vector<Simulated> mirrored = told;
  std::vector<ToolTrack> tracks;
  for (const Observation& seen : fit.observations) tracks.push_back(seen.track);
  mirror_tracks(fit, candidates);
  for (Simulated& m : mirrored) {
    m.predictions = fit.simulate(m.at, kShell, false, candidates);
    simulated();
  }
  for (const std::size_t r : candidates) fit.observations[r].track = tracks[r];
  Which found;
  for (const std::size_t r : candidates) {
    std::size_t points = 0;
    for (const SeenFrame& frame : fit.observations[r].frames)
      points += frame.points.size() + frame.markers.size();
    const double worth = kClear * static_cast<double>(points);
    if (cost_alone(fit, mirrored, r) < cost_alone(fit, told, r) - worth) found.push_back(r);
  }
  return found;
}

}  // namespace

double fit_start(SurfaceFit& fit, const Simulated& simulated, const Which& which, int steps,
                 FitState& state) {
  state = simulated.at;
  fit.noise = kSearched;
  fit.improve(simulated.predictions, simulated.at, which, steps, state);
  const auto n = fit.layout.unknowns;
  state.shared.head(n) = simulated.at.shared.head(n);
  return fit.cost(simulated.predictions, simulated.at, which, state, kCompared);
}

Start find_start(SurfaceFit& fit, const Which& which,
                 const std::function<void(double share)>& simulated) {
  const auto one_more = [&] { simulated(1.0 / (kStarts + kMirrored)); };
  constexpr std::size_t kFrames = 8;
  const FewFrames few(fit.observations, kFrames);
  const double range = 1.5 * fit.unknowns.front().sd;
  std::vector<Simulated> all;
  for (int k = 0; k < kStarts; ++k) {
    Simulated& s = all.emplace_back(Simulated{fit.believed(), {}});
    s.at.shared[0] = range * (2.0 * k / (kStarts - 1) - 1);
    s.predictions = fit.simulate(s.at, kShell, false, which);
    one_more();
  }
  Start start{fit.believed(), {}, {}};
  const auto is_simulated = [&](const Simulated& s) {
    return std::ranges::any_of(which,
                               [&](std::size_t r) { return count_valid(s.predictions[r]) > 0; });
  };
  if (!std::ranges::any_of(all, is_simulated)) {
    start.failure = all[kStarts / 2].predictions[which.front()].failure;
    return start;
  }
  start.mirrored = find_mirrored(fit, all, which, one_more);
  Which kept = which;
  std::erase_if(kept, [&](std::size_t r) { return std::ranges::count(start.mirrored, r) > 0; });
  double least = std::numeric_limits<double>::infinity();
  for (const Simulated& s : all) {
    constexpr int kSteps = 8;
    FitState state;
    const double cost = fit_start(fit, s, kept, kSteps, state);
    if (!(cost < least)) continue;
    least = cost;
    start.state = state;
  }
  fit.noise = NoiseModel{0.003, 5e-4, 0.02, 4};
  return start;
}

}  // namespace omentum
