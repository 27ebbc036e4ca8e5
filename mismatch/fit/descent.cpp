#include "mismatch/fit/descent.h"

#include <algorithm>
#include <cmath>

namespace omentum {
namespace {

constexpr int kSteps = 12;  // of Gauss and Newton on one simulation

/// Whether a recording lost frames that were simulated before: it tells nothing of how they fit.
bool lost_frames(const Linearisation& now, const Linearisation& before, const Which& which) {
  return std::ranges::any_of(which, [&](std::size_t r) {
    return count_valid(now.predictions[r]) < count_valid(before.predictions[r]);
  });
}

}  // namespace

double moved(const FitData& data, const Which& which, const FitState& at, const FitState& state,
             const FitPosterior& posterior) {
  double most = 0;
  for (int k = 0; k < data.layout.unknowns.count; ++k) {
    if (!data.unknowns[static_cast<std::size_t>(k)].simulated()) continue;
    const double sd = std::sqrt(std::max(posterior.shared_covariance(k, k), 1e-12));
    most = std::max(most, std::fabs(state.shared[k] - at.shared[k]) / sd);
  }
  for (std::size_t i = 0; i < which.size(); ++i) {
    const Eigen::VectorXd by = state.own[which[i]] - at.own[which[i]];
    for (int k = 0; k < 3; ++k) most = std::max(most, std::fabs(by[k]) / posterior.own_sd[i][k]);
  }
  return most;
}

Descent descend(const FitData& data, const LineariseAt& linearise, const Which& which,
                const DescentOptions& options, Linearisation begin, const Scales& scales) {
  constexpr double kLeastTrust = 0.01;
  SearchLimits limits = options.limits;
  Descent d;
  d.linear = std::move(begin);
  d.found.scales = scales;
  const auto improve_here = [&] {
    d.found = improve(data, d.linear, which, kSteps, limits, {d.linear.at, d.found.scales});
    d.posterior = posterior_at(data, d.linear, which, limits, d.found);
    d.settled = moved(data, which, d.linear.at, d.found.state, d.posterior) < options.small_move;
  };
  improve_here();
  for (int k = 0; k < options.most_simulations && !d.settled; ++k) {
    Linearisation next = linearise(d.found.state);
    const Scales& at = d.found.scales;
    const double now = cost_of(data, next, which, next.at, at);
    const double before = cost_of(data, d.linear, which, d.linear.at, at);
    if (lost_frames(next, d.linear, which) || !(now < before + options.cost_tolerance)) {
      limits.trust *= 0.3;
    } else {
      const double foretold = cost_of(data, d.linear, which, d.found.state, at);
      if (before - now > 0.5 * (before - foretold)) limits.trust = std::min(1.0, 2 * limits.trust);
      d.linear = std::move(next);
    }
    improve_here();
    d.settled = d.settled || limits.trust < kLeastTrust;
  }
  if (!d.settled) {
    // What was simulated last stays; what needs no simulation follows.
    limits.trust = 0;
    improve_here();
    d.settled = false;
  }
  return d;
}

}  // namespace omentum
