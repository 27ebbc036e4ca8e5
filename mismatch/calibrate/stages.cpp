#include "mismatch/calibrate/stages.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <map>
#include <numeric>
#include <optional>
#include <utility>

#include "core/check.h"
#include "mismatch/calibrate/findings.h"
#include "mismatch/calibrate/marker_findings.h"
#include "mismatch/calibrate/scores.h"
#include "mismatch/fit/marker_binding.h"

namespace omentum {
namespace {

double count_of(const Which& which) { return static_cast<double>(which.size()); }

/// The data of a run, or with other frames in it.
const FitData& look_at(const CalibrationRun& run, const std::vector<Observation>* frames,
                       std::optional<FitData>& made) {
  if (frames == nullptr) return run.data;
  made = run.data;
  made->observations = *frames;
  return *made;
}

/// Says once what of a recording could not be simulated.
void warn_of_missing(std::size_t r, const Prediction& p, const std::string& where,
                     CalibrationRun& run) {
  const std::ptrdiff_t valid = count_valid(p);
  if (valid == static_cast<std::ptrdiff_t>(p.frames.size())) return;
  const std::string line = fmt::format("recording {}: {} of {} frames are simulated{}{}{}",
                                       run.data.observations[r].name, valid, p.frames.size(), where,
                                       p.failure.empty() ? "" : ": ", p.failure);
  std::vector<std::string>& warnings = run.result.warnings;
  if (std::ranges::count(warnings, line) == 0) warnings.push_back(line);
}

std::ptrdiff_t count_failing(const Linearisation& linear, const Which& which) {
  return std::ranges::count_if(
      which, [&](std::size_t r) { return count_valid(linear.predictions[r]) == 0; });
}

/// Recordings whose simulation ends before their first frame tell nothing on that mesh.
void drop_failing(const Linearisation& linear, bool warned_of, CalibrationRun& run) {
  Which kept;
  for (const std::size_t r : run.fitted) {
    if (warned_of) warn_of_missing(r, linear.predictions[r], "", run);
    if (count_valid(linear.predictions[r]) > 0) kept.push_back(r);
  }
  if (kept.empty())
    throw_error("no recording can be simulated: {}",
                linear.predictions[run.fitted.front()].failure);
  run.fitted = kept;
}

/// The first simulation of a mesh, of a state that another led to: where it fails, it goes half the
/// way to what is believed.
Linearisation begin_descent(const LineariseAt& linearise, bool warned_of, CalibrationRun& run) {
  Linearisation linear = linearise(run.found.state);
  FitState nearer = run.found.state;
  constexpr int kHalvings = 3;
  for (int k = 0; k < kHalvings && count_failing(linear, run.fitted) > 0; ++k) {
    nearer.shared.head(run.data.layout.unknowns.count) *= 0.5;
    Linearisation again = linearise(nearer);
    if (count_failing(again, run.fitted) >= count_failing(linear, run.fitted)) continue;
    linear = std::move(again);
    run.found.state = nearer;
  }
  drop_failing(linear, warned_of, run);
  return linear;
}

std::map<int, Which> conditions_of(const CalibrationRun& run) {
  std::map<int, Which> groups;
  for (const std::size_t r : run.fitted) groups[run.data.observations[r].condition].push_back(r);
  return groups;
}

void add_marker_table(std::size_t r, const Linearisation& linear, const FitState& state,
                      CalibrationRun& run) {
  Series table = marker_table(run.data, linear, state, r);
  if (table.rows() > 0)
    run.result.markers.push_back({run.data.observations[r].name, std::move(table)});
}

double floor_at(std::size_t r, const Linearisation& linear, const FitState& state,
                const CalibrationRun& run) {
  const auto compared = compare(run.data, linear, {r}, state, run.found.scales.noise, false);
  return floor_of(run.data.observations[r], compared.front());
}

void collect_fit(CalibrationRun& run) {
  const FitState& state = run.found.state;
  for (const std::size_t r : run.fitted) {
    warn_of_missing(r, run.believed.predictions[r], " as believed", run);
    const FitState no_modes = without_difference(run.data, state, r);
    FitRow row = score(run.data, run.linear, no_modes, r, run.believed);
    row.role = "fitted";
    row.floor = floor_at(r, run.linear, state, run);
    run.result.fit.push_back(row);
    run.result.shown.push_back(show(run.data, run.linear, state, r, run.believed));
    add_marker_table(r, run.linear, no_modes, run);
  }
}

/// Where a hand held the body is no property of it: taken from what is seen before it is let go.
void place_held(const Which& left, CalibrationRun& run, FitState& state) {
  constexpr int kRounds = 2;
  FitData before = run.data;
  before.observations = first_frames(before.observations, -1e-3, kMostFrames).observations;
  before.differences.clear();  // of all frames
  SearchLimits limits = run.search.limits;
  limits.hold_shared = true;
  SearchState found{state, run.found.scales};
  for (int round = 0; round < kRounds; ++round) {
    const Linearisation held = run.model.linearise(before, state, run.fine, left);
    found = improve(before, held, left, 8, limits, {state, found.scales});
    const int place = before.layout.among_own(before.layout.held_place);
    for (const std::size_t r : left) {
      state.own[r].segment(place, kHeldColumns) = found.state.own[r].segment(place, kHeldColumns);
    }
  }
}

/// Recordings at numbers that were found without them, and with nothing of their own.
void predict_unseen(const Which& left, const FitState& without, const std::string& role,
                    CalibrationRun& run) {
  FitState blind = without;
  for (const std::size_t r : left) blind.own[r].setZero();
  const bool held = run.data.layout.held_place.count > 0;
  if (held) place_held(left, run, blind);
  Linearisation predicted{blind, run.model.simulate(run.data, blind, run.fine, false, left)};
  Linearisation unfitted{run.believed.at, {}};
  if (role == "held_out")
    unfitted.predictions = run.model.simulate(run.data, unfitted.at, run.fine, false, left);
  const Linearisation& believed = role == "held_out" ? unfitted : run.believed;
  for (const std::size_t r : left) {
    warn_of_missing(r, predicted.predictions[r], " where it is " + role, run);
    add_nuisances(run.data, run.linear.predictions[r], blind, predicted.predictions[r]);
    FitRow row = score(run.data, predicted, blind, r, believed);
    row.role = role;
    row.floor = floor_at(r, predicted, blind, run);
    run.result.fit.push_back(row);
    const bool own = held || !run.data.observations[r].overrides.empty();
    if (role == "held_out") add_marker_table(r, predicted, blind, run);
    run.result.left_out.push_back(
        {row.recording, own ? scene_of(run.data, blind, r) : shared_scene(run.data, blind)});
  }
  run.work.add("left out", 1.2 * count_of(left));
}

/// Every pinch point by a fit that has not seen it, and the recordings that never were fitted.
void leave_out(CalibrationRun& run) {
  const auto groups = conditions_of(run);
  if (run.options.leave_out && groups.size() > 1) {
    for (const auto& [condition, left] : groups) {
      Which others;
      for (const std::size_t r : run.fitted) {
        if (run.data.observations[r].condition != condition) others.push_back(r);
      }
      const SearchState without =
          improve(run.data, run.linear, others, 8, run.search.limits, run.found);
      predict_unseen(left, without.state, "left_out", run);
    }
  }
  Which held;
  for (std::size_t r = 0; r < run.data.observations.size(); ++r) {
    if (run.data.observations[r].held_out) held.push_back(r);
  }
  if (!held.empty()) predict_unseen(held, run.found.state, "held_out", run);
  if (groups.size() < 2 && held.empty()) {
    run.result.warnings.emplace_back(
        "no recording is held out and all have one pinch point: how far the simulation is from "
        "what it has not seen is not known");
  }
}

void collect(CalibrationRun& run) {
  run.result.scene = shared_scene(run.data, run.found.state);
  const Findings findings{run.data,  run.found,    run.posterior, run.fitted,
                          run.clock, run.mesh_rms, run.step_rms,  run.law_rms};
  add_numbers(findings, run.result);
  add_marker_numbers(findings, run.result);
  add_groups(findings, run.result);
  add_warnings(findings, run.result);
  finish_scene(findings, run.result);
}

}  // namespace

void WorkPlan::begin_stage() {
  done_ = stage_end_;
  stage_end_ += stages_.at(next_++) * static_cast<double>(recordings_);
}

void WorkPlan::add(const std::string& stage, double simulations) {
  const double all =
      std::accumulate(stages_.begin(), stages_.end(), 0.0) * static_cast<double>(recordings_);
  done_ = std::min(done_ + simulations, stage_end_);
  if (progress_) progress_(done_ / all, stage);
}

double core_seconds_since(std::clock_t started, const Simulator& simulator) {
  return static_cast<double>(std::clock() - started) / CLOCKS_PER_SEC +
         simulator.seconds_elsewhere();
}

double CalibrationRun::numerics_rms() const { return std::hypot(mesh_rms, step_rms); }

CalibrationRun begin_calibration(const std::string& method, const CalibrationOptions& options,
                                 FitData data, ForwardModel& model, std::vector<double> stages) {
  const std::size_t count = data.observations.size();
  CalibrationRun run(options, std::move(data), model,
                     WorkPlan(options.progress, std::move(stages), count));
  run.found = {believed_state(run.data), first_scales(run.data)};
  for (std::size_t r = 0; r < count; ++r) {
    if (!run.data.observations[r].held_out) run.fitted.push_back(r);
  }
  if (run.fitted.empty()) throw_error("every recording is held out: nothing can be fitted");
  run.result.method = method;
  run.result.triangles = run.data.likelihood.triangles();
  return run;
}

void bind_markers(const Numerics& numerics, CalibrationRun& run) {
  if (!needs_binding(run.data)) return;
  const auto believed =
      run.model.simulate(run.data, believed_state(run.data), numerics, true, run.fitted);
  set_markers(bind_markers(run.data, believed, run.result.warnings), run.data);
  run.found = {believed_state(run.data), first_scales(run.data)};
}

void descend(const DescentStage& stage, CalibrationRun& run,
             const std::vector<Observation>* frames) {
  std::optional<FitData> made;
  const FitData& data = look_at(run, frames, made);
  const LineariseAt linearise = [&](const FitState& state) {
    Linearisation linear = run.model.linearise(data, state, stage.numerics, run.fitted);
    run.work.add(stage.name, stage.work * count_of(run.fitted));
    return linear;
  };
  Linearisation begin = begin_descent(linearise, stage.numerics.elements == run.fine.elements, run);
  DescentOptions options = run.search;
  options.most_simulations = stage.most_simulations - 1;
  options.small_move = stage.small_move;
  take(descend(data, linearise, run.fitted, options, std::move(begin), run.found.scales), run);
}

void take(Descent d, CalibrationRun& run) {
  run.linear = std::move(d.linear);
  run.found = std::move(d.found);
  run.posterior = std::move(d.posterior);
  run.settled = d.settled;
}

void measure_step(double fall, CalibrationRun& run) {
  Numerics half = run.fine;
  half.substeps *= 2;
  const auto step = run.model.simulate(run.data, run.linear.at, half, false, run.fitted);
  run.step_rms = fall * surfaces_apart(step, run.linear.predictions);
  run.work.add("step", 2.0 * count_of(run.fitted));
  set_difference({"numerics.step", "1", "", Unknown::Scale::kShift, 0, 1.5,
                  "1.5 times its estimated error", NumberRole::kNumerics},
                 step, fall, run.data, run.linear, run.found.state);
  NoiseModel& noise = run.found.scales.noise;
  noise.along_motion = std::max(noise.along_motion, run.numerics_rms());
}

void settle_scales(CalibrationRun& run, const std::vector<Observation>* frames) {
  constexpr double kFirstMode = 3e-4;  // [m]
  std::optional<FitData> made;
  const FitData& data = look_at(run, frames, made);
  const SearchLimits& limits = run.search.limits;
  Eigen::VectorXd& own_sd = run.found.scales.own_sd;
  if (own_sd[data.layout.own() - 1] < 1e-6)
    own_sd.tail(data.layout.modes.count).setConstant(kFirstMode);
  const auto improve_here = [&](int steps) {
    run.found = improve(data, run.linear, run.fitted, steps, limits, std::move(run.found));
    run.posterior = posterior_at(data, run.linear, run.fitted, limits, run.found);
  };
  for (int round = 0; round < 6; ++round) {
    improve_here(round == 0 ? 8 : 3);
    adapt_own_scales(data, run.posterior, run.fitted, run.found.state, run.found.scales);
  }
  improve_here(8);
}

void settle(double work, CalibrationRun& run) {
  constexpr int kRounds = 3;
  for (int round = 0; round < kRounds; ++round) {
    settle_scales(run);
    if (run.settled &&
        moved(run.data, run.fitted, run.linear.at, run.found.state, run.posterior) < kSmallMove)
      break;
    descend({run.fine, 3, kSmallMove, work, "settling"}, run);
  }
}

Calibration finish(CalibrationRun run) {
  run.work.begin_stage();
  run.believed = {believed_state(run.data), {}};
  run.believed.predictions =
      run.model.simulate(run.data, run.believed.at, run.fine, false, run.fitted);
  run.work.add("before", count_of(run.fitted));
  collect_fit(run);
  leave_out(run);
  collect(run);
  return std::move(run.result);
}

}  // namespace omentum
