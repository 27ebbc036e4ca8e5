#include "mismatch/explain/entrant.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "mismatch/fit/recording_evidence.h"

namespace omentum {
namespace {

using Eigen::Vector2d;

/// The effect as it stands while it is refitted, and base and nuisances beside it.
struct Tried {
  std::vector<double> searched;
  FitState state;
};

std::string path_of(const EffectNumber& number) { return "entrant." + number.name; }

/// Values of shared numbers for a fit that has others: by path, 0 where it is new.
FitState carried(const FitState& state, const FitData& from, const FitData& to) {
  FitState made = state;
  made.shared = Eigen::VectorXd::Zero(to.layout.shared());
  for (std::size_t k = 0; k < to.unknowns.size(); ++k) {
    const auto found = std::ranges::find(from.unknowns, to.unknowns[k].path, &Unknown::path);
    if (found != from.unknowns.end())
      made.shared[static_cast<Eigen::Index>(k)] = state.shared[found - from.unknowns.begin()];
  }
  const int rest = to.layout.shared() - to.layout.unknowns.count;
  made.shared.tail(rest) = state.shared.tail(rest);
  return made;
}

/// The base with no other candidate than these, and without numerics, which no simulation has: the
/// fewer columns, the faster it is.
BaseFit with_candidates(const BaseFit& base, const std::vector<Candidate>& kept) {
  BaseFit made = base;
  std::vector<Unknown> unknowns;
  std::vector<int> place(base.data.unknowns.size(), -1);
  for (std::size_t k = 0; k < base.data.unknowns.size(); ++k) {
    const Unknown& u = base.data.unknowns[k];
    const bool left_out =
        u.role == NumberRole::kAtom && std::ranges::count(kept, u.path, &Candidate::key) == 0;
    if (left_out || u.role == NumberRole::kNumerics) continue;
    place[k] = static_cast<int>(unknowns.size());
    unknowns.push_back(u);
  }
  made.data.differences.clear();
  set_unknowns(std::move(unknowns), made.data);
  made.found.state = carried(base.found.state, base.data, made.data);
  for (const DifferenceColumn& d : base.data.differences) {
    const int to = place[static_cast<std::size_t>(d.column)];
    if (to >= 0) made.data.differences.push_back({to, d.by});
  }
  made.pinch_atoms.clear();
  for (const auto& [column, axis] : base.pinch_atoms) {
    const int to = place[static_cast<std::size_t>(column)];
    if (to >= 0) made.pinch_atoms.emplace_back(to, axis);
  }
  made.delay_atom.reset();
  if (base.delay_atom) {
    const int to = place[static_cast<std::size_t>(*base.delay_atom)];
    if (to >= 0) made.delay_atom = to;
  }
  return made;
}

constexpr int kSteps = 8;  // of Gauss and Newton on one linearisation

/// Derivatives of a scene with the effect in it: columns of the base, and differences of
/// simulations by the numbers of the effect. They stay while steps along them hold.
struct Derivatives {
  std::vector<double> searched;                ///< of the effect, where they were taken
  std::vector<Prediction> base;                ///< with columns
  std::vector<Prediction> at;                  ///< surfaces there, of the mesh of `moved`
  std::vector<std::vector<Prediction>> moved;  ///< by a step of each number
  std::vector<double> steps;                   ///< of each number
};

/// What simulates an effect: the coarse mesh, whose change from the base is put on surfaces of the
/// finer one, or the finer one itself.
enum class Mesh { kCoarse, kFine };

/// A search over numbers of an effect and of the base, each state of it simulated.
class EntrantSearch {
 public:
  EntrantSearch(const BaseFit& base, const Candidate& candidate,
                const std::vector<Candidate>& candidates, const std::optional<Vector2d>& place,
                ReferenceForward& model)
      : axes_(with_companions(candidate, candidates)),
        base_(with_candidates(base, axes_)),
        candidate_(candidate),
        model_(model),
        columns_(with_columns(base_, model, base_.fitted)) {
    auto [amplitudes, led] = foretold();
    numbers_ = effect_numbers(candidate, candidates, amplitudes, place, base_.data.made);
    // Lines of the mesh let go of the clamp one after the other: a step passes one.
    for (EffectNumber& number : numbers_) {
      if (candidate.effect != "anchor_detachment") continue;
      const double line_m = (number.high - number.low) / base_.coarse.elements[0];
      number.step = std::max(number.step, line_m);
    }
    const auto begin_at = [&](const std::vector<EffectNumber>& numbers) {
      Tried begin{{}, led};
      for (const EffectNumber& number : numbers)
        begin.searched.push_back(number.searched(number.start));
      begins_.push_back(std::move(begin));
    };
    begin_at(numbers_);
    // What was simulated is nearer to what it does than a line through it.
    if (candidate.secant != 0)
      begin_at(effect_numbers(candidate, candidates, {candidate.secant}, place, base_.data.made));
  }

  const BaseFit& base() const { return base_; }
  const std::vector<EffectNumber>& numbers() const { return numbers_; }
  const std::vector<Tried>& begins() const { return begins_; }

  NamedEffect effect(const std::vector<double>& searched) const {
    std::vector<double> values;
    for (std::size_t k = 0; k < numbers_.size(); ++k)
      values.push_back(numbers_[k].value(searched[k]));
    return effect_of(candidate_, numbers_, values, base_.data.made);
  }

  /// Simulates recordings on a mesh. Nothing where too little is simulated.
  std::optional<BaseFit> simulate(const Tried& at, Mesh mesh, const Which& which) const {
    BaseFit fit = base_;
    fit.found.state = at.state;
    fit.data.scene = scene_with(at.searched);
    fit.surfaces = surfaces_of(at, mesh, which);
    if (!is_simulated(fit.surfaces, base_.surfaces, which)) return std::nullopt;
    return fit;
  }

  /// Whether the effect is the mean of what recordings have of their own: no surface changes.
  bool takes_over() const {
    return candidate_.pinch_axis >= 0 || candidate_.effect == "actuation_delay";
  }

  double cost(const BaseFit& fit) const {
    return cost_of(fit.data, {fit.found.state, fit.surfaces}, base_.fitted, fit.found.state,
                   base_.found.scales);
  }

  /// Columns of the base beside the effect, and a step of each of its numbers, simulated on the
  /// mesh that `fit` was.
  Derivatives differentiate(const Tried& at, const BaseFit& fit, Mesh mesh) const {
    Derivatives made{at.searched, columns_beside(at, fit), fit.surfaces, {}, {}};
    for (std::size_t k = 0; k < numbers_.size(); ++k) {
      auto [surfaces, by] = moved(at, k, mesh, base_.fitted);
      made.moved.push_back(std::move(surfaces));
      made.steps.push_back(by);
    }
    return made;
  }

  /// Surfaces with a number of the effect moved by a step, and the step.
  std::pair<std::vector<Prediction>, double> moved(const Tried& at, std::size_t k, Mesh mesh,
                                                   const Which& which) const {
    const EffectNumber& number = numbers_[k];
    Tried there = at;
    // Backwards where the range ends.
    const bool ends = number.value(at.searched[k] + number.step) >= number.high;
    const double by = ends ? -number.step : number.step;
    there.searched[k] += by;
    return {surfaces_of(there, mesh, which), by};
  }

  /// Whether a number of the effect goes farther than a difference of simulations.
  bool leaves(const std::vector<double>& from, const std::vector<double>& to) const {
    for (std::size_t k = 0; k < numbers_.size(); ++k) {
      if (std::fabs(to[k] - from[k]) > numbers_[k].step) return true;
    }
    return false;
  }

  /// Where base and nuisances are led beside the surfaces of `fit`, the effect as it is, and the
  /// cost there as their columns foretell it.
  std::pair<Tried, double> led_beside(const Tried& at, const BaseFit& fit) const {
    const Linearisation linear = with_columns_of(columns_.predictions, fit);
    Tried led{at.searched,
              improve(fit.data, linear, base_.fitted, kSteps, base_.limits, fit.found).state};
    const double cost = cost_of(fit.data, linear, base_.fitted, led.state, base_.found.scales);
    return {std::move(led), cost};
  }

  /// Surfaces of `fit` with the derivatives of the base and those by the numbers of the effect,
  /// which become unknowns of `fit`, at zero.
  Linearisation linearise(const Derivatives& derivatives, BaseFit& fit) const {
    Linearisation linear = with_columns_of(derivatives.base, fit);
    for (std::size_t k = 0; k < numbers_.size(); ++k) {
      const EffectNumber& number = numbers_[k];
      Unknown unknown;
      unknown.path = path_of(number);
      unknown.unit = number.unit;
      unknown.scale = Unknown::Scale::kShift;
      unknown.sd = number.sd;
      unknown.role = NumberRole::kNuisance;  // no field of the scene that scene_at() could set
      set_difference(unknown, changed_surfaces(fit.surfaces, derivatives.at, derivatives.moved[k]),
                     1 / derivatives.steps[k], fit.data, linear, fit.found.state);
    }
    return linear;
  }

 private:
  std::vector<Prediction> surfaces_of(const Tried& at, Mesh mesh, const Which& which) const {
    FitData data = base_.data;
    data.scene = scene_with(at.searched);
    const bool finely = mesh == Mesh::kFine;
    std::vector<Prediction> made =
        model_.simulate(data, at.state, finely ? base_.fine : base_.coarse, false, which);
    return finely ? extrapolated_as_base(base_, std::move(made))
                  : changed_surfaces(base_.surfaces, base_.coarse_surfaces, made);
  }

  /// Of a scene without the effect where it has none with it (memory, slip).
  std::vector<Prediction> columns_beside(const Tried& at, const BaseFit& fit) const {
    FitData data = base_.data;
    data.scene = scene_with(at.searched);
    for (Unknown& u : data.unknowns) {
      if (u.role == NumberRole::kAtom) u.column.clear();
    }
    auto made = model_.simulate(data, at.state, fit.coarse, true, base_.fitted);
    return is_simulated(made, base_.coarse_surfaces, base_.fitted) ? made : columns_.predictions;
  }

  Linearisation with_columns_of(const std::vector<Prediction>& columns, const BaseFit& fit) const {
    Linearisation linear{fit.found.state, fit.surfaces};
    for (const std::size_t r : base_.fitted) {
      for (std::size_t f = 0; f < linear.predictions[r].frames.size(); ++f) {
        PredictedFrame& frame = linear.predictions[r].frames[f];
        const Eigen::MatrixXf& of_frame = columns[r].frames[f].columns;
        if (frame.valid)
          frame.columns =
              of_frame.size() > 0 ? of_frame : columns_.predictions[r].frames[f].columns;
      }
    }
    return linear;
  }

  /// Amplitudes and base numbers together, as columns foretell them.
  std::pair<std::vector<double>, FitState> foretold() const {
    if (takes_over()) return taken_over();
    FitData joint = base_.data;
    for (Unknown& u : joint.unknowns) {
      if (u.role == NumberRole::kAtom) u.role = NumberRole::kNuisance;  // it may move
    }
    FitState led = improve(joint, columns_, base_.fitted, kSteps, base_.limits, base_.found).state;
    std::vector<double> amplitudes;
    for (const Candidate& c : axes_) {
      double& x = led.shared[std::ranges::find(joint.unknowns, c.key, &Unknown::path) -
                             joint.unknowns.begin()];
      amplitudes.push_back(c.one_sided ? std::max(x, 0.0) : x);
      x = 0;
    }
    return {std::move(amplitudes), std::move(led)};
  }

  /// An effect that takes over the mean of what recordings have of their own.
  std::pair<std::vector<double>, FitState> taken_over() const {
    const Layout& layout = base_.data.layout;
    FitState led = base_.found.state;
    std::vector<double> amplitudes;
    for (const Candidate& c : axes_) {
      const Eigen::Index own = c.pinch_axis >= 0 ? layout.among_own(layout.pinch) + c.pinch_axis
                                                 : layout.among_own(layout.own_clock);
      double mean = 0;
      for (const std::size_t r : base_.fitted)
        mean += led.own[r][own] / static_cast<double>(base_.fitted.size());
      if (c.one_sided) mean = std::max(mean, 0.0);
      for (const std::size_t r : base_.fitted) led.own[r][own] -= mean;
      amplitudes.push_back(mean);
    }
    return {std::move(amplitudes), std::move(led)};
  }

  pb::Scene scene_with(const std::vector<double>& searched) const {
    pb::Scene scene = base_.data.scene;
    apply_effects({effect(searched)}, scene);
    return scene;
  }

  std::vector<Candidate> axes_;
  BaseFit base_;
  const Candidate& candidate_;
  ReferenceForward& model_;
  Linearisation columns_;
  std::vector<EffectNumber> numbers_;
  std::vector<Tried> begins_;
};

Tried between(const Tried& from, const Tried& to, double share) {
  Tried made{from.searched, between(from.state, to.state, share)};
  for (std::size_t k = 0; k < from.searched.size(); ++k)
    made.searched[k] += share * (to.searched[k] - from.searched[k]);
  return made;
}

struct Step {
  Tried to;
  std::vector<double> sd;  ///< of the numbers of the effect
  BaseFit fit;             ///< with their derivatives, where the step begins
  double foretold;         ///< what it would gain on linear surfaces [nats]
};

/// Where Gauss and Newton lead from `at`, no farther than differences may hold: the whole step is
/// shortened.
Step next_step(const EntrantSearch& search, const Tried& at, const Derivatives& derivatives,
               BaseFit fit) {
  constexpr double kFarthest = 4;  // of the steps of the differences
  const BaseFit& base = search.base();
  const Linearisation linear = search.linearise(derivatives, fit);
  const auto cost = [&] {
    return cost_of(fit.data, linear, base.fitted, fit.found.state, fit.found.scales);
  };
  const double before = cost();
  fit.found = improve(fit.data, linear, base.fitted, kSteps, base.limits, fit.found);
  const double whole = before - cost();
  const FitPosterior posterior =
      posterior_at(fit.data, linear, base.fitted, base.limits, fit.found);
  Tried led{at.searched, carried(fit.found.state, fit.data, base.data)};
  std::vector<double> sd;
  double share = 1;
  for (std::size_t k = 0; k < search.numbers().size(); ++k) {
    const EffectNumber& number = search.numbers()[k];
    const auto column = std::ranges::find(fit.data.unknowns, path_of(number), &Unknown::path) -
                        fit.data.unknowns.begin();
    led.searched[k] =
        number.searched(number.value(at.searched[k] + fit.found.state.shared[column]));
    const double by = std::fabs(led.searched[k] - at.searched[k]);
    if (by * share > kFarthest * number.step) share = kFarthest * number.step / by;
    sd.push_back(std::sqrt(std::max(posterior.shared_covariance(column, column), 0.0)));
  }
  return {between(at, led, share), std::move(sd), std::move(fit), whole * share * (2 - share)};
}

/// How far a search is.
struct Reached {
  Tried at;
  BaseFit fit;
  double cost;
};

/// The start that fits best once base and nuisances follow it, as far as they lead to where it
/// does. Nothing where none can be simulated.
std::optional<Reached> begin(const EntrantSearch& search) {
  std::optional<Reached> begun;
  Tried led;
  double least = std::numeric_limits<double>::infinity();
  for (const Tried& at : search.begins()) {
    std::optional<BaseFit> fit = search.simulate(at, Mesh::kCoarse, search.base().fitted);
    if (!fit) continue;
    auto [beside, cost] = search.led_beside(at, *fit);
    if (!(cost < least)) continue;
    least = cost;
    led = std::move(beside);
    const double here = search.cost(*fit);
    begun = Reached{at, std::move(*fit), here};
  }
  if (!begun) return std::nullopt;
  StepLength length;
  length.aim(begun->cost - least);
  while (!length.settled()) {
    Tried next = between(begun->at, led, length.share());
    std::optional<BaseFit> fit = search.simulate(next, Mesh::kCoarse, search.base().fitted);
    const double cost = fit ? search.cost(*fit) : std::numeric_limits<double>::infinity();
    if (length.accept(begun->cost - cost)) return Reached{std::move(next), std::move(*fit), cost};
  }
  return begun;
}

/// Steps along `derivatives`, each simulated, until they gain nothing. The step that would come
/// next.
Step follow(const EntrantSearch& search, const Derivatives& derivatives, Mesh mesh,
            Reached& reached) {
  constexpr int kMost = 6;
  Step step = next_step(search, reached.at, derivatives, reached.fit);
  StepLength length;
  length.aim(step.foretold);
  for (int tried = 0; tried < kMost && !length.settled(); ++tried) {
    const Tried next = between(reached.at, step.to, length.share());
    std::optional<BaseFit> fit = search.simulate(next, mesh, search.base().fitted);
    const double cost = fit ? search.cost(*fit) : std::numeric_limits<double>::infinity();
    if (!length.accept(reached.cost - cost)) continue;
    reached = {next, std::move(*fit), cost};
    step = next_step(search, reached.at, derivatives, reached.fit);
    length.aim(step.foretold);
  }
  return step;
}

/// Steps along derivatives, made anew where a number of the effect went farther than a difference.
/// The step that would come next.
Step descend(const EntrantSearch& search, int most_rounds, Mesh mesh, Reached& reached) {
  constexpr double kGained = 2;  // [nats] a round that gains less is the last
  for (int round = 1;; ++round) {
    const Derivatives derivatives = search.differentiate(reached.at, reached.fit, mesh);
    const Reached before = reached;
    Step step = follow(search, derivatives, mesh, reached);
    if (round == most_rounds || before.cost - reached.cost < kGained ||
        !search.leaves(before.at.searched, reached.at.searched))
      return step;
  }
}

}  // namespace

std::vector<double> EntrantFit::values() const {
  std::vector<double> values;
  for (std::size_t k = 0; k < numbers.size(); ++k) values.push_back(numbers[k].value(searched[k]));
  return values;
}

std::vector<std::string> EntrantFit::keys() const {
  std::vector<std::string> keys;
  for (const EffectNumber& number : numbers) keys.push_back(path_of(number));
  return keys;
}

std::optional<EntrantFit> fit_entrant(const BaseFit& base, const Candidate& candidate,
                                      const std::vector<Candidate>& candidates,
                                      const std::optional<Vector2d>& place, double worth,
                                      ReferenceForward& model) {
  EntrantSearch search(base, candidate, candidates, place, model);
  const double without = search.cost(search.base());
  std::optional<Reached> begun = begin(search);
  if (!begun) return std::nullopt;
  Reached& reached = *begun;
  const bool finely = !search.takes_over();
  Step step = descend(search, finely ? 1 : 3, Mesh::kCoarse, reached);
  if (finely) {
    // A coarse mesh makes a stiff place of few cells stiffer than it is, and what it says of a
    // place or a radius leads away from both (docs/decisions/0048-fine-derivatives.md).
    std::optional<BaseFit> fine = search.simulate(reached.at, Mesh::kFine, base.fitted);
    if (!fine) return std::nullopt;
    const double gained_coarsely = without - reached.cost;
    reached = {reached.at, std::move(*fine), 0};
    reached.cost = search.cost(reached.fit);
    const double gained = std::max(gained_coarsely, without - reached.cost);
    if (gained > worth) step = descend(search, 2, Mesh::kFine, reached);
  }
  if (!(reached.cost < without)) return std::nullopt;
  EntrantFit entrant{candidate,
                     search.numbers(),
                     reached.at.searched,
                     step.sd,
                     search.effect(reached.at.searched),
                     without - reached.cost,
                     base.data.scene,
                     base};
  // Recordings that are held out follow; its numbers become unknowns.
  const Mesh mesh = finely ? Mesh::kFine : Mesh::kCoarse;
  const std::optional<BaseFit> others = search.simulate(reached.at, mesh, base.held_out);
  if (!others) return std::nullopt;
  BaseFit& fit = entrant.fit;
  fit.found.state = carried(reached.at.state, search.base().data, fit.data);
  apply_effects({entrant.effect}, fit.data.scene);
  fit.surfaces = reached.fit.surfaces;
  for (const std::size_t r : base.held_out) fit.surfaces[r] = others->surfaces[r];
  fit.coarse_surfaces.clear();  // of the base alone
  Linearisation at{fit.found.state, fit.surfaces};
  for (std::size_t k = 0; k < entrant.numbers.size(); ++k) {
    const FitData& from = step.fit.data;
    const auto unknown =
        std::ranges::find(from.unknowns, path_of(entrant.numbers[k]), &Unknown::path);
    const auto column = static_cast<int>(unknown - from.unknowns.begin());
    // No step looked at those held out: their derivatives are taken here.
    const auto [moved, by] = search.moved(reached.at, k, mesh, base.held_out);
    set_difference(*unknown, moved, 1 / by, fit.data, at, fit.found.state);
    const auto followed = std::ranges::find(from.differences, column, &DifferenceColumn::column);
    for (const std::size_t r : base.fitted) fit.data.differences.back().by[r] = followed->by[r];
  }
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
