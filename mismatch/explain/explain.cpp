#include "mismatch/explain/explain.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <map>
#include <set>

#include "core/check.h"
#include "mismatch/explain/candidates.h"
#include "mismatch/explain/detection_limits.h"
#include "mismatch/explain/entrant.h"
#include "mismatch/explain/shares.h"
#include "mismatch/explain/verdict_class.h"

namespace omentum {
namespace {

constexpr double kNinety = 1.6448536;  // standard deviations of a two-sided interval of 90 %
constexpr double kFarPoint = 0.03;     // [m] from the surface: no tissue

template <typename T>
T value_or_throw(Result<T> result) {
  if (!result) throw_error("explain: {}", result.error());
  return std::move(result).value();
}

/// A case on its way to a verdict.
struct Case {
  const ExplainOptions& options;
  std::vector<Candidate> candidates;
  BaseFit base;
  std::vector<Evidence> fitted, held_out;
  std::vector<std::string> folds;  ///< of `fitted`: a recording and its repeats are one
  Floors floors;

  const Candidate& candidate(const std::string& key) const {
    return *std::ranges::find(candidates, key, &Candidate::key);
  }
  double progress_at = 0.7;
};

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

/// A stiffer place and a softer one are two names.
std::string name_of(const Candidate& candidate, double amplitude) {
  return candidate.effect == "inclusion" && amplitude < 0 ? "soft_spot" : candidate.effect;
}

/// Where its columns say an effect is: weighted centroid of z^2 over the places near the best.
std::optional<Eigen::Vector2d> place_of(const Candidate& best, const Case& made,
                                        const std::vector<ScoreTest>& tests) {
  if (!best.place) return std::nullopt;
  double most = 0;
  for (const ScoreTest& test : tests) {
    if (test.atom == best.key) most = std::fabs(test.z);
  }
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double weights = 0;
  for (const ScoreTest& test : tests) {
    const Candidate& c = made.candidate(test.atom);
    if (c.effect != best.effect || !c.place || !test.testable) continue;
    const bool near = (*c.place - *best.place).norm() < 3 * best.size + 1e-9;
    if (!near || std::fabs(test.z) < 0.5 * most) continue;
    sum += test.z * test.z * *c.place;
    weights += test.z * test.z;
  }
  return weights > 0 ? Eigen::Vector2d(sum / weights) : *best.place;
}

/// Ranked by score tests: those that are one-sided only where their sign is theirs.
const Entrant* first_entrant(const VerdictClass& judged, const Case& made,
                             const std::vector<ScoreTest>& tests) {
  for (const Entrant& entrant : judged.entrants) {
    const Candidate& candidate = made.candidate(entrant.atom);
    const auto test = std::ranges::find(tests, entrant.atom, &ScoreTest::atom);
    if (!candidate.one_sided || test->amplitude > 0) return &entrant;
  }
  return nullptr;
}

void add_limits(const Case& made, pb::Verdict& verdict) {
  const FoldEvidence folds = value_or_throw(make_folds(made.fitted, made.folds));
  const std::vector<DetectionLimit> limits =
      value_or_throw(detection_limits(folds, made.floors, made.options.thresholds));
  // Of an effect with several places or directions that which is seen best.
  std::map<std::string, const DetectionLimit*> best;
  for (const DetectionLimit& limit : limits) {
    const Candidate& c = made.candidate(limit.atom);
    const std::string number = c.key.substr(0, c.key.find('@'));
    const DetectionLimit*& kept = best[number];
    if (kept == nullptr || (limit.testable && limit.detected < kept->detected)) kept = &limit;
  }
  for (const auto& [number, limit] : best) {
    pb::VerdictLimit& row = *verdict.add_detection_limits();
    row.set_effect(number);
    row.set_unit(made.candidate(limit->atom).unit);
    row.set_testable(limit->testable);
    if (!limit->testable) {
      row.set_why_not("these recordings know nothing of it beside base and nuisances");
      continue;
    }
    row.set_amplitude(limit->detected);
    row.set_amplitude_named(limit->named);
    row.set_floor_amplitude(limit->floor.amplitude);
    row.set_floor_from(limit->floor.numerics);
    row.set_look_alike(limit->look_alike);
  }
}

void add_scores(const Case& made, const std::vector<ScoreTest>& tests, const VerdictClass& judged,
                pb::Verdict& verdict) {
  for (const ScoreTest& test : tests) {
    if (!test.testable) continue;
    const Candidate& c = made.candidate(test.atom);
    pb::VerdictScore& row = *verdict.add_scores();
    row.set_key(test.atom);
    row.set_effect(c.effect);
    row.set_z(test.z);
    const auto gain = std::ranges::find(judged.gains, test.atom, &AtomGains::atom);
    if (gain != judged.gains.end()) row.set_gain(gain->trimmed);
    if (!c.place) continue;
    row.add_place_m(c.place->x());
    row.add_place_m(c.place->y());
  }
}

void add_pulls(std::span<const Evidence> fitted, pb::Verdict& verdict) {
  constexpr double kWarned = 4;  // standard deviations
  constexpr int kMost = 12;
  const std::vector<Pull> all = value_or_throw(pulls(fitted));
  for (const Pull& pull : all) {
    if (verdict.pulls_size() >= kMost) break;
    pb::VerdictPull& row = *verdict.add_pulls();
    row.set_name(pull.owner.empty() ? pull.key : pull.owner + ": " + pull.key);
    row.set_pull(pull.pull);
    if (std::fabs(pull.pull) > kWarned) {
      verdict.add_warnings(fmt::format("{} is pulled {:.1f} standard deviations from its belief",
                                       row.name(), pull.pull));
    }
  }
}

double largest_pull(std::span<const Evidence> fitted) {
  const std::vector<Pull> all = value_or_throw(pulls(fitted));
  return all.empty() ? 0 : std::fabs(all.front().pull);
}

/// Rms distance from points to a surface [m], and mean square with its standard error by frames.
struct Misfit {
  double rms = 0;
};
Misfit misfit(const BaseFit& fit, const std::vector<Prediction>& surfaces, std::size_t r) {
  const Linearisation linear{fit.found.state, surfaces};
  FitState plain = fit.found.state;
  plain.own[r].tail(kModes).setZero();
  double squares = 0, count = 0;
  for (const auto& frame : distances(fit.data, linear, plain, r, kFarPoint)) {
    for (const double d : frame) {
      if (!std::isfinite(d)) continue;
      squares += d * d;
      ++count;
    }
  }
  return {count > 0 ? std::sqrt(squares / count) : std::nan("")};
}

void add_fit(const Case& made, const EntrantFit* winner, ReferenceForward& model,
             pb::Verdict& verdict) {
  const Numerics shell{pb::TISSUE_ELASTIC, {}, 1};
  const BaseFit& base = made.base;
  const BaseFit& best = winner != nullptr ? winner->fit : base;
  std::vector<Prediction> shell_base, shell_model;
  if (winner != nullptr && !base.held_out.empty()) {
    shell_base = model.simulate(base.data, base.found.state, shell, false, base.held_out);
    shell_model = model.simulate(best.data, best.found.state, shell, false, base.held_out);
  }
  for (const Which* which : {&base.fitted, &base.held_out}) {
    for (const std::size_t r : *which) {
      pb::VerdictFit& row = *verdict.add_fit();
      const double before = misfit(base, base.surfaces, r).rms;
      const double after = misfit(best, best.surfaces, r).rms;
      const double floor = base.found.scales.noise.sigma;
      row.set_recording(base.data.observations[r].name);
      row.set_role(which == &base.fitted ? "fit" : "held_out");
      row.set_rmse_base(before);
      row.set_rmse_model(after);
      row.set_floor(floor);
      const double excess = before * before - floor * floor;
      constexpr double kAboveNoise = 0.5;  // of its square: below it there is nothing to explain
      if (excess > kAboveNoise * floor * floor) row.set_r((after * after - floor * floor) / excess);
      if (shell_base.empty() || which == &base.fitted) continue;
      row.set_rmse_shell_base(misfit(base, shell_base, r).rms);
      row.set_rmse_shell_model(misfit(best, shell_model, r).rms);
    }
  }
}

/// Whether held-out recordings, which nothing has seen, say the same (docs/mismatch.md 5.6).
void confirm(const Case& made, const std::string& atom, pb::VerdictEffect& effect) {
  if (made.held_out.empty()) {
    effect.set_confirmed(false);
    effect.set_why_not_confirmed("no recording was held out");
    return;
  }
  std::vector<Evidence> all = made.fitted;
  std::vector<std::string> folds = made.folds;
  std::vector<std::size_t> held;
  for (const Evidence& evidence : made.held_out) {
    all.push_back(evidence);
    folds.push_back("held out: " + evidence.name);
  }
  const FoldEvidence joined = value_or_throw(make_folds(all, folds));
  for (std::size_t k = 0; k < joined.folds.size(); ++k) {
    if (joined.folds[k].name.starts_with("held out: ")) held.push_back(k);
  }
  const auto gains = value_or_throw(held_out_gains(joined, held, made.floors));
  for (int k = 0; k < joined.atoms(); ++k) {
    if (joined.atom(k).key != atom) continue;
    bool any = false;
    for (const FoldGain& gain : gains[static_cast<std::size_t>(k)]) {
      if (gain.foretold < made.options.thresholds.foretold) continue;
      any = true;
      if (gain.gain > 0) continue;
      effect.set_confirmed(false);
      effect.set_why_not_confirmed(gain.fold + " does not gain by it");
      return;
    }
    effect.set_confirmed(any);
    if (!any) effect.set_why_not_confirmed("the recordings held out would not show it");
  }
}

void fill_effect(const Case& made, const EntrantFit& entrant, const Entrant& judged,
                 const AtomGains& gains, pb::VerdictEffect& effect) {
  effect.set_gain(judged.gain);
  for (const EntrantFit::Parameter& number : entrant.numbers) {
    if (number.name == "x" || number.name == "y") {
      if (entrant.candidate.place) continue;
    }
    pb::VerdictParameter& row = *effect.add_parameters();
    // Of a stiffness factor the change was looked for.
    const double neutral = entrant.candidate.effect == "inclusion" ? 1 : 0;
    const auto floor = made.floors.find(entrant.candidate.key);
    const double wide =
        kNinety * number.sd + (floor == made.floors.end() ? 0 : floor->second.amplitude);
    row.set_name(number.name);
    row.set_unit(number.unit);
    row.set_value(neutral + number.value);
    row.set_low90(neutral + number.value - wide);
    row.set_high90(neutral + number.value + wide);
  }
  const auto number = [&](const char* name) -> const EntrantFit::Parameter* {
    const auto found = std::ranges::find(entrant.numbers, name, &EntrantFit::Parameter::name);
    return found == entrant.numbers.end() ? nullptr : &*found;
  };
  if (entrant.candidate.place) {
    pb::VerdictWhere& where = *effect.mutable_where();
    const auto* x = number("x");
    const auto* y = number("y");
    if (x != nullptr && y == nullptr) {
      const double half = 0.5 * entrant.numbers.front().value;
      where.add_edge_interval_m(x->value - half);
      where.add_edge_interval_m(x->value + half);
    }
    where.add_centre_m(x != nullptr ? x->value : entrant.candidate.place->x());
    where.add_centre_m(y != nullptr ? y->value : entrant.candidate.place->y());
    constexpr double kHalf = 1.1774;  // of a normal distribution in the plane
    if (x != nullptr && y != nullptr)
      where.set_radius50_m(kHalf * std::sqrt(0.5 * (x->sd * x->sd + y->sd * y->sd)));
  }
  // Without the largest gain of a recording it would not be claimed.
  std::vector<FoldGain> folds = gains.folds;
  std::ranges::sort(folds, std::greater<>(), &FoldGain::gain);
  if (folds.size() > 1 && gains.total - folds.front().gain < made.options.thresholds.gain)
    effect.add_rests_on(folds.front().fold);
}

std::string patch_text(const EntrantFit& entrant) {
  pb::Scene patch;
  apply_effects({entrant.effect}, patch);
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(patch, &text));
  return text;
}

/// Members of the class, one entry an effect, with shares by what they foretell of recordings left
/// out.
void fill_class(const Case& made, const VerdictClass& judged, const std::string& winner,
                const std::string& winner_name, pb::VerdictEffect& effect) {
  std::vector<std::string> names = {winner_name}, atoms = {winner};
  for (const std::string& atom : judged.members) {
    const std::string& name = made.candidate(atom).effect;
    if (name == made.candidate(winner).effect || std::ranges::count(names, name) > 0) continue;
    names.push_back(name);
    atoms.push_back(atom);
  }
  const auto gains_of = [&](const std::string& atom) {
    return *std::ranges::find(judged.gains, atom, &AtomGains::atom);
  };
  Eigen::MatrixXd density(static_cast<Eigen::Index>(gains_of(winner).folds.size()),
                          static_cast<Eigen::Index>(atoms.size()));
  for (Eigen::Index k = 0; k < density.cols(); ++k) {
    const AtomGains gains = gains_of(atoms[static_cast<std::size_t>(k)]);
    for (Eigen::Index r = 0; r < density.rows(); ++r)
      density(r, k) = gains.folds[static_cast<std::size_t>(r)].against_zero;
  }
  const Eigen::VectorXd shares = stacking_weights(density);
  for (Eigen::Index k = 0; k < density.cols(); ++k) {
    pb::VerdictMember& member = *effect.mutable_class_()->add_members();
    member.set_name(names[static_cast<std::size_t>(k)]);
    member.set_probability(shares[k]);
  }
}

void add_rivals(const VerdictClass& judged, pb::Verdict& verdict) {
  constexpr std::size_t kMost = 10, kMostLeft = 5;
  for (const Entrant& entrant : judged.entrants) {
    if (static_cast<std::size_t>(verdict.rivals_size()) >= kMost) break;
    pb::VerdictRival& rival = *verdict.add_rivals();
    rival.set_name(entrant.atom);
    rival.set_gain(entrant.gain);
    rival.set_adequate(entrant.adequate);
    rival.set_largest_pull(entrant.largest_pull.pull);
    for (const LeftGain& left : entrant.left) {
      if (static_cast<std::size_t>(rival.left_size()) >= kMostLeft) break;
      pb::VerdictLeft& row = *rival.add_left();
      row.set_name(left.atom);
      row.set_gain(left.gain);
    }
  }
}

/// What is still claimed beside the winner in the base.
std::vector<std::string> still_claimed(const EntrantFit& entrant, const Case& made,
                                       ReferenceForward& model, double& pull) {
  Case beside{made.options, made.candidates, entrant.fit, {}, {}, {}, made.floors};
  split_evidence(gather_evidence(entrant, model, made.options), beside);
  pull = largest_pull(beside.fitted);
  const VerdictClass judged = value_or_throw(
      judge_atoms(beside.fitted, beside.folds, made.floors, made.options.thresholds));
  std::vector<std::string> names;
  for (const Entrant& left : judged.entrants) names.push_back(left.atom);
  return names;
}

void tell_bad_recordings(const Case& made, pb::Verdict& verdict) {
  constexpr double kTimes = 5;  // of the others' residual
  std::vector<double> levels;
  for (const std::size_t r : made.base.fitted)
    levels.push_back(misfit(made.base, made.base.surfaces, r).rms);
  std::vector<double> sorted = levels;
  std::ranges::sort(sorted);
  const double middle = sorted[sorted.size() / 2];
  for (std::size_t k = 0; k < levels.size(); ++k) {
    if (!(levels[k] > kTimes * middle)) continue;
    verdict.set_status("bad_recording");
    verdict.set_reason(fmt::format("{} is {:.2f} mm from its simulation, the others {:.2f} mm",
                                   made.base.data.observations[made.base.fitted[k]].name,
                                   1e3 * levels[k], 1e3 * middle));
  }
  for (const std::size_t r : made.base.failed) {
    verdict.add_warnings(fmt::format("recording {} cannot be simulated and is left out",
                                     made.base.data.observations[r].name));
  }
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
        FitState plain = fit.found.state;
        plain.own[r].tail(kModes).setZero();
        auto vertices = fit.data.likelihood.vertices(comparison(fit.data, linear, plain, r), f);
        vertices.resize(places);
        return vertices;
      };
      out.times.push_back(seen.frames[f].t);
      out.base.push_back(upper(base, before));
      out.model.push_back(upper(best, after));
      out.seen.push_back(seen.frames[f].points);
    }
  }
}

}  // namespace

Explanation explain(const pb::Scene& scene, std::vector<Observation> observations,
                    const ExplainOptions& options) {
  const std::clock_t started = std::clock();
  const auto say = [&](double share, const std::string& stage) {
    if (options.progress) options.progress(share, stage);
  };
  ReferenceForward model;
  std::vector<Candidate> candidates =
      candidates_of(make_scene(scene, options.folder), options.ruled_out);
  BaseFit base = fit_base(scene, std::move(observations), candidates, options, model);
  Case made{options, std::move(candidates), std::move(base), {}, {}, {}, {}};
  split_evidence(gather_evidence(made.base, model, options), made);
  say(0.72, "tests");
  made.floors = value_or_throw(amplitude_floors(made.fitted, options.floor_factor));
  const FoldEvidence folds = value_or_throw(make_folds(made.fitted, made.folds));
  const std::vector<ScoreTest> tests = value_or_throw(score_tests(folds));
  const VerdictClass judged =
      value_or_throw(judge_atoms(made.fitted, made.folds, made.floors, options.thresholds));

  Explanation out;
  pb::Verdict& verdict = out.verdict;
  verdict.set_format_version(1);
  verdict.set_seed(options.seed);
  verdict.set_threshold(options.thresholds.gain);
  verdict.set_floor_factor(options.floor_factor);
  pb::VerdictSolver& solver = *verdict.mutable_solver();
  solver.set_model("reference");
  for (const int count : made.base.fine.elements) solver.add_elements(count);
  for (const int count : made.base.coarse.elements) solver.add_coarse_elements(count);
  for (const Observation& seen : made.base.data.observations) {
    pb::VerdictRecording& row = *verdict.add_recordings();
    row.set_id(seen.name);
    row.set_role(seen.held_out ? "held_out" : seen.repeat_of.empty() ? "fit" : "repeat");
  }
  for (const std::string& name : options.ruled_out) verdict.add_ruled_out(name);
  add_limits(made, verdict);
  add_scores(made, tests, judged, verdict);
  add_pulls(made.fitted, verdict);
  add_rivals(judged, verdict);

  const Entrant* first = first_entrant(judged, made, tests);
  std::optional<EntrantFit> entrant;
  verdict.set_status("no_mismatch_detectable");
  const double pull = largest_pull(made.fitted);
  if (first == nullptr && pull > options.thresholds.pull) {
    verdict.set_status("unexplained");
    verdict.set_reason(
        fmt::format("{} is pulled {:.1f} standard deviations, and no effect brings it down",
                    verdict.pulls(0).name(), pull));
  }
  if (first != nullptr) {
    say(0.75, "refit with " + made.candidate(first->atom).effect);
    const Candidate& candidate = made.candidate(first->atom);
    entrant = fit_entrant(made.base, candidate, place_of(candidate, made, tests), model);
    if (!entrant) {
      verdict.set_status("unexplained");
      verdict.set_reason(candidate.effect +
                         " is claimed by its columns, and no simulation with it fits better");
    } else {
      say(0.85, "everything again");
      double left_pull = 0;
      const std::vector<std::string> left = still_claimed(*entrant, made, model, left_pull);
      pb::VerdictEffect& effect = *verdict.add_effects();
      fill_class(made, judged, first->atom, name_of(candidate, entrant->numbers.front().value),
                 effect);
      fill_effect(made, *entrant, *first,
                  *std::ranges::find(judged.gains, first->atom, &AtomGains::atom), effect);
      confirm(made, first->atom, effect);
      const bool adequate = left.empty() && left_pull <= options.thresholds.pull;
      verdict.set_status(!adequate                            ? "partly_explained"
                         : effect.class_().members_size() > 1 ? "explained_as_class"
                                                              : "explained");
      if (!left.empty()) {
        verdict.set_reason(fmt::format(
            "beside it {} is still claimed",
            fmt::join(std::span(left).first(std::min<std::size_t>(left.size(), 3)), ", ")));
      } else if (!adequate) {
        verdict.set_reason(
            fmt::format("beside it a nuisance is pulled {:.1f} standard deviations", left_pull));
      }
      verdict.set_scene_patch(patch_text(*entrant));
    }
  }
  say(0.92, "held-out recordings");
  add_fit(made, entrant ? &*entrant : nullptr, model, verdict);
  if (entrant) {
    double before = 0, after = 0;
    for (const pb::VerdictFit& row : verdict.fit()) {
      if (row.role() != "fit") continue;
      before += row.rmse_base() * row.rmse_base();
      after += row.rmse_model() * row.rmse_model();
    }
    verdict.set_explained_share(before > 0 ? 1 - after / before : 0);
    verdict.mutable_effects(0)->set_explained_share(verdict.explained_share());
  }
  tell_bad_recordings(made, verdict);
  if (made.folds.size() < kLeastTrimmed) {
    verdict.add_warnings(fmt::format(
        "{} recordings that differ: nothing is trimmed below {}",
        std::set<std::string>(made.folds.begin(), made.folds.end()).size(), kLeastTrimmed));
  }
  verdict.add_warnings(
      "forces are not asked yet; obstacles, slip and turned jaws are asked by columns alone");
  const BaseFit& best = entrant ? entrant->fit : made.base;
  add_predictions(made.base, best, out);
  out.scene = scene_at(best.data.scene, made.base.data.unknowns,
                       best.found.state.shared.head(made.base.data.layout.unknowns.count), {},
                       held_place(made.base.data));
  out.scene.mutable_tissue()->set_model(pb::TISSUE_ELASTIC);
  verdict.set_core_seconds(core_seconds_since(started, *made.base.data.setup.simulator));
  return out;
}

}  // namespace omentum
