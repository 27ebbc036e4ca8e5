#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "mismatch/calibrate/stages.h"
#include "mismatch/fit/starts.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {
namespace {

constexpr double kNinety = 1.6448536;  // standard deviations of a two-sided interval of 90 %
constexpr int kSweeps = 2;             // of the starts over all numbers
constexpr int kDescents = 10;          // simulations with columns
constexpr double kAsColumns = 12;      // work of one, in simulations of all recordings
constexpr double kDescentWork = kDescents * kAsColumns;
// Starts, descents, step, before and left out.
constexpr std::array<double, 4> kPlan = {30, kDescentWork, 2, 2.2};

/// The best of the states that a search began at.
struct BestStart {
  FitState state;
  double cost = std::numeric_limits<double>::infinity();
};

/// Simulates at some values of a number beside the best state so far, fits registration and clock
/// at each, and keeps the best of all.
void try_places(int number, const std::vector<double>& steps, const FitData& data,
                CalibrationRun& run, BestStart& best) {
  constexpr int kSteps = 8;  // of Gauss and Newton
  std::vector<Linearisation> tried;
  for (const double step : steps) {
    Linearisation& s = tried.emplace_back(Linearisation{best.state, {}});
    double& x = s.at.shared[number];
    x += step * data.beliefs.shared_sd[number];
    if (number < data.layout.unknowns.count) {
      const Range range = range_of(data.unknowns[static_cast<std::size_t>(number)]);
      x = std::clamp(x, range.low, range.high);
    }
  }
  run_parallel(tried.size(), data.setup.simulator->at_once(), [&](std::size_t k) {
    tried[k].predictions = run.model.simulate(data, tried[k].at, run.fine, false, run.fitted);
  });
  for (const Linearisation& s : tried) {
    run.work.add("starts", 1);
    FittedStart fitted = fit_start(data, s, run.fitted, kSteps, run.search.limits);
    if (fitted.cost < best.cost) best = {std::move(fitted.state), fitted.cost};
  }
}

/// Derivatives hold nearby alone, so the search begins where the shell fits best: along one number
/// after the other that is believed vaguely, and the clock.
void begin_along_numbers(CalibrationRun& run) {
  constexpr std::size_t kFrames = 12;
  FitData data = run.data;
  data.observations = few_frames(std::move(data.observations), kFrames);
  BestStart best{believed_state(data)};
  try_places(kStiffnessUnknown, {-1.5, -0.75, 0, 0.75, 1.5}, data, run, best);
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    const double by = sweep == 0 ? 1 : 0.5;
    for (int k = 0; k < data.layout.unknowns.count; ++k) {
      // Those that are believed without being stated matter less than what the user names.
      const bool named = data.unknowns[static_cast<std::size_t>(k)].column.empty();
      if (k == kStiffnessUnknown || named) try_places(k, {-by, by}, data, run, best);
    }
    try_places(data.layout.clock.begin, {-by, by}, data, run, best);
  }
  run.found.state = best.state;
  run.found.scales.noise = NoiseModel{0.003, 5e-4, 0.025, 4};
}

/// Whether a fold sticks or slides hangs on the last bit. How far the numbers are led by
/// simulations that differ by nothing is part of how sure they are.
Eigen::MatrixXd rounding_covariance(CalibrationRun& run) {
  constexpr int kTimes = 4, kSteps = 8;
  std::vector<Linearisation> rounded(kTimes, Linearisation{run.linear.at, {}});
  run_parallel(rounded.size(), run.data.setup.simulator->at_once(), [&](std::size_t k) {
    FitState at = run.linear.at;
    at.shared[kStiffnessUnknown] += kRoundingStep * static_cast<double>(k + 1);
    rounded[k].predictions = run.model.simulate(run.data, at, run.fine, false, run.fitted);
  });
  const int shared = run.data.layout.shared();
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(shared, shared);
  for (Linearisation& linear : rounded) {
    for (const std::size_t r : run.fitted) {
      for (std::size_t f = 0; f < linear.predictions[r].frames.size(); ++f)
        linear.predictions[r].frames[f].columns = run.linear.predictions[r].frames[f].columns;
    }
    const SearchState led =
        improve(run.data, linear, run.fitted, kSteps, run.search.limits, run.found);
    const Eigen::VectorXd by = led.state.shared - run.found.state.shared;
    covariance += by * by.transpose() / kTimes;
  }
  return covariance;
}

/// What a shell leaves of free fabric is more than noise and smooth, and numbers that may lean on a
/// smooth discrepancy foretell worse. So it is looked for with the numbers held, and widens their
/// intervals alone.
void widen(CalibrationRun& run) {
  const Eigen::MatrixXd rounding = rounding_covariance(run);
  const FitState found = run.found.state;
  const NoiseModel noise = run.found.scales.noise;
  run.search.limits.hold_shared = true;
  settle_scales(run);
  run.search.limits.hold_shared = false;
  run.found.state = found;
  run.found.scales.noise = noise;
  // Where the search ends hangs on where it begins, too (decision 0041).
  constexpr double kWider = 2;
  FitPosterior& posterior = run.posterior;
  posterior.shared_covariance = kWider * kWider * (posterior.shared_covariance + rounding);
  for (Eigen::VectorXd& sd : posterior.own_sd) sd *= kWider;
  const int k = run.data.layout.clock.begin;
  const double sd = std::sqrt(posterior.shared_covariance(k, k));
  run.clock = {run.found.state.shared[k] - kNinety * sd, run.found.state.shared[k] + kNinety * sd};
}

}  // namespace

Calibration calibrate_shell(const pb::Scene& scene, std::vector<Observation> observations,
                            const CalibrationOptions& options) {
  const std::clock_t started = std::clock();
  FitData data = make_fit_data(scene, std::move(observations), options);
  set_unknowns(shell_unknowns(data), data);
  ShellForward model;
  CalibrationRun run =
      begin_calibration("shell", options, std::move(data), model, {kPlan.begin(), kPlan.end()});
  run.fine = {pb::TISSUE_ELASTIC, {}, 1};
  run.search.limits.hold_for = 0.5;
  run.search.cost_tolerance = 20;

  run.work.begin_stage();
  bind_markers(run.fine, run);
  begin_along_numbers(run);
  run.work.begin_stage();
  descend({run.fine, kDescents, kSmallMove, kAsColumns, "shell"}, run);
  run.work.begin_stage();
  // Of numbers that are exchanged for each other rounding is all that short steps tell.
  constexpr double kStepOverRounding = 20;
  model.set_step_over_rounding(kStepOverRounding);
  run.linear = model.linearise(run.data, run.found.state, run.fine, run.fitted);
  measure_step(2, run);  // the error falls with it
  widen(run);
  const double step = run.step_rms;
  const std::shared_ptr<const Simulator> simulator = run.data.setup.simulator;
  Calibration result = finish(std::move(run));
  result.numerics = {fmt::format("step {:.3f} mm", 1e3 * step),
                     "mesh and law of elasticity not measured"};
  result.core_seconds = core_seconds_since(started, *simulator);
  return result;
}

}  // namespace omentum
