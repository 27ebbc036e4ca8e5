#include "mismatch/explain/explain.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <map>
#include <optional>

#include "core/check.h"
#include "mismatch/explain/contenders.h"
#include "mismatch/explain/dispersion.h"
#include "mismatch/explain/scatter.h"
#include "mismatch/explain/spread.h"
#include "mismatch/explain/verdict_parts.h"
#include "mismatch/explain/verdict_words.h"
#include "mismatch/fit/camera_errors.h"

namespace omentum {
namespace {

constexpr std::size_t kContenders = 4;  // effects that are refitted by simulations
// Columns that gain so much are worth a refit: a strong effect is not linear, and gains more by
// itself. Nulls of three engines reach 3.3, and gain nothing by what is simulated then
// (docs/decisions/0049-what-a-base-fit-rests-on.md).
constexpr double kWorthRefitting = 3;  // [nats]

template <typename T>
T value_or_throw(Result<T> result) {
  if (!result) throw_error("explain: {}", result.error());
  return std::move(result).value();
}

void split_evidence(std::vector<Evidence> all, Case& made) {
  made.fitted.clear();
  made.held_out.clear();
  made.folds.clear();
  for (Evidence& evidence : all) {
    const auto seen =
        std::ranges::find(made.base.data.observations, evidence.name, &Observation::name);
    if (seen->held_out) {
      made.held_out.push_back(std::move(evidence));
      continue;
    }
    made.folds.push_back(seen->repeat_of.empty() ? seen->name : seen->repeat_of);
    made.fitted.push_back(std::move(evidence));
  }
}

/// Pinches and clocks scatter as the fitted recordings say: what all of them have is no scatter.
void learn_scatters(Case& made) {
  const Layout& layout = made.base.data.layout;
  const auto learn = [&](const Scatter& scatter, const Layout::Columns& columns) {
    auto own = made.base.found.scales.own_sd.segment(layout.among_own(columns), columns.count);
    const double sd = value_or_throw(learned_scatter(made.fitted, scatter, own[0]));
    own.setConstant(sd);
    set_scatter(scatter, sd, made.fitted);
    set_scatter(scatter, sd, made.held_out);
  };
  learn({"pinch.", "grasp_offset", 2e-4}, layout.pinch);
  learn({"clock", "actuation_delay", 1e-3}, layout.own_clock);
}

/// Whether an effect that acts on one side alone would have to act on the other.
bool is_impossible(const Case& made, const ScoreTest& test) {
  return made.candidate(test.atom).one_sided && !(test.amplitude > 0);
}

/// Evidence of the base, and what it says of every candidate.
void ask(std::vector<Evidence> evidence, Case& made) {
  split_evidence(std::move(evidence), made);
  learn_scatters(made);
  made.dispersion = value_or_throw(learned_dispersion(made.fitted, made.folds));
  const Thresholds& thresholds = made.options.thresholds;
  if (made.floors.empty())
    made.floors = value_or_throw(amplitude_floors(made.fitted, made.options.floor_factor));
  made.tests = value_or_throw(score_tests(value_or_throw(make_folds(made.fitted, made.folds))));
  made.judged = value_or_throw(judge_atoms(made.fitted, made.folds, made.floors, thresholds));
  for (const ScoreTest& test : made.tests) {
    if (is_impossible(made, test)) withdraw(test.atom, made.judged);
  }
}

/// Of a nuisance that is pulled farther than it can be, and not in one recording alone, as nothing
/// is claimed by one alone; empty where none is.
std::string told_pull(const Case& made) {
  std::map<std::string, std::string> folds;
  for (std::size_t k = 0; k < made.fitted.size(); ++k) folds[made.fitted[k].name] = made.folds[k];
  const std::optional<Pull> pull = repeated_pull(value_or_throw(pulls(made.fitted)), folds);
  if (!pull || std::fabs(pull->pull) <= made.options.thresholds.pull) return {};
  return pull_text(*pull);
}

/// Where recordings disagree about every effect, which two correct models do not; else empty.
std::string told_disagreement(const Case& made) {
  constexpr double kMost = 5;  // of what is stated; nulls of other engines have 1
  if (made.dispersion <= kMost) return {};
  return fmt::format("recordings disagree about every effect {:.0f} times as much as models do",
                     made.dispersion);
}

/// What shows most, and the fold that it shows in: one alone proves nothing.
std::string told_suspect(const Case& made) {
  const auto most = std::ranges::max_element(made.tests, {}, [&](const ScoreTest& test) {
    return test.testable && !is_impossible(made, test) ? std::fabs(test.z) : 0;
  });
  if (most == made.tests.end()) return {};
  const auto gains = std::ranges::find(made.judged.gains, most->atom, &AtomGains::atom);
  const auto fold = std::ranges::max_element(gains->folds, {}, &FoldGain::gain);
  return fmt::format(
      "; most like {}, which {} shows alone: record more lifts of other pinches near it",
      key_text(most->atom), fold->fold);
}

/// Nothing that was simulated is claimed: silent, unless something was, columns claim one of
/// `first`, a nuisance is pulled farther than it can be, or recordings disagree.
void tell_no_claim(const Case& made, const std::vector<Candidate>& first,
                   const std::vector<Contender>& contenders, pb::Verdict& verdict) {
  const auto by_columns = std::ranges::find_if(first, [&](const Candidate& c) {
    return std::ranges::find(made.judged.gains, c.key, &AtomGains::atom)->claimed;
  });
  const std::string pulled = told_pull(made), disagreement = told_disagreement(made);
  verdict.set_status("unexplained");
  if (!contenders.empty() && contenders.front().gain > made.options.thresholds.gain) {
    const Contender& best = contenders.front();
    verdict.set_reason(fmt::format(
        "{} fits best of what was simulated, but recordings disagree {:.0f} times as much as they "
        "should about its numbers: record more lifts of other pinches near it",
        best.fit.effect.name, best.gain / best.agreed));
  } else if (by_columns != first.end()) {
    verdict.set_reason(by_columns->effect +
                       " is claimed by its columns, and no simulation with it fits better");
  } else if (!pulled.empty()) {
    verdict.set_reason(pulled + ", and no effect brings it down");
  } else if (!disagreement.empty()) {
    verdict.set_reason(disagreement + told_suspect(made));
  } else {
    verdict.set_status("no_mismatch_detectable");
  }
}

/// Of what was simulated: what it adds to each fold as the others foretell it, and how far folds
/// agree about its numbers.
void judge(const Case& made, const Case& beside, Contender& contender) {
  const auto before = value_or_throw(foretold_densities(made.fitted, made.folds));
  const auto with = value_or_throw(foretold_densities(beside.fitted, beside.folds));
  for (std::size_t k = 0; k < with.size(); ++k) {
    contender.fold_names.push_back(with[k].fold);
    contender.folds.push_back(with[k].log_density - before[k].log_density);
  }
  Spread spread = value_or_throw(spread_of(contender.fit.keys(), beside.fitted, beside.folds));
  contender.fit.sd = std::move(spread.sd);
  contender.gain = trimmed_sum(contender.folds);
  contender.agreed = contender.gain / spread.dispersion;
}

/// Refits one candidate after the other, and asks everything again with it in the base. The
/// contenders, that of the largest gain on top, and the case with this one in the base; no case
/// where recordings do not agree about it enough: what fits worse is not claimed instead.
std::pair<std::vector<Contender>, std::optional<Case>> refit(const Case& made,
                                                             const std::vector<Candidate>& first,
                                                             ReferenceForward& model) {
  std::pair<std::vector<Contender>, std::optional<Case>> refitted;
  auto& [contenders, best] = refitted;
  ExplainOptions quiet = made.options;  // shares done are those of the whole
  quiet.progress = nullptr;
  constexpr double kInTheRace = 0.5;  // of what the best one gained
  const double least = made.options.thresholds.gain;
  double most = 0, most_gained = 0;
  for (const Candidate& candidate : first) {
    // Columns foretell z^2 / 2 nats; what would not lead with twice of it is not simulated.
    const double z = std::ranges::find(made.tests, candidate.key, &ScoreTest::atom)->z;
    if (z * z < most) continue;
    if (made.options.progress)
      made.options.progress(0.7 + 0.2 * static_cast<double>(&candidate - first.data()) /
                                      static_cast<double>(first.size()),
                            "refit with " + candidate.effect);
    const double worth = std::max(kInTheRace * most_gained, least);
    std::optional<EntrantFit> fit =
        fit_entrant(made.base, candidate, made.candidates,
                    place_of(candidate, made.candidates, made.tests), worth, model);
    if (!fit) continue;
    most_gained = std::max(most_gained, fit->gained);
    Contender contender{std::move(*fit), {}, {}};
    Case beside{
        made.options, contender.fit.fit, made.candidates, {}, {}, {}, 1, made.floors, {}, {}};
    ask(gather_evidence(contender.fit, model, quiet), beside);
    judge(made, beside, contender);
    if (contender.gain > most) {
      most = contender.gain;
      best.emplace(std::move(beside));
    }
    contenders.push_back(std::move(contender));
  }
  sort_by_gain(contenders);
  if (best && !(contenders.front().agreed > least)) best.reset();
  return refitted;
}

/// What fits best, and foretells what was held out worse than the base does, explains nothing.
void tell_withdrawn(const Contender& best, pb::Verdict& verdict) {
  verdict.set_status("unexplained");
  verdict.set_reason(fmt::format("{} fits best of what was simulated, but {}", best.fit.effect.name,
                                 contradiction_text(verdict)));
}

/// What is claimed beside the winner in the base decides how much it explains.
void tell_claim(const Case& made, const Case& beside, const std::vector<Contender>& contenders,
                pb::Verdict& verdict) {
  add_effect(made, beside, contenders, verdict);
  verdict.set_dispersion_left(beside.dispersion);
  const std::string pulled = told_pull(beside), disagreement = told_disagreement(beside);
  const std::string contradiction = contradiction_text(verdict);
  if (!contradiction.empty()) {
    verdict.set_status("partly_explained");
    verdict.set_reason(contradiction);
  } else if (!beside.judged.entrants.empty()) {
    constexpr std::size_t kTold = 3;
    std::vector<std::string> left;
    for (const Entrant& entrant : beside.judged.entrants) {
      if (left.size() < kTold) left.push_back(entrant.atom);
    }
    verdict.set_status("partly_explained");
    verdict.set_reason(fmt::format("beside it {} is still claimed", fmt::join(left, ", ")));
  } else if (!pulled.empty()) {
    verdict.set_status("partly_explained");
    verdict.set_reason("beside it " + pulled);
  } else if (!disagreement.empty()) {
    verdict.set_status("partly_explained");
    verdict.set_reason("beside it " + disagreement);
  } else {
    verdict.set_status(verdict.effects(0).class_().members_size() > 1 ? "explained_as_class"
                                                                      : "explained");
  }
}

/// Share of the squared error of all fitted recordings above their floor that is gone.
void add_explained_share(pb::Verdict& verdict) {
  double before = 0, after = 0;
  for (const pb::VerdictFit& row : verdict.fit()) {
    if (row.role() != "fit") continue;
    const double floor = row.floor() * row.floor();
    before += row.rmse_base() * row.rmse_base() - floor;
    after += row.rmse_model() * row.rmse_model() - floor;
  }
  verdict.set_explained_share(before > 0 ? 1 - after / before : 0);
  verdict.mutable_effects(0)->set_explained_share(verdict.explained_share());
}

void add_predictions(const BaseFit& base, const BaseFit& best, Explanation& made) {
  const TissueBody& body = base.data.made.tissue;
  for (const Eigen::Vector3d& p : body.particles) made.uv_B.push_back(p.head<2>());
  made.triangles = body.surface_triangles;
  const std::size_t places = body.particles.size();
  for (std::size_t r = 0; r < base.data.observations.size(); ++r) {
    const Observation& seen = base.data.observations[r];
    PredictedRecording& out = made.predictions.emplace_back();
    out.name = seen.name;
    const Linearisation before{base.found.state, base.surfaces};
    const Linearisation after{best.found.state, best.surfaces};
    for (std::size_t f = 0; f < seen.frames.size(); ++f) {
      if (f >= base.surfaces[r].frames.size() || !base.surfaces[r].frames[f].valid ||
          !best.surfaces[r].frames[f].valid)
        continue;
      const auto upper = [&](const BaseFit& fit, const Linearisation& linear) {
        const FitState plain = without_difference(fit.data, fit.found.state, r);
        auto vertices = fit.data.likelihood.vertices(comparison(fit.data, linear, plain, r), f);
        vertices.resize(places);
        return vertices;
      };
      out.times.push_back(seen.frames[f].t);
      out.base.push_back(upper(base, before));
      out.model.push_back(upper(best, after));
      out.seen.push_back(seen.frames[f].points);
      out.tips.push_back(best.surfaces[r].frames[f].tip);
    }
  }
}

/// The scene of `fit` for others: with the numbers of the base, registration and clock of the
/// camera, and a model that trains.
pb::Scene fitted_scene(const BaseFit& base, const BaseFit& fit) {
  pb::Scene scene = scene_at(fit.data.scene, base.data.unknowns,
                             fit.found.state.shared.head(base.data.layout.unknowns.count), {},
                             held_place(base.data));
  FitState camera = fit.found.state;
  const Layout& layout = fit.data.layout;
  for (const std::size_t r : fit.fitted) {  // what all clocks are off by is the camera's
    camera.shared[layout.clock.begin] +=
        camera.own[r][layout.among_own(layout.own_clock)] / static_cast<double>(fit.fitted.size());
  }
  set_camera_errors(fit.data, camera, scene);
  scene.mutable_tissue()->set_model(pb::TISSUE_ELASTIC);
  return scene;
}

}  // namespace

Explanation explain(const pb::Scene& scene, std::vector<Observation> observations,
                    const ExplainOptions& options) {
  const std::clock_t started = std::clock();
  const auto say = [&](double share, const std::string& stage) {
    if (options.progress) options.progress(share, stage);
  };
  ReferenceForward model;
  Case made{
      options, fit_base(scene, std::move(observations), options, model), {}, {}, {}, {}, 1, {}, {},
      {}};
  made.candidates = candidates_of(made.base.data.made, options.ruled_out);
  ResidualMap residuals = residual_map(made.base);
  const std::vector<Candidate> simulated =
      simulated_candidates(made.base, residuals, options.ruled_out);
  made.candidates.insert(made.candidates.end(), simulated.begin(), simulated.end());
  say(0.45, "numerics");
  const std::vector<Candidate> failed = add_columns(made.candidates, options, model, made.base);
  ask(gather_evidence(made.base, model, options), made);
  say(0.7, "refits");
  const std::vector<Candidate> first = first_candidates(
      made.candidates, made.tests, made.judged.gains, kWorthRefitting, kContenders);
  const auto [contenders, beside] = refit(made, first, model);

  Explanation out;
  out.residuals = std::move(residuals);
  pb::Verdict& verdict = out.verdict;
  add_settings(made, verdict);
  add_limits(made, verdict);
  add_scores(made, verdict);
  add_pulls(made, verdict);
  add_bounds(made.base, verdict);
  add_rivals(made, contenders, verdict);
  for (const Candidate& c : failed)
    verdict.add_warnings(c.key + " cannot be simulated and was not asked");
  const BaseFit& fits_best = beside ? contenders.front().fit.fit : made.base;
  say(0.95, "held-out recordings");
  add_fit(made, fits_best, model, verdict);
  const bool claimed = beside && !foretells_worse(verdict);
  const BaseFit& best = claimed ? fits_best : made.base;
  if (claimed) {
    tell_claim(made, *beside, contenders, verdict);
    add_explained_share(verdict);
  } else if (beside) {
    tell_withdrawn(contenders.front(), verdict);
  } else {
    tell_no_claim(made, first, contenders, verdict);
  }
  add_channels(made, best, verdict);
  add_bad_recordings(made, verdict);
  add_predictions(made.base, best, out);
  out.scene = fitted_scene(made.base, best);
  out.base_scene = fitted_scene(made.base, made.base);
  verdict.set_core_seconds(core_seconds_since(started, *made.base.data.setup.simulator));
  return out;
}

}  // namespace omentum
