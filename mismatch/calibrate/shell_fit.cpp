#include "mismatch/calibrate/shell_fit.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "core/check.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {
namespace {

constexpr double kStep = 0.5;     // standard deviations, as far as derivatives are trusted
constexpr double kMostLog = 0.3;  // of a step in a factor
constexpr double kKnown = 2e-3;   // of a number, standard deviation of what is not looked for

/// What is simulated of a recording beside its state: at another value of a number.
struct Beside {
  enum class Role { kState, kNothing, kColumn };
  std::size_t recording = 0;
  Role role = Role::kState;
  Eigen::Index column = 0;
  double step = 0;
  FitState state;
  Prediction prediction;
};

/// Mean square distance of the surfaces [m^2].
double squares_apart(const Prediction& a, const Prediction& b) {
  const double rms = surfaces_apart({a}, {b});
  return rms * rms;
}

/// (other - base) / step, where both were simulated. Whether a fold sticks or slides decides the
/// last bit: of what differs, `squares`, `anyway` would differ for no reason [m^2].
void set_column(const Beside& other, double squares, double anyway, Prediction& base) {
  const double share = squares > anyway ? std::sqrt(1 - anyway / squares) : 0;
  for (std::size_t f = 0; f < base.frames.size(); ++f) {
    PredictedFrame& frame = base.frames[f];
    if (!frame.valid || !other.prediction.frames[f].valid) continue;
    frame.columns.col(other.column) =
        difference(other.prediction.frames[f], frame, share / other.step);
  }
}

}  // namespace

ShellFit::ShellFit(const pb::Scene& given, std::vector<Observation> seen,
                   const CalibrationOptions& chosen)
    : SurfaceFit(given, std::move(seen), chosen) {
  if (scene.has_held_start())
    throw_error("--method shell: scene.held_start, which the reference alone can be let go from");
  add_named_unknowns(scene, options.priors, unknowns);
  if (options.frame_period) {
    const double period = options.frame_period->value;
    unknowns.push_back({kFramePeriodPath, "s", "", Unknown::Scale::kFactor, period,
                        std::log1p(options.frame_period->sd / period), "--frame-period-s", false});
  }
  hold_for = 0.5;
  chance = 20;
  // Each costs a simulation at every state.
  const std::string stiffness = unknowns.front().path;
  std::erase_if(unknowns, [&](const Unknown& unknown) {
    const bool shift = unknown.scale == Unknown::Scale::kShift;
    const double size = shift ? std::fabs(unknown.believed) : 1;
    return unknown.path != stiffness && unknown.sd < kKnown * size;
  });
  set_beliefs();
  first_beliefs = beliefs;
}

double ShellFit::step_of(std::size_t number) const {
  constexpr double kShortest = 0.05;  // of the longest one
  const Unknown& unknown = unknowns[number];
  double longest = kStep * unknown.sd;
  if (unknown.scale != Unknown::Scale::kShift) longest = std::min(kMostLog, longest);
  if (number >= moved_.size() || !(moved_[number] > 0)) return longest;
  return std::clamp(clear * chance_ / moved_[number], kShortest * longest, longest);
}

std::vector<Prediction> ShellFit::predict_all(const FitState& state, const Numerics& numerics,
                                              bool with_columns,
                                              const std::vector<std::size_t>& which) {
  using Role = Beside::Role;
  std::vector<Beside> jobs;
  for (const std::size_t r : which) {
    jobs.push_back({r, Role::kState, 0, 0, state, {}});
    if (!with_columns) continue;
    jobs.push_back({r, Role::kNothing, 0, 0, state, {}});
    jobs.back().state.shared[0] += kTouch;
    for (std::size_t k = 0; k < unknowns.size(); ++k) {
      if (!unknowns[k].simulated) continue;
      const auto column = static_cast<Eigen::Index>(k);
      const double room = range_of(unknowns[k]).high - state.shared[column];
      const double length = step_of(k);
      const double step = length < room ? length : -length;
      jobs.push_back({r, Role::kColumn, column, step, state, {}});
      jobs.back().state.shared[column] += step;
    }
  }
  run_parallel(jobs.size(), options.simulator->at_once(), [&](std::size_t k) {
    jobs[k].prediction = predict_one(jobs[k].state, jobs[k].recording, numerics, false);
  });
  std::vector<Prediction> predictions(observations.size());
  std::vector<double> moved(unknowns.size(), 0);  // sums of squares by a step of 1 [m^2]
  double anyway = 0, all = 0;
  for (Beside& job : jobs) {
    Prediction& base = predictions[job.recording];
    if (job.role == Role::kColumn) {
      const double squares = squares_apart(job.prediction, base);
      moved[static_cast<std::size_t>(job.column)] += squares / (job.step * job.step);
      set_column(job, squares, anyway, base);
    } else if (job.role == Role::kNothing) {
      anyway = squares_apart(job.prediction, base);
      all += anyway;
    } else {
      base = std::move(job.prediction);
      for (PredictedFrame& frame : base.frames) {
        if (!with_columns || !frame.valid) continue;
        frame.columns.setZero(3 * static_cast<Eigen::Index>(frame.vertices.size()) + 3,
                              layout.unknowns + kOwnColumns);
      }
    }
  }
  if (!with_columns) return predictions;  // of which there may be several at a time
  chance_ = std::sqrt(all);
  moved_.clear();
  for (const double squares : moved) moved_.push_back(std::sqrt(squares));
  return predictions;
}

}  // namespace omentum
