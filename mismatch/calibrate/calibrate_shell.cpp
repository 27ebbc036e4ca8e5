#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "mismatch/calibrate/shell_fit.h"
#include "mismatch/calibrate/stages.h"
#include "mismatch/calibrate/starts.h"
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

/// By the shell of the scene: bodies that lie free, on which the reference has no clamp.
class ShellStages : public Stages {
 public:
  ShellStages(const pb::Scene& scene, std::vector<Observation> observations,
              const CalibrationOptions& options)
      : Stages(std::make_unique<ShellFit>(scene, std::move(observations), options), options,
               "shell", {kPlan.begin(), kPlan.end()}) {}

 private:
  void fit_recordings() override;
  Numerics fine() const override { return {pb::TISSUE_ELASTIC, {}, 1}; }
  ShellFit& shell() { return static_cast<ShellFit&>(fit_); }

  void tell_numerics() override {
    result_.numerics = {fmt::format("step {:.3f} mm", 1e3 * step_rms_),
                        "mesh and law of elasticity not measured"};
  }
  void begin();
  Eigen::MatrixXd chance_covariance();
  void widen();
  void try_places(int number, const std::vector<double>& steps, double& least, FitState& best);
};

/// Simulates at some values of a number beside the best state so far, fits registration and clock
/// at each, and keeps the best of all.
void ShellStages::try_places(int number, const std::vector<double>& steps, double& least,
                             FitState& best) {
  constexpr int kSteps = 8;  // of Gauss and Newton
  std::vector<Simulated> tried;
  for (const double step : steps) {
    Simulated& s = tried.emplace_back(Simulated{best, {}});
    double& x = s.at.shared[number];
    x += step * fit_.beliefs.shared_sd[number];
    if (number < fit_.layout.unknowns) {
      const Range range = range_of(fit_.unknowns[static_cast<std::size_t>(number)]);
      x = std::clamp(x, range.low, range.high);
    }
  }
  run_parallel(tried.size(), fit_.options.simulator->at_once(), [&](std::size_t k) {
    tried[k].predictions = fit_.simulate(tried[k].at, fine(), false, fitted_);
  });
  for (const Simulated& s : tried) {
    say("starts", 1);
    FitState state;
    const double cost = fit_start(fit_, s, fitted_, kSteps, state);
    if (!(cost < least)) continue;
    least = cost;
    best = state;
  }
}

/// Derivatives hold nearby alone, so the search begins where the shell fits best: along one number
/// after the other that is believed vaguely, and the clock.
void ShellStages::begin() {
  bind_markers(fine());
  constexpr std::size_t kFrames = 12;
  const FewFrames few(fit_.observations, kFrames);
  state_ = fit_.believed();
  double least = std::numeric_limits<double>::infinity();
  try_places(0, {-1.5, -0.75, 0, 0.75, 1.5}, least, state_);
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    const double by = sweep == 0 ? 1 : 0.5;
    for (int k = 0; k < fit_.layout.unknowns; ++k) {
      // Those that are believed without being stated matter less than what the user names.
      const Unknown& unknown = fit_.unknowns[static_cast<std::size_t>(k)];
      const bool named = unknown.column.empty();
      if (k == 0 || named) try_places(k, {-by, by}, least, state_);
    }
    try_places(fit_.layout.clock(), {-by, by}, least, state_);
  }
  fit_.noise = NoiseModel{0.003, 5e-4, 0.025, 4};
}

/// Whether a fold sticks or slides hangs on the last bit. How far the numbers are led by
/// simulations that differ by nothing is part of how sure they are.
Eigen::MatrixXd ShellStages::chance_covariance() {
  constexpr int kTimes = 4, kSteps = 8;
  std::vector<std::vector<Prediction>> touched(kTimes);
  run_parallel(touched.size(), fit_.options.simulator->at_once(), [&](std::size_t k) {
    FitState at = at_;
    at.shared[0] += kTouch * static_cast<double>(k + 1);
    touched[k] = fit_.simulate(at, fine(), false, fitted_);
  });
  const NoiseModel noise = fit_.noise;
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(fit_.layout.shared(), fit_.layout.shared());
  for (std::vector<Prediction>& predictions : touched) {
    for (const std::size_t r : fitted_) {
      for (std::size_t f = 0; f < predictions[r].frames.size(); ++f)
        predictions[r].frames[f].columns = predictions_[r].frames[f].columns;
    }
    FitState led = state_;
    fit_.improve(predictions, at_, fitted_, kSteps, led);
    fit_.noise = noise;
    const Eigen::VectorXd by = led.shared - state_.shared;
    covariance += by * by.transpose() / kTimes;
  }
  return covariance;
}

/// What a shell leaves of free fabric is more than noise and smooth, and numbers that may lean on a
/// smooth discrepancy foretell worse. So it is looked for with the numbers held, and widens their
/// intervals alone.
void ShellStages::widen() {
  const Eigen::MatrixXd chance = chance_covariance();
  const FitState found = state_;
  const NoiseModel noise = fit_.noise;
  fit_.hold_shared = true;
  settle_beliefs();
  fit_.hold_shared = false;
  fit_.noise = noise;
  state_ = found;
  // Where the search ends hangs on where it begins, too (docs/results.md, Calibration).
  constexpr double kWider = 2;
  sure_.shared_covariance = kWider * kWider * (sure_.shared_covariance + chance);
  for (Eigen::VectorXd& sd : sure_.own_sd) sd *= kWider;
  const int k = fit_.layout.clock();
  const double sd = std::sqrt(sure_.shared_covariance(k, k));
  clock_ = {state_.shared[k] - kNinety * sd, state_.shared[k] + kNinety * sd};
}

void ShellStages::fit_recordings() {
  next_stage();
  begin();
  next_stage();
  descend(fine(), kDescents, kSmallMove, kAsColumns, "shell");
  next_stage();
  // Of numbers that are exchanged for each other chance is all that short steps tell.
  constexpr double kClear = 20;
  shell().clear = kClear;
  at_ = state_;
  predictions_ = fit_.simulate(at_, fine(), true, fitted_);
  measure_step(2);  // the error falls with it
  widen();
}

}  // namespace

Calibration calibrate_shell(const pb::Scene& scene, std::vector<Observation> observations,
                            const CalibrationOptions& options) {
  return ShellStages(scene, std::move(observations), options).run();
}

}  // namespace omentum
