#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <map>
#include <numeric>

#include "core/check.h"
#include "core/constants.h"
#include "mismatch/calibrate/calibration.h"
#include "mismatch/calibrate/clock_posterior.h"
#include "mismatch/calibrate/descent.h"
#include "mismatch/calibrate/findings.h"
#include "mismatch/calibrate/law_choice.h"
#include "mismatch/calibrate/marker_findings.h"
#include "mismatch/calibrate/reference_fit.h"
#include "mismatch/calibrate/scores.h"
#include "mismatch/calibrate/starts.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {
namespace {

constexpr double kMeshRatio = 1.5;
// Work of simulating all recordings once, against the fine mesh without derivatives: with them on
// the coarse and the fine mesh, and without on the one that measures the error of the mesh.
constexpr double kCoarseWork = 0.4, kFineWork = 1.6, kMeshWork = 0.4;
// Work of most calibrations: starts, coarse mesh, fine mesh, mesh and step, settling, laws,
// settling again, before and left out.
constexpr std::array<double, 8> kPlan = {3.5,           5 * kCoarseWork,
                                         3 * kFineWork, kMeshWork + 2,
                                         kFineWork,     2 * (3 * kFineWork + kMeshWork),
                                         2 * kFineWork, 2.2};

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
  }

  Calibration run();

 private:
  void next_stage();
  void say(const std::string& stage, double passes);
  void bind_markers();
  void begin();
  void begin_held();
  void place_held(const Which& left, FitState& state);
  void warn_of_missing(std::size_t r, const Prediction& prediction, const std::string& where);
  void drop_failing(const std::vector<Prediction>& predictions, bool told);
  std::vector<Prediction> begin_descent(const SimulateState& simulate, bool told);
  void descend(const Numerics& numerics, int most, double small, double work,
               const std::string& stage);
  void descend_coarsely();
  void take(Descent d);
  LawFit keep() const;
  void restore(const LawFit& fit);
  void fit_laws();
  void compare_laws();
  void judge_laws();
  void integrate();
  void measure_mesh();
  void measure_step();
  void settle_beliefs();
  void settle();
  void collect();
  void add_marker_table(std::size_t r, const Prediction& prediction, const FitState& at,
                        const FitState& state);
  void collect_fit();
  void predict_unseen(const Which& left, const FitState& without, const std::string& role);
  void leave_out();
  std::map<int, Which> conditions() const;
  Numerics fine() const { return {pb::TISSUE_REFERENCE, elements_, 1}; }
  double numerics() const { return std::hypot(mesh_rms_, step_rms_); }
  Numerics coarse() const { return {pb::TISSUE_REFERENCE, coarse_elements_, 1}; }

  ReferenceFit fit_;
  CalibrationOptions options_;
  Which usable_;  ///< recordings that may be fitted
  Which fitted_;  ///< that can be simulated on the mesh
  Calibration result_;
  FitState state_, at_;  ///< `at_`: where predictions_ were simulated
  std::vector<Prediction> predictions_;
  std::vector<Prediction> base_;  ///< as believed
  ArrowStep sure_;
  Range clock_;               ///< of 90 % of the camera's [s]
  bool settled_ = true;       ///< the last descend() came to rest
  std::vector<LawFit> laws_;  ///< the one chosen among them
  std::array<int, 3> elements_ = {}, coarse_elements_ = {};
  std::size_t stage_ = 0;            ///< of kPlan
  double done_ = 0, stage_end_ = 0;  ///< passes
  double mesh_rms_ = 0, step_rms_ = 0, law_rms_ = 0;
};

void Stages::next_stage() {
  done_ = stage_end_;
  stage_end_ += kPlan.at(stage_++) * static_cast<double>(fit_.observations.size());
}

/// What takes longer than planned waits at the end of its stage.
void Stages::say(const std::string& stage, double passes) {
  const double all = std::accumulate(kPlan.begin(), kPlan.end(), 0.0) *
                     static_cast<double>(fit_.observations.size());
  done_ = std::min(done_ + passes, stage_end_);
  if (options_.progress) options_.progress(done_ / all, stage);
}

/// Where the markers sit on the body, by the simulation as believed.
void Stages::bind_markers() {
  if (!fit_.needs_binding()) return;
  fit_.bind_markers(fit_.simulate(fit_.believed(), coarse(), true, fitted_), result_.warnings);
}

/// Of bodies that are let go: a swing that is looked at for long has as many best fits as it has
/// periods, so the search begins with what is seen at first and goes on with ever more of it.
void Stages::begin_held() {
  constexpr double kFirst = 0.05, kLonger = 2;  // [s]
  constexpr double kNear = 1;                   // standard deviations
  constexpr std::size_t kFrames = 60;
  state_ = fit_.believed();
  fit_.noise = NoiseModel{0.003, 5e-4, 0.02, 4};
  bool all = false;
  for (double seconds = kFirst; !all; seconds *= kLonger) {
    const FirstFrames first(fit_.observations, seconds, kFrames);
    descend(coarse(), 6, kNear, kCoarseWork, "starts");
    all = first.all();
  }
  usable_ = fitted_;
}

/// Begins by the shell; recordings that are mirrored are named and left out.
void Stages::begin() {
  bind_markers();
  if (fit_.layout.held > 0) return begin_held();
  const Start start = find_start(fit_, fitted_, [&](double share) {
    say("starts", kPlan.front() * share * static_cast<double>(fitted_.size()));
  });
  if (!start.failure.empty()) {
    result_.warnings.push_back(
        fmt::format("the shell cannot be simulated and the search begins at what is believed: {}",
                    start.failure));
  }
  for (const std::size_t r : start.mirrored) {
    const Observation& seen = fit_.observations[r];
    result_.warnings.push_back(
        fmt::format("recording {}: the cloud shows the sheet held on the other side of its middle: "
                    "the jaws are "
                    "recorded at x_B = {:.1f} mm, seen at {:.1f} mm; it is left out of the fit",
                    seen.name, 1e3 * seen.pinch.x(), -1e3 * seen.pinch.x()));
  }
  if (start.mirrored.size() == fitted_.size())
    throw_error("every recording shows the sheet held on the other side: is x mirrored?");
  std::erase_if(fitted_, [&](std::size_t r) { return std::ranges::count(start.mirrored, r) > 0; });
  usable_ = fitted_;
  state_ = start.state;
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
  d.predictions = begin_descent(simulate, numerics.elements == elements_);
  d.at = state_;
  omentum::descend(fit_, simulate, fitted_, most - 1, small, d);
  take(std::move(d));
}

/// Large cells move the numbers as far as they are told: neither all frames are needed there nor
/// rest.
void Stages::descend_coarsely() {
  constexpr double kNear = 1;
  const std::size_t kFrames = fit_.layout.held > 0 ? kMostFrames : 12;  // a swing needs more
  const FewFrames few(fit_.observations, kFrames);
  descend(coarse(), 6, kNear, kCoarseWork, "coarse mesh");
  settle_beliefs();
  descend(coarse(), 6, kNear, kCoarseWork, "coarse mesh");
  fitted_ = usable_;  // what fails on large cells may not on small ones
}

void Stages::take(Descent d) {
  predictions_ = std::move(d.predictions);
  at_ = std::move(d.at);
  state_ = std::move(d.state);
  sure_ = std::move(d.sure);
  settled_ = d.settled;
}

/// The mesh as a nuisance, by a simulation with larger cells.
void Stages::measure_mesh() {
  const std::array<int, 3> fewer = fewer_elements(elements_, kMeshRatio);
  const double ratio = std::sqrt(static_cast<double>(elements_[0]) * elements_[1] /
                                 (static_cast<double>(fewer[0]) * fewer[1]));
  const double fall = 1 / (std::pow(ratio, 2.5) - 1);  // docs/results.md: error ~ cell^2.5
  const auto mesh = fit_.simulate(at_, {pb::TISSUE_REFERENCE, fewer, 1}, false, fitted_);
  mesh_rms_ = fall * surfaces_apart(mesh, predictions_);
  say("mesh", kMeshWork * static_cast<double>(fitted_.size()));
  fit_.set_difference({"numerics.mesh", "1", "", Unknown::Scale::kShift, 0, 1.5,
                       "1.5 times its estimated error", false},
                      mesh, -fall, predictions_, at_, state_);
}

/// The step as a nuisance, by a simulation with half of it; its error falls with the square.
void Stages::measure_step() {
  constexpr double kFall = 4.0 / 3;
  const auto step = fit_.simulate(at_, {pb::TISSUE_REFERENCE, elements_, 2}, false, fitted_);
  step_rms_ = kFall * surfaces_apart(step, predictions_);
  say("step", 2.0 * static_cast<double>(fitted_.size()));
  fit_.set_difference({"numerics.step", "1", "", Unknown::Scale::kShift, 0, 1.5,
                       "1.5 times its estimated error", false},
                      step, kFall, predictions_, at_, state_);
  fit_.noise.along_motion = std::max(fit_.noise.along_motion, numerics());
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
      auto predictions = fit_.simulate(state, fine(), true, fitted_);
      say("laws of elasticity", kFineWork * static_cast<double>(fitted_.size()));
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
    omentum::descend(fit_, simulate, fitted_, 3, kSmallMove, d);
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

/// What the law is worth at the end: told from the others, or not.
void Stages::judge_laws() {
  const pb::ElasticLaw law = fit_.scene.tissue().material().law();
  LawFit& chosen = *std::ranges::find(laws_, law, &LawFit::law);
  chosen = keep();
  compare_laws();
  chosen.d.state = state_;
  for (const LawFit& fit : laws_) {
    LawRow& row = result_.laws.emplace_back(LawRow{law_name(fit.law), fit.cost - chosen.cost, {}});
    for (std::size_t k = 0; k < fit_.unknowns.size(); ++k) {
      const Unknown& unknown = fit_.unknowns[k];
      const double x = fit.d.state.shared[static_cast<Eigen::Index>(k)];
      if (unknown.in_scene) row.parameters.emplace_back(unknown.path, unknown.value(x));
    }
  }
  std::string names;
  for (const LawFit* other : laws_alike(laws_, chosen, numerics())) {
    const double behind = other->cost - chosen.cost;
    names += fmt::format("{}{} ({:.1f} {})", names.empty() ? "" : ", ", law_name(other->law),
                         std::fabs(behind), behind < 0 ? "ahead" : "behind");
    law_rms_ = std::max(law_rms_, surfaces_apart(other->d.predictions, predictions_));
  }
  if (names.empty()) return;
  result_.warnings.push_back(fmt::format(
      "law of elasticity: that of {} is not told from {}: no better, or no farther from "
      "it than mesh and step may be off. Values are those of the first, intervals reach "
      "over all of them; lift higher to tell them apart",
      law_name(law), names));
}

/// Intervals over the clocks and the laws that may be.
void Stages::integrate() {
  ClockPosterior over = integrate_clock(fit_, predictions_, at_, fitted_, state_, sure_);
  state_ = std::move(over.state);
  sure_ = std::move(over.sure);
  clock_ = over.clock;
  const pb::ElasticLaw law = fit_.scene.tissue().material().law();
  const LawFit& chosen = *std::ranges::find(laws_, law, &LawFit::law);
  widen_over_laws(chosen, laws_alike(laws_, chosen, numerics()), fitted_, sure_);
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
void Stages::settle() {
  constexpr int kRounds = 3;
  for (int round = 0; round < kRounds; ++round) {
    settle_beliefs();
    if (settled_ && moved(fit_, fitted_, at_, state_, sure_) < kSmallMove) break;
    descend(fine(), 3, kSmallMove, kFineWork, "settling");
  }
}

std::map<int, Which> Stages::conditions() const {
  std::map<int, Which> groups;
  for (const std::size_t r : fitted_) groups[fit_.observations[r].condition].push_back(r);
  return groups;
}

void Stages::add_marker_table(std::size_t r, const Prediction& prediction, const FitState& at,
                              const FitState& state) {
  Series table = fit_.marker_table(prediction, r, at, state);
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
    result_.warnings.push_back(
        "no recording is held out and all have one pinch point: how far the simulation is from "
        "what it has not seen is not known");
  }
}

void Stages::collect() {
  result_.scene = fit_.shared_scene(state_);
  const Findings findings{fit_, state_, sure_, fitted_, clock_, mesh_rms_, step_rms_, law_rms_};
  add_numbers(findings, result_);
  add_marker_numbers(findings, result_);
  add_groups(findings, result_);
  add_warnings(findings, result_);
  finish_scene(findings, result_);
}

Calibration Stages::run() {
  const std::clock_t started = std::clock();
  next_stage();
  begin();
  next_stage();
  descend_coarsely();
  next_stage();
  descend(fine(), 4, kSmallMove, kFineWork, "fine mesh");
  next_stage();
  measure_mesh();
  measure_step();
  next_stage();
  settle();  // else the other laws, which are simulated further, look better
  next_stage();
  fit_laws();
  next_stage();
  settle();
  judge_laws();
  integrate();
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

}  // namespace

Calibration calibrate_reference(const pb::Scene& scene, std::vector<Observation> observations,
                                const CalibrationOptions& options) {
  return Stages(scene, std::move(observations), options).run();
}

}  // namespace omentum
