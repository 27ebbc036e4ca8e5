#include "mismatch/explain/entrant.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "mismatch/fit/recording_evidence.h"

namespace omentum {
namespace {

using Eigen::Vector2d;

/// The numbers of an effect as they stand while it is refitted.
struct Point {
  double amplitude = 0;
  std::optional<Vector2d> place;
  double& at(std::size_t k) {
    return k == 0 ? amplitude : (*place)[static_cast<Eigen::Index>(k - 1)];
  }
};

struct Axis {
  std::string name, unit;
  double step = 0, sd = 0;
};

std::vector<Axis> axes_of(const Candidate& c, double amplitude) {
  constexpr double kPlaceStep = 0.003, kPlaceSd = 0.01;  // [m]
  const std::string number = c.key.substr(0, c.key.find('@'));
  std::vector<Axis> axes = {{number.substr(number.find('.') + 1), c.unit,
                             0.2 * std::fabs(amplitude), std::max(c.sd, std::fabs(amplitude))}};
  if (!c.place) return axes;
  axes.push_back({"x", "m", kPlaceStep, kPlaceSd});
  if (c.effect != "anchor_detachment") axes.push_back({"y", "m", kPlaceStep, kPlaceSd});
  return axes;
}

pb::Scene scene_with(const BaseFit& base, const Candidate& c, const Point& point) {
  pb::Scene scene = base.data.scene;
  apply_effects({effect_of(c, point.amplitude, point.place, base.data.made)}, scene);
  return scene;
}

Which all_of(const BaseFit& base) {
  Which all = base.fitted;
  all.insert(all.end(), base.held_out.begin(), base.held_out.end());
  std::ranges::sort(all);
  return all;
}

bool is_simulated(const std::vector<Prediction>& now, const std::vector<Prediction>& before,
                  const Which& which) {
  constexpr double kEnough = 0.9;  // of the frames
  return std::ranges::all_of(which, [&](std::size_t r) {
    return static_cast<double>(count_valid(now[r])) >=
           kEnough * static_cast<double>(count_valid(before[r]));
  });
}

std::string path_of(const Axis& axis) { return "entrant." + axis.name; }

}  // namespace

std::optional<EntrantFit> fit_entrant(const BaseFit& base, const Candidate& candidate,
                                      double amplitude, const std::optional<Vector2d>& place,
                                      ReferenceForward& model) {
  constexpr int kRounds = 2, kSteps = 8;
  const Which all = all_of(base);
  // Derivatives of base and nuisances stay those of the base.
  const Linearisation columns =
      model.linearise(base.data, base.found.state, base.coarse, base.fitted);
  EntrantFit entrant{candidate, {}, {}, base.data.scene, base};
  Point point{amplitude, place};
  for (int round = 0; round < kRounds; ++round) {
    const std::vector<Axis> axes = axes_of(candidate, point.amplitude);
    BaseFit& fit = entrant.fit;
    fit.data = base.data;
    fit.data.scene = scene_with(base, candidate, point);
    FitState state = fit.found.state;
    state.shared = base.found.state.shared;
    if (round > 0)
      state.shared.head(base.data.layout.unknowns.count) =
          fit.found.state.shared.head(base.data.layout.unknowns.count);
    state.shared.tail(base.data.layout.shared() - base.data.layout.unknowns.count) =
        fit.found.state.shared.tail(base.data.layout.shared() - base.data.layout.unknowns.count);
    const auto coarse = model.simulate(fit.data, state, fit.coarse, false, all);
    if (!is_simulated(coarse, base.coarse_surfaces, all)) return std::nullopt;
    Linearisation linear{state, changed_surfaces(base.surfaces, base.coarse_surfaces, coarse)};
    for (const std::size_t r : base.fitted) {
      for (std::size_t f = 0; f < linear.predictions[r].frames.size(); ++f) {
        PredictedFrame& frame = linear.predictions[r].frames[f];
        if (frame.valid) frame.columns = columns.predictions[r].frames[f].columns;
      }
    }
    fit.surfaces = linear.predictions;
    for (Prediction& prediction : fit.surfaces) {
      for (PredictedFrame& frame : prediction.frames) frame.columns.resize(0, 0);
    }
    fit.coarse_surfaces = coarse;
    FitState begin = state;
    for (std::size_t k = 0; k < axes.size(); ++k) {
      Point there = point;
      there.at(k) += axes[k].step;
      FitData moved = base.data;
      moved.scene = scene_with(base, candidate, there);
      const auto other = model.simulate(moved, state, fit.coarse, false, all);
      Unknown unknown;
      unknown.path = path_of(axes[k]);
      unknown.unit = axes[k].unit;
      unknown.scale = Unknown::Scale::kShift;
      unknown.sd = axes[k].sd;
      unknown.role = NumberRole::kNuisance;  // no field of the scene that scene_at() could set
      set_difference(unknown, changed_surfaces(base.surfaces, base.coarse_surfaces, other),
                     1 / axes[k].step, fit.data, linear, begin);
    }
    fit.found =
        improve(fit.data, linear, base.fitted, kSteps, base.limits, {begin, base.found.scales});
    const FitPosterior posterior =
        posterior_at(fit.data, linear, base.fitted, base.limits, fit.found);
    entrant.numbers.clear();
    for (std::size_t k = 0; k < axes.size(); ++k) {
      const auto found = std::ranges::find(fit.data.unknowns, path_of(axes[k]), &Unknown::path);
      const auto column = found - fit.data.unknowns.begin();
      // No farther than the difference may hold.
      const double most = k == 0 ? 0.7 * std::fabs(point.amplitude) : 2 * axes[k].step;
      const double by = std::clamp(fit.found.state.shared[column], -most, most);
      point.at(k) += by;
      entrant.numbers.push_back(
          {axes[k].name, axes[k].unit, point.at(k),
           std::sqrt(std::max(posterior.shared_covariance(column, column), 0.0))});
    }
  }
  // The surface with what was found.
  BaseFit& fit = entrant.fit;
  fit.data.scene = scene_with(base, candidate, point);
  for (const std::size_t r : fit.held_out) fit.found.state.own[r].setZero();
  for (Unknown& unknown : fit.data.unknowns) {
    const auto k = &unknown - fit.data.unknowns.data();
    if (unknown.path.starts_with("entrant.")) fit.found.state.shared[k] = 0;
  }
  entrant.effect = effect_of(candidate, point.amplitude, point.place, base.data.made);
  fit.surfaces = model.simulate(fit.data, fit.found.state, fit.fine, false, all);
  if (!is_simulated(fit.surfaces, base.surfaces, all)) return std::nullopt;
  return entrant;
}

std::vector<Evidence> gather_evidence(const EntrantFit& entrant, ReferenceForward& model,
                                      const ExplainOptions& options) {
  // Columns of a base with the effect in it would need columns of its memory: those of the base
  // without it stand in.
  BaseFit fit = entrant.fit;
  fit.data.scene = entrant.base_scene;
  std::vector<Evidence> evidence = gather_evidence(fit, model, options);
  for (Evidence& e : evidence) {
    std::vector<int> kept;
    for (std::size_t k = 0; k < e.numbers.size(); ++k) {
      Number& number = e.numbers[k];
      if (number.role == NumberRole::kAtom && number.effect == entrant.candidate.effect) continue;
      if (number.key.starts_with("entrant.")) number.role = NumberRole::kBase;
      kept.push_back(static_cast<int>(k));
    }
    std::vector<Number> numbers;
    for (const int k : kept) numbers.push_back(e.numbers[static_cast<std::size_t>(k)]);
    e.numbers = std::move(numbers);
    e.A = Eigen::MatrixXd(e.A(kept, kept));
    e.b = Eigen::VectorXd(e.b(kept));
  }
  return evidence;
}

}  // namespace omentum
