#include "mismatch/fit/search.h"

#include <algorithm>
#include <cmath>

#include "sim_worker/playback/simulation.h"

namespace omentum {

using Eigen::VectorXd;

namespace {

constexpr double kLeastNoise = 2e-4;  // [m] of a point along its ray
constexpr double kLeastForce = 1e-3;  // [N]

std::vector<VectorXd> own_of(const FitState& state, const Which& which) {
  std::vector<VectorXd> list;
  for (const std::size_t r : which) list.push_back(state.own[r]);
  return list;
}

/// Atoms are held where they are.
Beliefs beliefs_at(const FitData& data, const Scales& scales) {
  constexpr double kHeld = 1e-6;  // of the belief
  Beliefs beliefs{data.beliefs.shared_sd, scales.own_sd};
  for (std::size_t k = 0; k < data.unknowns.size(); ++k) {
    if (data.unknowns[k].role == NumberRole::kAtom)
      beliefs.shared_sd[static_cast<Eigen::Index>(k)] *= kHeld;
  }
  return beliefs;
}

/// Into the ranges of the shared numbers, and not too far from where recordings were simulated.
void clamp(const FitData& data, const FitState& at, const Which& which, const Ranges& range,
           double trust, FitState& state) {
  const Layout& layout = data.layout;
  state.shared = state.shared.cwiseMax(range.low).cwiseMin(range.high);
  for (const std::size_t r : which) {
    const auto near = [&](const Layout::Columns& columns, double reach) {
      for (int k = layout.among_own(columns); k < layout.among_own(columns) + columns.count; ++k) {
        state.own[r][k] = std::clamp(state.own[r][k], at.own[r][k] - reach, at.own[r][k] + reach);
      }
    };
    near(layout.pinch, 0.002 * trust);
    near(layout.stiffness_factor, 0.3 * trust);
    near(layout.own_clock, 0.02 * trust);
    near(layout.held_place, 0.01 * trust);
  }
}

/// The step to the mean of the posterior; numbers that want to leave their range stay at its end.
FitPosterior step_inside(const FitData& data, std::span<const NormalEquations> recordings,
                         const Which& which, const Ranges& range, const SearchState& at) {
  const std::vector<VectorXd> own = own_of(at.state, which);
  const Beliefs beliefs = beliefs_at(data, at.scales);
  std::vector<bool> fixed(static_cast<std::size_t>(data.layout.shared()), false);
  FitPosterior found;
  for (bool more = true; more;) {
    found =
        solve_normal_equations(recordings, data.layout, beliefs, at.state.shared, own, 1, fixed);
    more = false;
    for (int k = 0; k < data.layout.shared(); ++k) {
      const double x = at.state.shared[k], by = found.shared_step[k];
      // As good as at the end counts: rounding's room would hold all other numbers back.
      const double edge = 1e-6 * (range.high[k] - range.low[k]);
      if ((by > 0 && x >= range.high[k] - edge) || (by < 0 && x <= range.low[k] + edge)) {
        fixed[static_cast<std::size_t>(k)] = true;
        more = true;
      }
    }
  }
  return found;
}

/// What of a step may be gone at once.
double allowed_share(const FitData& data, const FitPosterior& found, const Ranges& range,
                     const FitState& state) {
  constexpr double kMostShift = 0.01, kMostTurn = 0.1;  // [m], [rad]
  double share = 1;
  for (int k = 0; k < data.layout.shared(); ++k) {
    const double by = found.shared_step[k];
    const double room = (by > 0 ? range.high[k] : range.low[k]) - state.shared[k];
    if (by != 0) share = std::min(share, room / by);
  }
  for (int k = 0; k < 6; ++k) {
    const double by = std::fabs(found.shared_step[data.layout.registration.begin + k]);
    const double most = k < 3 ? kMostShift : kMostTurn;
    if (by * share > most) share = most / by;
  }
  return share;
}

/// The largest step of a shared number, in its standard deviations.
double largest_of(const FitPosterior& found) {
  double largest = 0;
  for (Eigen::Index k = 0; k < found.shared_step.size(); ++k) {
    const double sd = std::sqrt(std::max(found.shared_covariance(k, k), 1e-30));
    largest = std::max(largest, std::fabs(found.shared_step[k]) / sd);
  }
  return largest;
}

/// - log of likelihood and beliefs.
double cost_of(std::span<const NormalEquations> recordings, const FitData& data, const Which& which,
               const FitState& state, const Scales& scales) {
  double sum = 0.5 * state.shared.cwiseQuotient(data.beliefs.shared_sd).squaredNorm();
  for (std::size_t k = 0; k < which.size(); ++k) {
    sum += recordings[k].cost;
    sum += 0.5 * state.own[which[k]].cwiseQuotient(scales.own_sd).squaredNorm();
  }
  return sum;
}

void adapt_noise(const FitData& data, std::span<const NormalEquations> recordings,
                 NoiseModel& noise) {
  noise.sigma = robust_scale(recordings, &NormalEquations::deviation, kLeastNoise);
  noise.force = robust_scale(recordings, &NormalEquations::force_deviation, kLeastForce);
  if (!data.likelihood.markers().empty()) {
    noise.marker =
        robust_scale(recordings, &NormalEquations::marker_deviation, data.least_marker_noise);
    noise.marker_share = independent_share(recordings);
  }
  noise.reach = std::clamp(8 * noise.sigma, 0.008, 0.025);
}

}  // namespace

Scales first_scales(const FitData& data) {
  Scales scales{{}, data.beliefs.own_sd};
  scales.noise.reach = 0.025;
  scales.noise.sigma = 0.003;
  return scales;
}

std::vector<NormalEquations> compare(const FitData& data, const Linearisation& linear,
                                     const Which& which, const FitState& state,
                                     const NoiseModel& noise, bool with_columns) {
  std::vector<NormalEquations> made(which.size());
  run_parallel(which.size(), data.setup.threads, [&](std::size_t k) {
    made[k] =
        data.likelihood.compare(comparison(data, linear, state, which[k]), noise, with_columns);
    made[k].A *= data.setup.row_worth;
    made[k].b *= data.setup.row_worth;
    made[k].cost *= data.setup.row_worth;
  });
  return made;
}

Ranges ranges_of(const FitData& data, const FitState& at, const SearchLimits& limits) {
  const Layout& layout = data.layout;
  Ranges range{VectorXd::Constant(layout.shared(), -1e9), VectorXd::Constant(layout.shared(), 1e9)};
  const auto near = [&](int k, double reach) {
    range.low[k] = std::max(range.low[k], at.shared[k] - reach);
    range.high[k] = std::min(range.high[k], at.shared[k] + reach);
  };
  for (int k = 0; k < layout.unknowns.count; ++k) {
    const Unknown& unknown = data.unknowns[static_cast<std::size_t>(k)];
    const Range whole = range_of(unknown);
    range.low[k] = whole.low;
    range.high[k] = whole.high;
    constexpr double kMostLog = 0.5;  // of a factor
    const double reach = limits.hold_for * unknown.sd;
    const bool factor = unknown.scale != Unknown::Scale::kShift;
    if (unknown.simulated()) near(k, limits.trust * (factor ? std::min(kMostLog, reach) : reach));
  }
  near(layout.clock.begin, std::min(0.05 * limits.trust, 0.5 * kTrajectoryReach));
  const int clock = layout.clock.begin;
  if (limits.held_clock) range.low[clock] = range.high[clock] = *limits.held_clock;
  if (limits.hold_shared) range.low = range.high = at.shared;
  return range;
}

SearchState improve(const FitData& data, const Linearisation& linear, const Which& which,
                    int most_steps, const SearchLimits& limits, SearchState at) {
  const Ranges range = ranges_of(data, linear.at, limits);
  clamp(data, linear.at, which, range, limits.trust, at.state);
  for (int step = 0; step < most_steps; ++step) {
    const auto recordings = compare(data, linear, which, at.state, at.scales.noise, true);
    const FitPosterior found = step_inside(data, recordings, which, range, at);
    double share = allowed_share(data, found, range, at.state);
    const double before = cost_of(recordings, data, which, at.state, at.scales);
    bool better = false;
    constexpr int kHalvings = 5;
    for (int k = 0; k < kHalvings && !better; ++k, share *= 0.5) {
      FitState trial = at.state;
      trial.shared += share * found.shared_step;
      for (std::size_t i = 0; i < which.size(); ++i)
        trial.own[which[i]] += share * found.own_step[i];
      clamp(data, linear.at, which, range, limits.trust, trial);
      better = cost_of(data, linear, which, trial, at.scales) < before;
      if (better) at.state = trial;
    }
    if (!limits.hold_noise) adapt_noise(data, recordings, at.scales.noise);
    constexpr double kSmall = 0.05;  // standard deviations
    if (!better || largest_of(found) < kSmall) break;
  }
  return at;
}

double cost_of(const FitData& data, const Linearisation& linear, const Which& which,
               const FitState& state, const Scales& scales) {
  const auto recordings = compare(data, linear, which, state, scales.noise, false);
  return cost_of(recordings, data, which, state, scales);
}

FitPosterior posterior_at(const FitData& data, const Linearisation& linear, const Which& which,
                          const SearchLimits& limits, const SearchState& at) {
  const auto recordings = compare(data, linear, which, at.state, at.scales.noise, true);
  constexpr double kKnown = 1e-6;  // [s]
  Beliefs beliefs = beliefs_at(data, at.scales);
  if (limits.held_clock) beliefs.shared_sd[data.layout.clock.begin] = kKnown;
  return solve_normal_equations(recordings, data.layout, beliefs, at.state.shared,
                                own_of(at.state, which),
                                row_information(recordings, at.scales.noise));
}

void adapt_own_scales(const FitData& data, const FitPosterior& posterior, const Which& which,
                      const FitState& state, Scales& scales) {
  constexpr double kFreedom = 4;       // of what was believed
  constexpr double kMostMode = 0.003;  // [m]
  constexpr double kFirstMode = 1e-4;  // [m]
  const Layout& layout = data.layout;
  const auto adapt = [&](int first, int count, double believed, double most) {
    double squares = kFreedom * believed * believed;
    double number = kFreedom;
    for (std::size_t k = 0; k < which.size(); ++k) {
      for (int j = first; j < first + count; ++j) {
        const double m = state.own[which[k]][j], v = posterior.own_sd[k][j];
        squares += m * m + v * v;
        ++number;
      }
    }
    const double sd = std::min(std::sqrt(squares / number), most);
    scales.own_sd.segment(first, count).setConstant(sd);
  };
  const auto adapt_to_belief = [&](const Layout::Columns& columns, double most) {
    const int first = layout.among_own(columns);
    adapt(first, columns.count, data.beliefs.own_sd[first], most);
  };
  adapt_to_belief(layout.pinch, 0.01);
  adapt_to_belief(layout.stiffness_factor, 0.5);
  adapt_to_belief(layout.own_clock, 0.1);
  const int cosines = layout.cosines();
  for (int k = 0; k < kTimeFunctions; ++k)
    adapt(layout.among_own(layout.modes) + k * cosines, cosines, kFirstMode, kMostMode);
}

std::vector<std::vector<double>> distances(const FitData& data, const Linearisation& linear,
                                           const FitState& state, std::size_t recording,
                                           double reach) {
  return data.likelihood.distances(comparison(data, linear, state, recording), reach);
}

}  // namespace omentum
