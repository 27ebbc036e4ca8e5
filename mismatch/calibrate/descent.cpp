#include "mismatch/calibrate/descent.h"

#include <algorithm>
#include <cmath>

namespace omentum {
namespace {

constexpr int kSteps = 12;  // of Gauss and Newton on one simulation

/// Whether a recording lost frames that were simulated before: it tells nothing of how they fit.
bool lost_frames(const std::vector<Prediction>& now, const std::vector<Prediction>& before,
                 const std::vector<std::size_t>& which) {
  return std::ranges::any_of(
      which, [&](std::size_t r) { return count_valid(now[r]) < count_valid(before[r]); });
}

}  // namespace

double moved(const SurfaceFit& fit, const std::vector<std::size_t>& which, const FitState& at,
             const FitState& state, const ArrowStep& sure) {
  double most = 0;
  for (int k = 0; k < fit.layout.unknowns; ++k) {
    if (!fit.unknowns[static_cast<std::size_t>(k)].simulated) continue;
    const double sd = std::sqrt(std::max(sure.shared_covariance(k, k), 1e-12));
    most = std::max(most, std::fabs(state.shared[k] - at.shared[k]) / sd);
  }
  for (std::size_t i = 0; i < which.size(); ++i) {
    const Eigen::VectorXd by = state.own[which[i]] - at.own[which[i]];
    for (int k = 0; k < 3; ++k) most = std::max(most, std::fabs(by[k]) / sure.own_sd[i][k]);
  }
  return most;
}

void descend(SurfaceFit& fit, const SimulateState& simulate, const std::vector<std::size_t>& which,
             int most, double small, Descent& d) {
  constexpr double kLeastTrust = 0.01;
  const auto improve = [&] {
    d.state = d.at;
    fit.improve(d.predictions, d.at, which, kSteps, d.state);
    d.sure = fit.posterior(d.predictions, d.at, which, d.state);
    d.settled = moved(fit, which, d.at, d.state, d.sure) < small;
  };
  fit.trust = 1;
  improve();
  for (int step = 0; step < most && !d.settled; ++step) {
    auto predictions = simulate(d.state);
    const double now = fit.cost(predictions, d.state, which, d.state, fit.noise);
    const double before = fit.cost(d.predictions, d.at, which, d.at, fit.noise);
    if (lost_frames(predictions, d.predictions, which) || !(now < before + fit.chance)) {
      fit.trust *= 0.3;
    } else {
      const double foretold = fit.cost(d.predictions, d.at, which, d.state, fit.noise);
      if (before - now > 0.5 * (before - foretold)) fit.trust = std::min(1.0, 2 * fit.trust);
      d.predictions = std::move(predictions);
      d.at = d.state;
    }
    improve();
    d.settled = d.settled || fit.trust < kLeastTrust;
  }
  if (!d.settled) {
    // What was simulated last stays; what needs no simulation follows.
    fit.trust = 0;
    improve();
    d.settled = false;
  }
  fit.trust = 1;
}

}  // namespace omentum
