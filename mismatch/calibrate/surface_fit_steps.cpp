#include <algorithm>
#include <cmath>

#include "mismatch/calibrate/surface_fit.h"
#include "sim_worker/playback/simulation.h"

// Steps of Gauss and Newton between simulations (docs/calibrate.md 3).
namespace omentum {

using Eigen::VectorXd;

namespace {

constexpr double kLeastNoise = 2e-4;  // [m] of a point along its ray
constexpr double kLeastForce = 1e-3;  // [N]

std::vector<const Block*> pointers(const std::vector<Block>& blocks) {
  std::vector<const Block*> list;
  for (const Block& block : blocks) list.push_back(&block);
  return list;
}

std::vector<VectorXd> own_of(const FitState& state, const std::vector<std::size_t>& which) {
  std::vector<VectorXd> list;
  for (const std::size_t r : which) list.push_back(state.own[r]);
  return list;
}

}  // namespace

double independent_share(const std::vector<Block>& blocks) {
  constexpr double kLeast = 0.01;
  double squares = 0, products = 0;
  for (const Block& block : blocks) {
    squares += block.marker_squares;
    products += block.marker_products;
  }
  if (!(squares > 0)) return 1;
  const double alike = std::clamp(products / squares, 0.0, 1.0);
  return std::max(kLeast, (1 - alike) / (1 + alike));  // of a first-order process
}

std::vector<Block> SurfaceFit::compare(const std::vector<Prediction>& predictions,
                                       const FitState& at, const std::vector<std::size_t>& which,
                                       const FitState& state, const NoiseModel& with,
                                       bool with_columns) {
  std::vector<Block> blocks(which.size());
  run_parallel(which.size(), options.threads, [&](std::size_t k) {
    const std::size_t r = which[k];
    blocks[k] =
        likelihoods_[r]->compare(observations[r], predictions[r], layout, registration(state),
                                 delta(at, state, r), with, with_columns);
  });
  return blocks;
}
Ranges SurfaceFit::ranges(const FitState& at) const {
  Ranges range{VectorXd::Constant(layout.shared(), -1e9), VectorXd::Constant(layout.shared(), 1e9)};
  const auto near = [&](int k, double reach) {
    range.low[k] = std::max(range.low[k], at.shared[k] - reach);
    range.high[k] = std::min(range.high[k], at.shared[k] + reach);
  };
  for (int k = 0; k < layout.unknowns; ++k) {
    const Unknown& unknown = unknowns[static_cast<std::size_t>(k)];
    const Range whole = range_of(unknown);
    range.low[k] = whole.low;
    range.high[k] = whole.high;
    constexpr double kMostLog = 0.5;  // of a factor
    const double reach = hold_for * unknown.sd;
    const bool factor = unknown.scale != Unknown::Scale::kShift;
    if (unknown.simulated) near(k, trust * (factor ? std::min(kMostLog, reach) : reach));
  }
  near(layout.clock(), std::min(0.05 * trust, 0.5 * kWayBeside));
  if (held_clock) range.low[layout.clock()] = range.high[layout.clock()] = *held_clock;
  if (hold_shared) range.low = range.high = at.shared;
  return range;
}

void SurfaceFit::improve(const std::vector<Prediction>& predictions, const FitState& at,
                         const std::vector<std::size_t>& which, int most_steps, FitState& state) {
  const Ranges range = ranges(at);
  // How far one step may go, and how far from `at` a recording's own numbers.
  constexpr double kMostShift = 0.01, kMostTurn = 0.1;  // [m], [rad]
  const double pinch = 0.002 * trust, stiffness = 0.3 * trust, clock = 0.02 * trust;
  const double place = 0.01 * trust;
  const auto inside = [&](FitState& s) {
    s.shared = s.shared.cwiseMax(range.low).cwiseMin(range.high);
    for (const std::size_t r : which) {
      const auto near = [&](int k, double reach) {
        s.own[r][k] = std::clamp(s.own[r][k], at.own[r][k] - reach, at.own[r][k] + reach);
      };
      near(0, pinch);
      near(1, pinch);
      near(2, stiffness);
      near(3, clock);
      for (int k = 0; k < layout.held; ++k) near(Layout::kOwnPlace + k, place);
    }
  };
  inside(state);
  for (int step = 0; step < most_steps; ++step) {
    const std::vector<Block> blocks = compare(predictions, at, which, state, noise, true);
    const auto list = pointers(blocks);
    const auto own = own_of(state, which);
    // Numbers that want to leave their range stay at its end.
    std::vector<bool> fixed(static_cast<std::size_t>(layout.shared()), false);
    ArrowStep found;
    for (bool more = true; more;) {
      found = solve_arrow(list, layout, beliefs, state.shared, own, 1, fixed);
      more = false;
      for (int k = 0; k < layout.shared(); ++k) {
        const double x = state.shared[k], by = found.shared[k];
        // As good as at the end counts: rounding's room would hold all other numbers back.
        const double edge = 1e-6 * (range.high[k] - range.low[k]);
        if ((by > 0 && x >= range.high[k] - edge) || (by < 0 && x <= range.low[k] + edge)) {
          fixed[static_cast<std::size_t>(k)] = true;
          more = true;
        }
      }
    }
    double share = 1, largest = 0;  // the latter against how sure it is
    for (int k = 0; k < layout.shared(); ++k) {
      const double by = found.shared[k];
      const double sd = std::sqrt(std::max(found.shared_covariance(k, k), 1e-30));
      largest = std::max(largest, std::fabs(by) / sd);
      const double room = (by > 0 ? range.high[k] : range.low[k]) - state.shared[k];
      if (by != 0) share = std::min(share, room / by);
    }
    for (int k = 0; k < 6; ++k) {
      const double by = std::fabs(found.shared[layout.registration() + k]);
      const double most = k < 3 ? kMostShift : kMostTurn;
      if (by * share > most) share = most / by;
    }
    const double before = cost(predictions, at, which, state, noise);
    bool better = false;
    constexpr int kHalvings = 5;
    for (int k = 0; k < kHalvings && !better; ++k, share *= 0.5) {
      FitState trial = state;
      trial.shared += share * found.shared;
      for (std::size_t i = 0; i < which.size(); ++i) trial.own[which[i]] += share * found.own[i];
      inside(trial);
      better = cost(predictions, at, which, trial, noise) < before;
      if (better) state = trial;
    }
    noise.sigma = robust_scale(list, &Block::deviation, kLeastNoise);
    noise.force = robust_scale(list, &Block::force_deviation, kLeastForce);
    if (!markers.empty()) {
      noise.marker = robust_scale(list, &Block::marker_deviation, least_marker_noise_);
      noise.marker_share = independent_share(blocks);
    }
    noise.reach = std::clamp(8 * noise.sigma, 0.008, 0.025);
    constexpr double kSmall = 0.05;
    if (!better || largest < kSmall) break;
  }
}

double SurfaceFit::cost(const std::vector<Prediction>& predictions, const FitState& at,
                        const std::vector<std::size_t>& which, const FitState& state,
                        const NoiseModel& with) {
  const std::vector<Block> blocks = compare(predictions, at, which, state, with, false);
  double sum = 0.5 * state.shared.cwiseQuotient(beliefs.shared_sd).squaredNorm();
  for (std::size_t k = 0; k < which.size(); ++k) {
    sum += blocks[k].cost;
    sum += 0.5 * state.own[which[k]].cwiseQuotient(beliefs.own_sd).squaredNorm();
  }
  return sum;
}

ArrowStep SurfaceFit::posterior(const std::vector<Prediction>& predictions, const FitState& at,
                                const std::vector<std::size_t>& which, const FitState& state) {
  const std::vector<Block> blocks = compare(predictions, at, which, state, noise, true);
  const auto list = pointers(blocks);
  constexpr double kKnown = 1e-6;  // [s]
  Beliefs believed = beliefs;
  if (held_clock) believed.shared_sd[layout.clock()] = kKnown;
  return solve_arrow(list, layout, believed, state.shared, own_of(state, which),
                     row_information(list, noise));
}

void SurfaceFit::adapt_beliefs(const ArrowStep& sure, const std::vector<std::size_t>& which,
                               const FitState& state) {
  constexpr double kFreedom = 4;       // of what was believed
  constexpr double kMostMode = 0.003;  // [m]
  constexpr double kFirstMode = 1e-4;  // [m]
  const auto adapt = [&](int first, int count, double believed, double most) {
    double squares = kFreedom * believed * believed;
    double number = kFreedom;
    for (std::size_t k = 0; k < which.size(); ++k) {
      for (int j = first; j < first + count; ++j) {
        const double m = state.own[which[k]][j], v = sure.own_sd[k][j];
        squares += m * m + v * v;
        ++number;
      }
    }
    const double sd = std::min(std::sqrt(squares / number), most);
    beliefs.own_sd.segment(first, count).setConstant(sd);
  };
  adapt(0, 2, first_beliefs.own_sd[0], 0.01);
  adapt(2, 1, first_beliefs.own_sd[2], 0.5);
  adapt(3, 1, first_beliefs.own_sd[3], 0.1);
  const int modes = layout.modes() - layout.shared();
  for (int course = 0; course < kCourses; ++course)
    adapt(modes + course * kCosines, kCosines, kFirstMode, kMostMode);
}

}  // namespace omentum
