#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <map>

#include "core/check.h"
#include "core/constants.h"
#include "mismatch/calibrate/calibration.h"
#include "mismatch/calibrate/descent.h"
#include "mismatch/calibrate/findings.h"
#include "mismatch/calibrate/law_choice.h"
#include "mismatch/calibrate/reference_fit.h"
#include "mismatch/simulation.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kFarPoint = 0.03;  // [m] from the surface: no tissue, in figures of fit
constexpr double kMeshRatio = 1.5;
constexpr double kCoarseWork = 0.8, kFineWork = 2.6;  // of a simulation with its derivatives
constexpr double kKeptWork = 0.6;  // of that with the derivative by thickness of another

using Which = std::vector<std::size_t>;

/// The calibration in its stages, each a function of the one before.
class Stages {
 public:
  Stages(const pb::Scene& scene, std::vector<Observation> observations,
         const CalibrationOptions& options)
      : fit_(scene, std::move(observations), options), options_(options) {
    result_.method = "reference";
    result_.triangles = close_sheet(fit_.made.tissue.surface_triangles,
                                    static_cast<int>(fit_.made.tissue.particles.size()));
    for (std::size_t r = 0; r < fit_.observations.size(); ++r) {
      if (!fit_.observations[r].held_out) fitted_.push_back(r);
    }
    if (fitted_.empty()) throw_error("every recording is held out: nothing can be fitted");
    elements_ = count_elements(scene, options.folder, fit_.observations, options.tolerance_m);
    coarse_elements_ =
        count_elements(scene, options.folder, fit_.observations, 6 * options.tolerance_m);
    // Work in passes of the fine mesh: starts, coarse, fine, laws, base, numerics, left out.
    const auto all = static_cast<double>(fit_.observations.size());
    planned_ = all * (0.4 + 5 * kCoarseWork + 7 * kFineWork + 1 + 3.5 + 1.2);
  }

  Calibration run();

 private:
  void say(const std::string& stage, double passes);
  void scan();
  void look_for_mirrors();
  void warn_of_missing(std::size_t r, const Prediction& prediction, const std::string& where);
  void drop_failing(const std::vector<Prediction>& predictions);
  std::vector<Prediction> begin_descent(const SimulateState& simulate);
  void descend(const Numerics& numerics, int most, double work, const std::string& stage);
  void take(Descent d);
  LawFit keep() const;
  void restore(const LawFit& fit);
  void fit_laws();
  void compare_laws();
  void judge_laws();
  void measure_mesh();
  void measure_step();
  void settle_beliefs();
  void collect();
  void collect_fit();
  void leave_out();
  void show(std::size_t r, const Prediction& base, const FitState& plain);
  std::map<int, Which> conditions() const;
  Numerics fine() const { return {pb::TISSUE_REFERENCE, elements_, 1}; }
  Numerics coarse() const { return {pb::TISSUE_REFERENCE, coarse_elements_, 1}; }

  ReferenceFit fit_;
  CalibrationOptions options_;
  Which fitted_;
  Calibration result_;
  FitState state_, at_;  ///< `at_`: where predictions_ were simulated
  std::vector<Prediction> predictions_;
  std::vector<Prediction> base_;  ///< as believed
  ArrowStep sure_;
  bool settled_ = true;       ///< the last descend() came to rest
  std::vector<LawFit> laws_;  ///< the one chosen among them
  std::array<int, 3> elements_ = {}, coarse_elements_ = {};
  double planned_ = 1, done_ = 0;
  double mesh_rms_ = 0, step_rms_ = 0, law_rms_ = 0;
};

void Stages::say(const std::string& stage, double passes) {
  done_ += passes;
  if (options_.progress) options_.progress(std::min(1.0, done_ / planned_), stage);
}

double rms_of(const std::vector<std::vector<double>>& distances, double* mean = nullptr) {
  double squares = 0, sum = 0, count = 0;
  for (const auto& frame : distances) {
    for (const double d : frame) {
      if (!std::isfinite(d)) continue;
      squares += d * d;
      sum += d;
      ++count;
    }
  }
  if (mean != nullptr) *mean = sum / count;
  return std::sqrt(squares / count);  // NaN: nothing was simulated
}

/// Stiffness and registration by the shell, from many starts.
void Stages::scan() {
  const Numerics shell{pb::TISSUE_ELASTIC, {}, 1};
  const double range = 1.5 * fit_.unknowns.front().sd;
  constexpr int kStarts = 9;
  const NoiseModel common{2e-3, 5e-4, 0.025, 4};
  double least = 0;
  bool any = false;
  for (int k = 0; k < kStarts; ++k) {
    FitState start = fit_.believed();
    start.shared[0] = range * (2.0 * k / (kStarts - 1) - 1);
    const auto predictions = fit_.simulate(start, shell, Columns::kNone, fitted_);
    FitState moved = start;
    fit_.noise = NoiseModel{0.003, 5e-4, 0.025, 4};
    fit_.improve(predictions, start, fitted_, 8, moved);
    moved.shared.head(fit_.layout.unknowns) = start.shared.head(fit_.layout.unknowns);
    const double cost = fit_.cost(predictions, start, fitted_, moved, common);
    say("starts", 0.4 / kStarts * static_cast<double>(fitted_.size()));
    if (any && !(cost < least)) continue;
    any = true;
    least = cost;
    state_ = moved;
  }
  fit_.noise = NoiseModel{0.003, 5e-4, 0.02, 4};
}

/// Whether a recording fits far better with its jaws on the other side of the sheet, or all of them
/// with the picture mirrored.
void Stages::look_for_mirrors() {
  const Numerics shell{pb::TISSUE_ELASTIC, {}, 1};
  const NoiseModel common{2e-3, 5e-4, 0.025, 4};
  const Eigen::Isometry3d X_WB = fit_.made.tissue.X_WB;
  Which wrong;
  for (const std::size_t r : fitted_) {
    if (!fit_.observations[r].pinched || std::fabs(fit_.observations[r].pinch.x()) < 0.01) continue;
    const Which one = {r};
    const auto as_it_is = fit_.simulate(state_, shell, Columns::kNone, one);
    const double cost = fit_.cost(as_it_is, state_, one, state_, common);
    Observation& seen = fit_.observations[r];
    const ToolTrack track = seen.track;
    for (Vector3d& p : seen.track.p_WT) {
      Vector3d p_B = X_WB.inverse() * p;
      p_B.x() = -p_B.x();
      p = X_WB * p_B;
    }
    const auto mirrored = fit_.simulate(state_, shell, Columns::kNone, one);
    const double other = fit_.cost(mirrored, state_, one, state_, common);
    seen.track = track;
    std::size_t points = 0;
    for (const SeenFrame& frame : seen.frames) points += frame.points.size();
    constexpr double kClear = 0.2;  // per point
    if (!(other < cost - kClear * static_cast<double>(points))) continue;
    result_.warnings.push_back(
        fmt::format("recording {}: the cloud shows the sheet held on the other side of its middle: "
                    "the jaws are "
                    "recorded at x_B = {:.1f} mm, seen at {:.1f} mm; it is left out of the fit",
                    seen.name, 1e3 * seen.pinch.x(), -1e3 * seen.pinch.x()));
    wrong.push_back(r);
  }
  if (wrong.size() == fitted_.size())
    throw_error("every recording shows the sheet held on the other side: is x mirrored?");
  std::erase_if(fitted_, [&](std::size_t r) { return std::ranges::count(wrong, r) > 0; });
  if (!wrong.empty()) scan();  // what they had spoilt
}

/// Says once what of a recording could not be simulated.
void Stages::warn_of_missing(std::size_t r, const Prediction& p, const std::string& where) {
  const std::ptrdiff_t valid = count_valid(p);
  if (valid == static_cast<std::ptrdiff_t>(p.frames.size())) return;
  const std::string line =
      fmt::format("recording {}: {} of {} frames are simulated{}{}{}", fit_.observations[r].name,
                  valid, p.frames.size(), where, p.failure.empty() ? "" : ": ", p.failure);
  if (std::ranges::count(result_.warnings, line) == 0) result_.warnings.push_back(line);
}

/// Recordings whose simulation ends before their first frame tell nothing.
void Stages::drop_failing(const std::vector<Prediction>& predictions) {
  Which kept;
  for (const std::size_t r : fitted_) {
    const Prediction& p = predictions[r];
    warn_of_missing(r, p, "");
    if (count_valid(p) > 0) kept.push_back(r);
  }
  if (kept.empty())
    throw_error("no recording can be simulated: {}", predictions[fitted_.front()].failure);
  fitted_ = kept;
}

/// The first simulation of a mesh, of a state that another led to: where it fails, it goes half the
/// way to what is believed.
std::vector<Prediction> Stages::begin_descent(const SimulateState& simulate) {
  const auto failing = [&](const std::vector<Prediction>& predictions) {
    return std::ranges::count_if(fitted_,
                                 [&](std::size_t r) { return count_valid(predictions[r]) == 0; });
  };
  auto predictions = simulate(state_);
  FitState nearer = state_;
  constexpr int kHalvings = 3;
  for (int k = 0; k < kHalvings && failing(predictions) > 0; ++k) {
    nearer.shared.head(fit_.layout.unknowns) *= 0.5;
    auto again = simulate(nearer);
    if (failing(again) >= failing(predictions)) continue;
    predictions = std::move(again);
    state_ = nearer;
  }
  drop_failing(predictions);
  return predictions;
}

/// Simulates and improves until what is simulated moves no more, at most so many times.
void Stages::descend(const Numerics& numerics, int most, double work, const std::string& stage) {
  Columns columns = Columns::kFresh;
  const SimulateState simulate = [&](const FitState& state) {
    auto predictions = fit_.simulate(state, numerics, columns, fitted_);
    say(stage,
        (columns == Columns::kFresh ? 1 : kKeptWork) * work * static_cast<double>(fitted_.size()));
    return predictions;
  };
  Descent d;
  d.predictions = begin_descent(simulate);
  columns = Columns::kKept;
  d.at = state_;
  omentum::descend(fit_, simulate, fitted_, most - 1, d);
  take(std::move(d));
}

void Stages::take(Descent d) {
  predictions_ = std::move(d.predictions);
  at_ = std::move(d.at);
  state_ = std::move(d.state);
  sure_ = std::move(d.sure);
  settled_ = d.settled;
}

/// Rms distance between the surfaces of two predictions.
double apart(const std::vector<Prediction>& a, const std::vector<Prediction>& b,
             const Which& which) {
  double squares = 0, count = 0;
  for (const std::size_t r : which) {
    for (std::size_t f = 0; f < a[r].frames.size() && f < b[r].frames.size(); ++f) {
      if (!a[r].frames[f].valid || !b[r].frames[f].valid) continue;
      for (std::size_t v = 0; v < a[r].frames[f].vertices.size(); ++v) {
        squares += (a[r].frames[f].vertices[v] - b[r].frames[f].vertices[v]).squaredNorm();
        ++count;
      }
    }
  }
  return count > 0 ? std::sqrt(squares / count) : 0;
}

/// The mesh as a nuisance, by a simulation with larger cells.
void Stages::measure_mesh() {
  const std::array<int, 3> fewer = fewer_elements(elements_, kMeshRatio);
  const double ratio = std::sqrt(static_cast<double>(elements_[0]) * elements_[1] /
                                 (static_cast<double>(fewer[0]) * fewer[1]));
  const double fall = 1 / (std::pow(ratio, 2.5) - 1);  // docs/results.md: error ~ cell^2.5
  const auto mesh = fit_.simulate(at_, {pb::TISSUE_REFERENCE, fewer, 1}, Columns::kNone, fitted_);
  mesh_rms_ = fall * apart(mesh, predictions_, fitted_);
  say("mesh", 0.5 * static_cast<double>(fitted_.size()));
  fit_.set_difference({"numerics.mesh", "1", "", Unknown::Scale::kShift, 0, 1.5,
                       "1.5 times its estimated error", false},
                      mesh, -fall, predictions_, at_, state_);
}

/// The step as a nuisance, by a simulation with half of it; its error falls with the square.
void Stages::measure_step() {
  constexpr double kFall = 4.0 / 3;
  const auto step =
      fit_.simulate(at_, {pb::TISSUE_REFERENCE, elements_, 2}, Columns::kNone, fitted_);
  step_rms_ = kFall * apart(step, predictions_, fitted_);
  say("step", 2.0 * static_cast<double>(fitted_.size()));
  fit_.set_difference({"numerics.step", "1", "", Unknown::Scale::kShift, 0, 1.5,
                       "1.5 times its estimated error", false},
                      step, kFall, predictions_, at_, state_);
}

LawFit Stages::keep() const {
  return {fit_.scene.tissue().material().law(),
          {predictions_, at_, state_, sure_, settled_},
          fit_.differences,
          mesh_rms_,
          0};
}

void Stages::restore(const LawFit& fit) {
  fit_.change_law(fit.law);
  fit_.differences = fit.differences;
  mesh_rms_ = fit.mesh_rms;
  take(fit.d);
}

/// The other laws, each fitted from where the believed one led, on the same mesh and with its own
/// error of the mesh; goes on with the one that is chosen.
void Stages::fit_laws() {
  const LawFit first = keep();
  const NoiseModel noise = fit_.noise;
  laws_ = {first};
  for (const pb::ElasticLaw law : kLaws) {
    if (law == first.law) continue;
    restore(first);
    fit_.change_law(law);
    const SimulateState simulate = [&](const FitState& state) {
      auto predictions = fit_.simulate(state, fine(), Columns::kKept, fitted_);
      say("laws of elasticity", kKeptWork * kFineWork * static_cast<double>(fitted_.size()));
      return predictions;
    };
    Descent d;
    d.at = state_;
    d.predictions = simulate(state_);
    const bool fails = std::ranges::any_of(fitted_, [&](std::size_t r) {
      return count_valid(d.predictions[r]) < count_valid(first.d.predictions[r]);
    });
    if (fails) {
      result_.warnings.push_back(
          fmt::format("law of elasticity: that of {} cannot be simulated where the recordings lead "
                      "with that of {}; it is not compared",
                      law_name(law), law_name(first.law)));
      continue;
    }
    omentum::descend(fit_, simulate, fitted_, 3, d);
    take(std::move(d));
    measure_mesh();
    laws_.push_back(keep());
  }
  restore(first);
  fit_.noise = noise;
  compare_laws();
  restore(choose_law(laws_, first.law));
}

/// Costs of all laws at the noise and the beliefs found so far.
void Stages::compare_laws() {
  const NoiseModel noise = fit_.noise;
  for (LawFit& law : laws_) {
    fit_.improve(law.d.predictions, law.d.at, fitted_, 8, law.d.state);
    fit_.noise = noise;
    law.cost = fit_.cost(law.d.predictions, law.d.at, fitted_, law.d.state, noise);
  }
}

/// What the law is worth at the end: chosen against the others, or not told and intervals that hold
/// for all that it may be.
void Stages::judge_laws() {
  const pb::ElasticLaw law = fit_.scene.tissue().material().law();
  LawFit& chosen = *std::ranges::find(laws_, law, &LawFit::law);
  chosen = keep();
  compare_laws();
  chosen.d.state = state_;
  const auto alike = laws_alike(laws_, chosen);
  widen_over_laws(chosen, alike, fitted_, sure_);
  for (const LawFit& other : laws_)
    result_.laws.push_back({law_name(other.law), other.cost - chosen.cost});
  std::string names;
  double squares = 0;
  for (const LawFit* other : alike) {
    names += fmt::format("{}{} ({:.1f} behind)", names.empty() ? "" : ", ", law_name(other->law),
                         other->cost - chosen.cost);
    const double rms = apart(other->d.predictions, predictions_, fitted_);
    squares = std::max(squares, rms * rms);
  }
  law_rms_ = std::sqrt(squares);
  if (alike.empty()) return;
  result_.warnings.push_back(
      fmt::format("law of elasticity: not told, {} stays; as likely by the recordings: {}. The "
                  "intervals hold for all of them; lift higher to tell them apart",
                  law_name(law), names));
}

/// The smooth discrepancy and the scales of what recordings have of their own, with the numbers.
void Stages::settle_beliefs() {
  constexpr double kFirstMode = 3e-4;  // [m]
  if (fit_.beliefs.own_sd[fit_.layout.own() - 1] < 1e-6)
    fit_.beliefs.own_sd.tail(kModes).setConstant(kFirstMode);
  for (int round = 0; round < 6; ++round) {
    fit_.improve(predictions_, at_, fitted_, round == 0 ? 8 : 3, state_);
    sure_ = fit_.posterior(predictions_, at_, fitted_, state_);
    fit_.adapt_beliefs(sure_, fitted_, state_);
  }
  fit_.improve(predictions_, at_, fitted_, 8, state_);
  sure_ = fit_.posterior(predictions_, at_, fitted_, state_);
}

std::map<int, Which> Stages::conditions() const {
  std::map<int, Which> groups;
  for (const std::size_t r : fitted_) groups[fit_.observations[r].condition].push_back(r);
  return groups;
}

/// White part of the distances along the rays, from neighbours in a cloud.
double floor_of(const Block& block) {
  std::vector<double> steps;
  for (std::size_t k = 1; k < block.deviation.size(); ++k)
    steps.push_back(std::fabs(block.deviation[k] - block.deviation[k - 1]));
  if (steps.size() < 10) return 0;
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return 1.4826 * *middle / std::sqrt(2.0);
}

void Stages::show(std::size_t r, const Prediction& base, const FitState& plain) {
  ShownRecording shown;
  const Observation& seen = fit_.observations[r];
  shown.name = seen.name;
  FitState no_modes = state_;
  no_modes.own[r].tail(kModes).setZero();
  const auto before = fit_.distances(base, r, plain, plain, kFarPoint);
  const auto after = fit_.distances(predictions_[r], r, at_, no_modes, kFarPoint);
  for (std::size_t f = 0; f < seen.frames.size(); ++f) {
    if (!base.frames[f].valid || !predictions_[r].frames[f].valid) continue;
    shown.times.push_back(seen.frames[f].t);
    shown.before.push_back(fit_.vertices(base, r, f, plain, plain));
    shown.after.push_back(fit_.vertices(predictions_[r], r, f, at_, no_modes));
    shown.tip.push_back(predictions_[r].frames[f].tip);
    shown.rmse_before.push_back(rms_of({before[f]}));
    shown.rmse_after.push_back(rms_of({after[f]}));
    shown.seen.push_back(seen.frames[f].points);
  }
  result_.shown.push_back(std::move(shown));
}

void Stages::collect_fit() {
  const FitState plain = fit_.believed();
  for (const std::size_t r : fitted_) {
    FitRow row;
    row.recording = fit_.observations[r].name;
    row.role = "fitted";
    warn_of_missing(r, base_[r], " as believed");
    row.rmse_base = rms_of(fit_.distances(base_[r], r, plain, plain, kFarPoint));
    FitState no_modes = state_;
    no_modes.own[r].tail(kModes).setZero();
    row.rmse_model =
        rms_of(fit_.distances(predictions_[r], r, at_, no_modes, kFarPoint), &row.mean_model);
    const Which one = {r};
    row.floor = floor_of(fit_.compare(predictions_, at_, one, state_, fit_.noise, false).front());
    result_.fit.push_back(row);
    show(r, base_[r], plain);
  }
}

/// Every pinch point by a fit that has not seen it, and the recordings that never were fitted.
void Stages::leave_out() {
  const auto groups = conditions();
  const FitState plain = fit_.believed();
  const auto score = [&](const Which& left, const FitState& without, const std::string& role) {
    FitState blind = without;
    for (const std::size_t r : left) blind.own[r].setZero();
    const auto predicted = fit_.simulate(blind, fine(), Columns::kNone, left);
    const auto base =
        role == "held_out" ? fit_.simulate(plain, fine(), Columns::kNone, left) : base_;
    for (const std::size_t r : left) {
      warn_of_missing(r, predicted[r], " where it is " + role);
      FitRow row;
      row.recording = fit_.observations[r].name;
      row.role = role;
      row.rmse_base = rms_of(fit_.distances(base[r], r, plain, plain, kFarPoint));
      // What acts to first order only, from the derivatives beside the fit.
      Prediction whole = predicted[r];
      for (std::size_t f = 0; f < whole.frames.size(); ++f) {
        const bool known = r < predictions_.size() && f < predictions_[r].frames.size() &&
                           predictions_[r].frames[f].columns.size() > 0;
        if (!known || !whole.frames[f].valid) continue;
        const Eigen::MatrixXf& columns = predictions_[r].frames[f].columns;
        VectorXd x = blind.shared.head(fit_.layout.unknowns);
        for (int k = 0; k < fit_.layout.unknowns; ++k) {
          if (fit_.unknowns[static_cast<std::size_t>(k)].in_scene) x[k] = 0;
        }
        const Eigen::VectorXf by = columns.leftCols(fit_.layout.unknowns) * x.cast<float>();
        for (std::size_t v = 0; v < whole.frames[f].vertices.size(); ++v)
          whole.frames[f].vertices[v] +=
              by.segment<3>(3 * static_cast<Eigen::Index>(v)).cast<double>();
      }
      row.rmse_model = rms_of(fit_.distances(whole, r, blind, blind, kFarPoint), &row.mean_model);
      const Which one = {r};
      std::vector<Prediction> all(fit_.observations.size());
      all[r] = whole;
      row.floor = floor_of(fit_.compare(all, blind, one, blind, fit_.noise, false).front());
      result_.fit.push_back(row);
      result_.left_out.push_back({row.recording, fit_.shared_scene(blind)});
    }
    say("left out", 1.2 * static_cast<double>(left.size()));
  };
  if (options_.leave_out && groups.size() > 1) {
    for (const auto& [condition, left] : groups) {
      Which others;
      for (const std::size_t r : fitted_) {
        if (fit_.observations[r].condition != condition) others.push_back(r);
      }
      FitState without = state_;
      const NoiseModel noise = fit_.noise;
      fit_.improve(predictions_, at_, others, 8, without);
      fit_.noise = noise;
      score(left, without, "left_out");
    }
  }
  Which held;
  for (std::size_t r = 0; r < fit_.observations.size(); ++r) {
    if (fit_.observations[r].held_out) held.push_back(r);
  }
  if (!held.empty()) score(held, state_, "held_out");
  if (groups.size() < 2 && held.empty()) {
    result_.warnings.push_back(
        "no recording is held out and all have one pinch point: how far the simulation is from "
        "what it has not seen is not known");
  }
}

void Stages::collect() {
  result_.scene = fit_.shared_scene(state_);
  const Findings findings{fit_, state_, sure_, fitted_, mesh_rms_, step_rms_, law_rms_};
  add_numbers(findings, result_);
  add_groups(findings, result_);
  add_warnings(findings, result_);
  finish_scene(findings, result_);
}

Calibration Stages::run() {
  const std::clock_t begin = std::clock();
  scan();
  look_for_mirrors();
  descend(coarse(), 6, kCoarseWork, "coarse mesh");
  settle_beliefs();
  descend(coarse(), 6, kCoarseWork, "coarse mesh");
  descend(fine(), 4, kFineWork, "fine mesh");
  measure_mesh();
  measure_step();
  settle_beliefs();
  fit_laws();
  // The scales move the numbers, and what is simulated follows them.
  constexpr int kRounds = 3;
  for (int round = 0; round < kRounds; ++round) {
    settle_beliefs();
    if (settled_ && moved(fit_, fitted_, at_, state_, sure_) < kSmallMove) break;
    descend(fine(), 3, kFineWork, "settling");
  }
  judge_laws();
  base_ = fit_.simulate(fit_.believed(), fine(), Columns::kNone, fitted_);
  say("before", static_cast<double>(fitted_.size()));
  collect_fit();
  leave_out();
  collect();
  result_.core_seconds = static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
  return std::move(result_);
}

}  // namespace

Calibration calibrate_reference(const pb::Scene& scene, std::vector<Observation> observations,
                                const CalibrationOptions& options) {
  return Stages(scene, std::move(observations), options).run();
}

}  // namespace omentum
