#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "core/check.h"
#include "mismatch/fit/forward_model.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {
namespace {

constexpr double kStep = 0.5;     // standard deviations, as far as derivatives are trusted
constexpr double kMostLog = 0.3;  // of a step in a factor
constexpr double kKnown = 2e-3;   // of a number, standard deviation of what is not looked for

/// A simulation of a recording at its state, a rounding away, or at another value of a number.
struct Job {
  enum class Kind { kState, kRounding, kColumn };
  std::size_t recording = 0;
  Kind kind = Kind::kState;
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
/// last bit: of the mean square that differs, `squares`, `rounding` is no effect of the step [m^2].
void set_column(const Job& other, double squares, double rounding, Prediction& base) {
  const double share = squares > rounding ? std::sqrt(1 - rounding / squares) : 0;
  for (std::size_t f = 0; f < base.frames.size(); ++f) {
    PredictedFrame& frame = base.frames[f];
    if (!frame.valid || !other.prediction.frames[f].valid) continue;
    frame.columns.col(other.column) =
        difference(other.prediction.frames[f], frame, share / other.step);
  }
}

}  // namespace

std::vector<Unknown> shell_unknowns(const FitData& data) {
  if (data.scene.has_held_start())
    throw_error("--method shell: scene.held_start, which the reference alone can be let go from");
  std::vector<Unknown> unknowns = data.unknowns;
  add_named_unknowns(data.scene, data.setup.priors, unknowns);
  if (data.setup.frame_period) {
    const double period = data.setup.frame_period->value;
    unknowns.push_back({kFramePeriodPath, "s", "", Unknown::Scale::kFactor, period,
                        std::log1p(data.setup.frame_period->sd / period), "--frame-period-s",
                        NumberRole::kNuisance});
  }
  const std::string stiffness = unknowns.front().path;
  std::erase_if(unknowns, [&](const Unknown& unknown) {
    const bool shift = unknown.scale == Unknown::Scale::kShift;
    const double size = shift ? std::fabs(unknown.believed) : 1;
    return unknown.path != stiffness && unknown.sd < kKnown * size;
  });
  return unknowns;
}

double ShellForward::step_of(const FitData& data, std::size_t number) const {
  constexpr double kShortest = 0.05;  // of the longest one
  const Unknown& unknown = data.unknowns[number];
  double longest = kStep * unknown.sd;
  if (unknown.scale != Unknown::Scale::kShift) longest = std::min(kMostLog, longest);
  if (number >= moved_.size() || !(moved_[number] > 0)) return longest;
  return std::clamp(step_over_rounding_ * rounding_ / moved_[number], kShortest * longest, longest);
}

std::vector<Prediction> ShellForward::predict_all(const FitData& data, const FitState& state,
                                                  const Numerics& numerics, bool with_columns,
                                                  const Which& which) {
  const std::vector<Unknown>& unknowns = data.unknowns;
  using Kind = Job::Kind;
  std::vector<Job> jobs;
  for (const std::size_t r : which) {
    jobs.push_back({r, Kind::kState, 0, 0, state, {}});
    if (!with_columns) continue;
    jobs.push_back({r, Kind::kRounding, 0, 0, state, {}});
    jobs.back().state.shared[kStiffnessUnknown] += kRoundingStep;
    for (std::size_t k = 0; k < unknowns.size(); ++k) {
      if (!unknowns[k].simulated()) continue;
      const auto column = static_cast<Eigen::Index>(k);
      const double room = range_of(unknowns[k]).high - state.shared[column];
      const double length = step_of(data, k);
      const double step = length < room ? length : -length;
      jobs.push_back({r, Kind::kColumn, column, step, state, {}});
      jobs.back().state.shared[column] += step;
    }
  }
  run_parallel(jobs.size(), data.setup.simulator->at_once(), [&](std::size_t k) {
    jobs[k].prediction = predict_at(data, jobs[k].state, jobs[k].recording, numerics, false);
  });
  std::vector<Prediction> predictions(data.observations.size());
  std::vector<double> moved(unknowns.size(), 0);  // sums of squares by a step of 1 [m^2]
  double rounding = 0, all = 0;
  for (Job& job : jobs) {
    Prediction& base = predictions[job.recording];
    if (job.kind == Kind::kColumn) {
      const double squares = squares_apart(job.prediction, base);
      moved[static_cast<std::size_t>(job.column)] += squares / (job.step * job.step);
      set_column(job, squares, rounding, base);
    } else if (job.kind == Kind::kRounding) {
      rounding = squares_apart(job.prediction, base);
      all += rounding;
    } else {
      base = std::move(job.prediction);
      for (PredictedFrame& frame : base.frames) {
        if (!with_columns || !frame.valid) continue;
        frame.columns.setZero(3 * static_cast<Eigen::Index>(frame.vertices.size()) + 3,
                              data.layout.unknowns.count + kOwnColumns);
      }
    }
  }
  if (!with_columns) return predictions;  // of which there may be several at a time
  rounding_ = std::sqrt(all);
  moved_.clear();
  for (const double squares : moved) moved_.push_back(std::sqrt(squares));
  return predictions;
}

}  // namespace omentum
