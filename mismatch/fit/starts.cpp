#include "mismatch/fit/starts.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr int kStarts = 5;
constexpr int kMirrored = 3;  ///< of them simulated on the other side, too
const Numerics kShell{pb::TISSUE_ELASTIC, {}, 1};
constexpr NoiseModel kSearched{3e-3, 5e-4, 0.025, 4};  ///< where a fit begins
constexpr NoiseModel kCompared{2e-3, 5e-4, 0.025, 4};  ///< common to fits that are compared

/// Least cost of a recording by itself.
double cost_alone(const FitData& data, const std::vector<Linearisation>& all,
                  std::size_t recording) {
  constexpr int kSteps = 4;
  double least = std::numeric_limits<double>::infinity();
  for (const Linearisation& simulated : all)
    least = std::min(least, fit_start(data, simulated, {recording}, kSteps, {}).cost);
  return least;
}

/// Recordings that can be told from their mirror image: held some way from the middle.
Which off_the_middle(const FitData& data, const Which& which) {
  constexpr double kNear = 0.01;  // [m]
  Which list;
  for (const std::size_t r : which) {
    const Observation& seen = data.observations[r];
    if (seen.pinched && std::fabs(seen.pinch.x()) >= kNear) list.push_back(r);
  }
  return list;
}

/// With the jaws of some recordings on the other side of the sheet.
FitData mirrored_data(FitData data, const Which& which) {
  const Eigen::Isometry3d& X_WB = data.made.tissue.X_WB;
  for (const std::size_t r : which) {
    for (Vector3d& p : data.observations[r].track.p_WT) {
      Vector3d p_B = X_WB.inverse() * p;
      p_B.x() = -p_B.x();
      p = X_WB * p_B;
    }
  }
  return data;
}

Which find_mirrored(const FitData& data, ForwardModel& model, const std::vector<Linearisation>& all,
                    const Which& which, const std::function<void()>& simulated) {
  constexpr double kClear = 0.2;  // of a log likelihood, per point
  // A wrong side is no matter of stiffness: a soft, a believed and a stiff body tell it.
  const std::vector<Linearisation> told = {all[1], all[kStarts / 2], all[kStarts - 2]};
  const Which candidates = off_the_middle(data, which);
  const FitData other_side = mirrored_data(data, candidates);
  std::vector<Linearisation> mirrored = told;
  for (Linearisation& m : mirrored) {
    m.predictions = model.simulate(other_side, m.at, kShell, false, candidates);
    simulated();
  }
  Which found;
  for (const std::size_t r : candidates) {
    std::size_t points = 0;
    for (const SeenFrame& frame : data.observations[r].frames)
      points += frame.points.size() + frame.markers.size();
    const double worth = kClear * static_cast<double>(points);
    if (cost_alone(data, mirrored, r) < cost_alone(data, told, r) - worth) found.push_back(r);
  }
  return found;
}

}  // namespace

FittedStart fit_start(const FitData& data, const Linearisation& simulated, const Which& which,
                      int steps, const SearchLimits& limits) {
  const Scales searched{kSearched, data.beliefs.own_sd}, compared{kCompared, data.beliefs.own_sd};
  FitState state = improve(data, simulated, which, steps, limits, {simulated.at, searched}).state;
  const auto n = data.layout.unknowns.count;
  state.shared.head(n) = simulated.at.shared.head(n);
  return {state, cost_of(data, simulated, which, state, compared)};
}

Start find_start(const FitData& all_frames, ForwardModel& model, const Which& which,
                 const std::function<void(double share)>& simulated) {
  const auto one_more = [&] { simulated(1.0 / (kStarts + kMirrored)); };
  constexpr std::size_t kFrames = 8;
  FitData data = all_frames;
  data.observations = few_frames(std::move(data.observations), kFrames);
  const double range = 1.5 * data.unknowns[kStiffnessUnknown].sd;
  std::vector<Linearisation> all;
  for (int k = 0; k < kStarts; ++k) {
    Linearisation& s = all.emplace_back(Linearisation{believed_state(data), {}});
    s.at.shared[kStiffnessUnknown] = range * (2.0 * k / (kStarts - 1) - 1);
    s.predictions = model.simulate(data, s.at, kShell, false, which);
    one_more();
  }
  Start start{believed_state(data), {}, {}};
  const auto is_simulated = [&](const Linearisation& s) {
    return std::ranges::any_of(which,
                               [&](std::size_t r) { return count_valid(s.predictions[r]) > 0; });
  };
  if (!std::ranges::any_of(all, is_simulated)) {
    start.failure = all[kStarts / 2].predictions[which.front()].failure;
    return start;
  }
  start.mirrored = find_mirrored(data, model, all, which, one_more);
  Which kept = which;
  std::erase_if(kept, [&](std::size_t r) { return std::ranges::count(start.mirrored, r) > 0; });
  double least = std::numeric_limits<double>::infinity();
  for (const Linearisation& s : all) {
    constexpr int kSteps = 8;
    const FittedStart fitted = fit_start(data, s, kept, kSteps, {});
    if (!(fitted.cost < least)) continue;
    least = fitted.cost;
    start.state = fitted.state;
  }
  return start;
}

}  // namespace omentum
