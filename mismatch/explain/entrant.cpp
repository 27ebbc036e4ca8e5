#include "mismatch/explain/entrant.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

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

/// A search over numbers of an effect and of the base, each state of it simulated.
class EntrantSearch {
 public:
  EntrantSearch(const BaseFit& base, const Candidate& candidate, ReferenceForward& model)
      : base_(base),
        candidate_(candidate),
        model_(model),
        all_(all_of(base)),
        columns_(with_columns(base, model, base.fitted)) {}

  /// Amplitude and base numbers together, as columns foretell them.
  std::pair<double, FitState> foretold() const {
    constexpr int kSteps = 8;
    FitData joint = base_.data;
    const auto atom = std::ranges::find(joint.unknowns, candidate_.key, &Unknown::path);
    const auto k = atom - joint.unknowns.begin();
    atom->role = NumberRole::kNuisance;  // it may move
    FitState led = improve(joint, columns_, base_.fitted, kSteps, base_.limits, base_.found).state;
    const double amplitude = led.shared[k];
    led.shared[k] = 0;
    return {amplitude, std::move(led)};
  }

  /// Simulates at a point and a state, by the coarse mesh as a change of the finer surfaces.
  /// Nothing where too little is simulated.
  std::optional<BaseFit> simulate(const Point& point, const FitState& state) {
    BaseFit fit = base_;
    fit.data.scene = scene_with(base_, candidate_, point);
    fit.found.state = state;
    fit.coarse_surfaces = model_.simulate(fit.data, state, fit.coarse, false, all_);
    if (!is_simulated(fit.coarse_surfaces, base_.coarse_surfaces, all_)) return std::nullopt;
    fit.surfaces = changed_surfaces(base_.surfaces, base_.coarse_surfaces, fit.coarse_surfaces);
    return fit;
  }

  double cost(const BaseFit& fit) const {
    return cost_of(fit.data, {fit.found.state, fit.surfaces}, base_.fitted, fit.found.state,
                   base_.found.scales);
  }

  /// Surfaces of `fit` with the derivatives of the base and those by the numbers of the effect,
  /// which become unknowns of `fit`, at zero.
  Linearisation linearise(const Point& point, const std::vector<Axis>& axes, BaseFit& fit) {
    Linearisation linear{fit.found.state, fit.surfaces};
    for (const std::size_t r : base_.fitted) {
      for (std::size_t f = 0; f < linear.predictions[r].frames.size(); ++f) {
        PredictedFrame& frame = linear.predictions[r].frames[f];
        if (frame.valid) frame.columns = columns_.predictions[r].frames[f].columns;
      }
    }
    const FitState at = fit.found.state;
    for (const Axis& axis : axes) {
      Point there = point;
      there.at(static_cast<std::size_t>(&axis - axes.data())) += axis.step;
      FitData moved = base_.data;
      moved.scene = scene_with(base_, candidate_, there);
      const auto other = model_.simulate(moved, at, fit.coarse, false, all_);
      Unknown unknown;
      unknown.path = path_of(axis);
      unknown.unit = axis.unit;
      unknown.scale = Unknown::Scale::kShift;
      unknown.sd = axis.sd;
      unknown.role = NumberRole::kNuisance;  // no field of the scene that scene_at() could set
      set_difference(unknown, changed_surfaces(base_.surfaces, base_.coarse_surfaces, other),
                     1 / axis.step, fit.data, linear, fit.found.state);
    }
    return linear;
  }

 private:
  const BaseFit& base_;
  const Candidate& candidate_;
  ReferenceForward& model_;
  Which all_;
  Linearisation columns_;
};

/// Of a state with numbers of the effect among the unknowns that of the base, without them.
FitState without_entrant(const FitState& state, const Layout& with, const Layout& base) {
  FitState made = state;
  made.shared = Eigen::VectorXd::Zero(base.shared());
  made.shared.head(base.unknowns.count) = state.shared.head(base.unknowns.count);
  const int rest = base.shared() - base.unknowns.count;
  made.shared.tail(rest) = state.shared.segment(with.unknowns.count, rest);
  return made;
}

}  // namespace

std::optional<EntrantFit> fit_entrant(const BaseFit& base, const Candidate& candidate,
                                      const std::optional<Vector2d>& place,
                                      ReferenceForward& model) {
  constexpr int kRounds = 4, kSteps = 8;
  EntrantSearch search(base, candidate, model);
  struct Tried {
    Point point;
    FitState state;
  };
  auto [amplitude, led] = search.foretold();
  Tried now{{amplitude, place}, std::move(led)}, best = now;
  const double without = search.cost(base);
  double least = without;
  std::optional<EntrantFit> entrant;
  for (int round = 0; round < kRounds; ++round) {
    std::optional<BaseFit> fit = search.simulate(now.point, now.state);
    const double cost = fit ? search.cost(*fit) : std::numeric_limits<double>::infinity();
    if (round > 0 && !(cost < least)) {  // half the way back
      for (std::size_t k = 0; k < axes_of(candidate, now.point.amplitude).size(); ++k)
        now.point.at(k) = 0.5 * (now.point.at(k) + best.point.at(k));
      now.state.shared = 0.5 * (now.state.shared + best.state.shared);
      for (std::size_t r = 0; r < now.state.own.size(); ++r)
        now.state.own[r] = 0.5 * (now.state.own[r] + best.state.own[r]);
      continue;
    }
    if (!fit) return std::nullopt;
    best = now;
    least = cost;
    const std::vector<Axis> axes = axes_of(candidate, now.point.amplitude);
    const Linearisation linear = search.linearise(now.point, axes, *fit);
    const SearchState begin = fit->found;
    fit->found = improve(fit->data, linear, base.fitted, kSteps, base.limits, begin);
    const FitPosterior posterior =
        posterior_at(fit->data, linear, base.fitted, base.limits, fit->found);
    entrant = EntrantFit{candidate, {}, {}, base.data.scene, std::move(*fit)};
    // No farther than the differences may hold: the whole step is shortened.
    const int first = entrant->fit.data.layout.unknowns.count - static_cast<int>(axes.size());
    const FitState& found = entrant->fit.found.state;
    double share = 1;
    for (std::size_t k = 0; k < axes.size(); ++k) {
      const double by = std::fabs(found.shared[first + static_cast<int>(k)]);
      const double most = k == 0 ? 0.7 * std::fabs(now.point.amplitude) : 2 * axes[k].step;
      if (by * share > most) share = most / by;
    }
    for (std::size_t k = 0; k < axes.size(); ++k) {
      const int column = first + static_cast<int>(k);
      now.point.at(k) += share * found.shared[column];
      entrant->numbers.push_back(
          {axes[k].name, axes[k].unit, now.point.at(k),
           std::sqrt(std::max(posterior.shared_covariance(column, column), 0.0))});
    }
    const FitState ended = without_entrant(found, entrant->fit.data.layout, base.data.layout);
    now.state = best.state;
    now.state.shared += share * (ended.shared - best.state.shared);
    for (const std::size_t r : base.fitted)
      now.state.own[r] += share * (ended.own[r] - best.state.own[r]);
  }
  if (!entrant) return std::nullopt;
  // The last step counts if it fits better.
  const std::optional<BaseFit> last = search.simulate(now.point, now.state);
  if (last && search.cost(*last) < least) {
    best = now;
    least = search.cost(*last);
  }
  if (!(least < without)) return std::nullopt;
  BaseFit& fit = entrant->fit;
  fit.data.scene = scene_with(base, candidate, best.point);
  const auto axes = axes_of(candidate, best.point.amplitude);
  for (std::size_t k = 0; k < axes.size(); ++k) entrant->numbers[k].value = best.point.at(k);
  const Layout& layout = fit.data.layout;
  fit.found.state.own = best.state.own;
  fit.found.state.shared.setZero();
  fit.found.state.shared.head(base.data.layout.unknowns.count) =
      best.state.shared.head(base.data.layout.unknowns.count);
  const int rest = base.data.layout.shared() - base.data.layout.unknowns.count;
  fit.found.state.shared.segment(layout.unknowns.count, rest) = best.state.shared.tail(rest);
  entrant->effect = effect_of(candidate, best.point.amplitude, best.point.place, base.data.made);
  const Which all = all_of(base);
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
