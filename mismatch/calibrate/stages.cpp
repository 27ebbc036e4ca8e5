#include "mismatch/calibrate/stages.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <numeric>
#include <utility>

#include "core/check.h"
#include "mismatch/calibrate/findings.h"
#include "mismatch/calibrate/marker_binding.h"
#include "mismatch/calibrate/marker_findings.h"
#include "mismatch/calibrate/scores.h"

namespace omentum {

Stages::Stages(std::unique_ptr<SurfaceFit> fit, const CalibrationOptions& options,
               const std::string& method, std::vector<double> plan)
    : owned_fit_(std::move(fit)), fit_(*owned_fit_), options_(options), plan_(std::move(plan)) {
  result_.method = method;
  result_.triangles = close_sheet(fit_.made.tissue.surface_triangles,
                                  static_cast<int>(fit_.made.tissue.particles.size()));
  for (std::size_t r = 0; r < fit_.observations.size(); ++r) {
    if (!fit_.observations[r].held_out) fitted_.push_back(r);
  }
  if (fitted_.empty()) throw_error("every recording is held out: nothing can be fitted");
}

void Stages::next_stage() {
  done_ = stage_end_;
  stage_end_ += plan_.at(stage_++) * static_cast<double>(fit_.observations.size());
}

/// What takes longer than planned waits at the end of its stage.
void Stages::say(const std::string& stage, double passes) {
  const double all = std::accumulate(plan_.begin(), plan_.end(), 0.0) *
                     static_cast<double>(fit_.observations.size());
  done_ = std::min(done_ + passes, stage_end_);
  if (options_.progress) options_.progress(done_ / all, stage);
}

/// Where the markers sit on the body, by the simulation as believed.
void Stages::bind_markers(const Numerics& numerics) {
  if (!needs_binding(fit_)) return;
  const auto believed = fit_.simulate(fit_.believed(), numerics, true, fitted_);
  fit_.set_markers(omentum::bind_markers(fit_, believed, result_.warnings));
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

/// Recordings whose simulation ends before their first frame tell nothing on that mesh.
void Stages::drop_failing(const std::vector<Prediction>& predictions, bool told) {
  Which kept;
  for (const std::size_t r : fitted_) {
    if (told) warn_of_missing(r, predictions[r], "");
    if (count_valid(predictions[r]) > 0) kept.push_back(r);
  }
  if (kept.empty())
    throw_error("no recording can be simulated: {}", predictions[fitted_.front()].failure);
  fitted_ = kept;
}

/// The first simulation of a mesh, of a state that another led to: where it fails, it goes half the
/// way to what is believed.
std::vector<Prediction> Stages::begin_descent(const SimulateState& simulate, bool told) {
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
  drop_failing(predictions, told);
  return predictions;
}

/// Simulates and improves, at most so many times, until nothing moves by more than `small` of its
/// standard deviation.
void Stages::descend(const Numerics& numerics, int most, double small, double work,
                     const std::string& stage) {
  const SimulateState simulate = [&](const FitState& state) {
    auto predictions = fit_.simulate(state, numerics, true, fitted_);
    say(stage, work * static_cast<double>(fitted_.size()));
    return predictions;
  };
  Descent d;
  d.predictions = begin_descent(simulate, numerics.elements == fine().elements);
  d.at = state_;
  omentum::descend(fit_, simulate, fitted_, most - 1, small, d);
  take(std::move(d));
}

void Stages::take(Descent d) {
  predictions_ = std::move(d.predictions);
  at_ = std::move(d.at);
  state_ = std::move(d.state);
  sure_ = std::move(d.sure);
  settled_ = d.settled;
}

double Stages::numerics() const { return std::hypot(mesh_rms_, step_rms_); }

/// The step as a nuisance, by a simulation with half of it, whose difference is the error over
/// `fall`.
void Stages::measure_step(double fall) {
  Numerics half = fine();
  half.substeps *= 2;
  const auto step = fit_.simulate(at_, half, false, fitted_);
  step_rms_ = fall * surfaces_apart(step, predictions_);
  say("step", 2.0 * static_cast<double>(fitted_.size()));
  fit_.set_difference({"numerics.step", "1", "", Unknown::Scale::kShift, 0, 1.5,
                       "1.5 times its estimated error", false, false},
                      step, fall, predictions_, at_, state_);
  fit_.noise.along_motion = std::max(fit_.noise.along_motion, numerics());
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

/// The scales move the numbers, and what is simulated follows them.
void Stages::settle(double work) {
  constexpr int kRounds = 3;
  for (int round = 0; round < kRounds; ++round) {
    settle_beliefs();
    if (settled_ && moved(fit_, fitted_, at_, state_, sure_) < kSmallMove) break;
    descend(fine(), 3, kSmallMove, work, "settling");
  }
}

std::map<int, Stages::Which> Stages::conditions() const {
  std::map<int, Which> groups;
  for (const std::size_t r : fitted_) groups[fit_.observations[r].condition].push_back(r);
  return groups;
}

void Stages::add_marker_table(std::size_t r, const Prediction& prediction, const FitState& at,
                              const FitState& state) {
  Series table = marker_table(fit_, prediction, r, at, state);
  if (table.rows() > 0) result_.markers.push_back({fit_.observations[r].name, std::move(table)});
}

void Stages::collect_fit() {
  for (const std::size_t r : fitted_) {
    warn_of_missing(r, base_[r], " as believed");
    FitState no_modes = state_;
    no_modes.own[r].tail(kModes).setZero();
    FitRow row = score(fit_, r, predictions_[r], at_, no_modes, base_[r]);
    row.role = "fitted";
    row.floor = floor_of(fit_.observations[r],
                         fit_.compare(predictions_, at_, {r}, state_, fit_.noise, false).front());
    result_.fit.push_back(row);
    result_.shown.push_back(show(fit_, r, predictions_[r], at_, state_, base_[r]));
    add_marker_table(r, predictions_[r], at_, no_modes);
  }
}

/// Where a hand held the body is no property of it: taken from what is seen before it is let go.
void Stages::place_held(const Which& left, FitState& state) {
  constexpr int kRounds = 2;
  const FirstFrames first(fit_.observations, -1e-3, kMostFrames);
  const NoiseModel noise = fit_.noise;
  fit_.hold_shared = true;
  for (int round = 0; round < kRounds; ++round) {
    FitState at = state, found = state;
    const auto held = fit_.simulate(at, fine(), true, left);
    fit_.improve(held, at, left, 8, found);
    for (const std::size_t r : left) {
      state.own[r].segment(Layout::kOwnPlace, kHeldColumns) =
          found.own[r].segment(Layout::kOwnPlace, kHeldColumns);
    }
  }
  fit_.hold_shared = false;
  fit_.noise = noise;
}

/// Recordings at numbers that were found without them, and with nothing of their own.
void Stages::predict_unseen(const Which& left, const FitState& without, const std::string& role) {
  FitState blind = without;
  for (const std::size_t r : left) blind.own[r].setZero();
  if (fit_.layout.held > 0) place_held(left, blind);
  auto predicted = fit_.simulate(blind, fine(), false, left);
  const auto base =
      role == "held_out" ? fit_.simulate(fit_.believed(), fine(), false, left) : base_;
  for (const std::size_t r : left) {
    warn_of_missing(r, predicted[r], " where it is " + role);
    if (r < predictions_.size()) add_nuisances(fit_, predictions_[r], blind, predicted[r]);
    FitRow row = score(fit_, r, predicted[r], blind, blind, base[r]);
    row.role = role;
    row.floor = floor_of(fit_.observations[r],
                         fit_.compare(predicted, blind, {r}, blind, fit_.noise, false).front());
    result_.fit.push_back(row);
    const bool own = fit_.layout.held > 0 || !fit_.observations[r].overrides.empty();
    if (role == "held_out") add_marker_table(r, predicted[r], blind, blind);
    result_.left_out.push_back(
        {row.recording, own ? fit_.scene_of(blind, r) : fit_.shared_scene(blind)});
  }
  say("left out", 1.2 * static_cast<double>(left.size()));
}

/// Every pinch point by a fit that has not seen it, and the recordings that never were fitted.
void Stages::leave_out() {
  const auto groups = conditions();
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
      predict_unseen(left, without, "left_out");
    }
  }
  Which held;
  for (std::size_t r = 0; r < fit_.observations.size(); ++r) {
    if (fit_.observations[r].held_out) held.push_back(r);
  }
  if (!held.empty()) predict_unseen(held, state_, "held_out");
  if (groups.size() < 2 && held.empty()) {
    result_.warnings.emplace_back(
        "no recording is held out and all have one pinch point: how far the simulation is from "
        "what it has not seen is not known");
  }
}

void Stages::tell_numerics() {
  result_.numerics = {fmt::format("mesh {:.3f} mm", 1e3 * mesh_rms_),
                      fmt::format("step {:.3f} mm", 1e3 * step_rms_),
                      fmt::format("law of elasticity {:.3f} mm", 1e3 * law_rms_)};
}

void Stages::collect() {
  result_.scene = fit_.shared_scene(state_);
  const Findings findings{fit_, state_, sure_, fitted_, clock_, mesh_rms_, step_rms_, law_rms_};
  add_numbers(findings, result_);
  tell_numerics();
  add_marker_numbers(findings, result_);
  add_groups(findings, result_);
  add_warnings(findings, result_);
  finish_scene(findings, result_);
}

Calibration Stages::run() {
  const std::clock_t started = std::clock();
  fit_recordings();
  next_stage();
  base_ = fit_.simulate(fit_.believed(), fine(), false, fitted_);
  say("before", static_cast<double>(fitted_.size()));
  collect_fit();
  leave_out();
  collect();
  result_.core_seconds = static_cast<double>(std::clock() - started) / CLOCKS_PER_SEC +
                         fit_.options.simulator->seconds_elsewhere();
  return std::move(result_);
}

}  // namespace omentum
