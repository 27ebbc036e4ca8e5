#include "mismatch/explain/verdict_parts.h"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "core/check.h"
#include "mismatch/calibrate/number_words.h"
#include "mismatch/explain/block_errors.h"
#include "mismatch/explain/detection_limits.h"
#include "mismatch/explain/force_channel.h"
#include "mismatch/explain/shares.h"
#include "mismatch/explain/verdict_words.h"
#include "mismatch/explain/when.h"
#include "report/section_parts.h"

namespace omentum {
namespace {

constexpr double kNinety = 1.6448536;  // standard deviations of a two-sided interval of 90 %

template <typename T>
T value_or_throw(Result<T> result) {
  if (!result) throw_error("explain: {}", result.error());
  return std::move(result).value();
}

/// Rms distance of the points of a recording from its surface [m].
double rms_from_surface(const BaseFit& fit, std::size_t r) {
  double squares = 0, count = 0;
  for (const auto& frame : distances_from(fit, fit.surfaces, r)) {
    for (const double d : frame) {
      if (!std::isfinite(d)) continue;
      squares += d * d;
      ++count;
    }
  }
  return std::sqrt(squares / count);
}

/// Log density of a recording at the shared numbers of a fit, its own numbers integrated, and
/// those of an effect by their spread [nats].
double log_density(Evidence recording, const std::vector<std::string>& keys = {},
                   const std::vector<double>& sd = {}) {
  for (Number& number : recording.numbers) {
    const auto found = std::ranges::find(keys, number.key);
    if (found == keys.end()) continue;
    number.owner = recording.name;
    number.sd = sd[static_cast<std::size_t>(found - keys.begin())];
    number.mean = 0;
  }
  return value_or_throw(integrate_own(recording)).log_constant;
}

/// Whether the base is farther from a recording than what is not known of it allows.
bool something_to_explain(const pb::Verdict& verdict, const std::string& recording) {
  return std::ranges::any_of(verdict.fit(), [&](const pb::VerdictFit& row) {
    return row.recording() == recording && row.has_r();
  });
}

/// Whether held-out recordings, which nothing has seen, say the same (docs/mismatch.md 5.6): those
/// of which columns foretell it must gain by what was simulated. One that the base fits as well as
/// pinch, stiffness and clock are known says nothing against it.
void confirm(const Case& made, const Case& beside, const EntrantFit& entrant,
             const pb::Verdict& verdict, pb::VerdictEffect& effect) {
  const std::string& atom = entrant.candidate.key;
  if (made.held_out.empty()) {
    effect.set_confirmed(false);
    effect.set_why_not_confirmed("no recording was held out");
    return;
  }
  if (const std::string against = contradiction_text(verdict); !against.empty()) {
    effect.set_confirmed(false);
    effect.set_why_not_confirmed(against);
    return;
  }
  std::vector<Evidence> all = made.fitted;
  std::vector<std::string> folds = made.folds;
  std::vector<std::size_t> held;
  std::map<std::string, double> simulated;
  for (std::size_t k = 0; k < made.held_out.size(); ++k) {
    all.push_back(made.held_out[k]);
    folds.push_back("held out: " + made.held_out[k].name);
    simulated[folds.back()] =
        log_density(beside.held_out[k], entrant.keys(), entrant.sd) - log_density(made.held_out[k]);
  }
  const FoldEvidence joined = value_or_throw(make_folds(all, folds));
  for (std::size_t k = 0; k < joined.folds.size(); ++k) {
    if (joined.folds[k].name.starts_with("held out: ")) held.push_back(k);
  }
  const auto gains = value_or_throw(held_out_gains(joined, held, made.floors));
  for (int k = 0; k < joined.atoms(); ++k) {
    if (joined.atom(k).key != atom) continue;
    bool any = false;
    for (std::size_t h = 0; h < held.size(); ++h) {
      const FoldGain& fold = gains[static_cast<std::size_t>(k)][h];
      const double gain = simulated.at(fold.fold);
      if (std::max(fold.foretold, gain) < made.options.thresholds.foretold) continue;
      const std::string& name = made.held_out[h].name;
      if (gain > 0) any = true;
      if (gain > 0 || !something_to_explain(verdict, name)) continue;
      effect.set_confirmed(false);
      effect.set_why_not_confirmed(
          fmt::format("{} fits worse with it by {} nats", fold.fold, nats(-gain)));
      return;
    }
    effect.set_confirmed(any);
    if (!any) effect.set_why_not_confirmed("the recordings held out would not show it");
  }
}

/// A number that was searched in its logarithm has an interval in it.
void add_parameter(const EffectNumber& number, double searched, double sd, double floor,
                   pb::VerdictEffect& effect) {
  pb::VerdictParameter& row = *effect.add_parameters();
  const double wide = kNinety * sd;
  row.set_name(number.name);
  row.set_unit(number.unit);
  row.set_value(number.value(searched));
  row.set_low90(std::max(number.value(searched - wide) - floor, number.low));
  row.set_high90(std::min(number.value(searched + wide) + floor, number.high));
  row.set_at_bound(row.value() <= number.low || row.value() >= number.high);
}

/// What follows from the numbers of an effect, with the spread that theirs give it.
void add_derived(const EntrantFit& entrant, pb::VerdictEffect& effect) {
  const auto derived_at = [&](const std::vector<double>& searched) {
    std::vector<double> values;
    for (std::size_t k = 0; k < searched.size(); ++k)
      values.push_back(entrant.numbers[k].value(searched[k]));
    return derived_values(
        effect_of(entrant.candidate, entrant.numbers, values, entrant.fit.data.made));
  };
  const std::vector<NamedValue> derived = derived_at(entrant.searched);
  std::vector<double> variance(derived.size(), 0);
  for (std::size_t k = 0; k < entrant.searched.size(); ++k) {
    std::vector<double> low = entrant.searched, high = low;
    low[k] -= entrant.sd[k];
    high[k] += entrant.sd[k];
    const std::vector<NamedValue> below = derived_at(low), above = derived_at(high);
    for (std::size_t d = 0; d < derived.size(); ++d)
      variance[d] += 0.25 * std::pow(above[d].value - below[d].value, 2);
  }
  for (std::size_t d = 0; d < derived.size(); ++d) {
    pb::VerdictParameter& row = *effect.add_parameters();
    row.set_name(derived[d].name);
    row.set_unit(derived[d].unit);
    row.set_value(derived[d].value);
    row.set_low90(derived[d].value - kNinety * std::sqrt(variance[d]));
    row.set_high90(derived[d].value + kNinety * std::sqrt(variance[d]));
  }
}

void add_where(const EntrantFit& entrant, pb::VerdictEffect& effect) {
  if (!entrant.candidate.place) return;
  const auto index = [&](const char* name) {
    return static_cast<std::size_t>(std::ranges::find(entrant.numbers, name, &EffectNumber::name) -
                                    entrant.numbers.begin());
  };
  const std::vector<double> values = entrant.values();
  pb::VerdictWhere& where = *effect.mutable_where();
  const std::size_t x = index("x"), y = index("y");
  if (y == values.size()) {  // on the clamped edge
    const auto [from, to] = std::minmax({values[index("from")], values[index("to")]});
    where.add_edge_interval_m(from);
    where.add_edge_interval_m(to);
    where.add_centre_m(0.5 * (from + to));
    where.add_centre_m(entrant.candidate.place->y());
    return;
  }
  where.add_centre_m(values[x]);
  where.add_centre_m(values[y]);
  constexpr double kHalf = 1.1774;  // of a normal distribution in the plane
  const double sd_x = entrant.sd[x], sd_y = entrant.sd[y];
  where.set_radius50_m(kHalf * std::sqrt(0.5 * (sd_x * sd_x + sd_y * sd_y)));
}

void add_when(const BaseFit& base, const BaseFit& model, pb::VerdictEffect& effect) {
  for (const When& when : when_of(base, model)) {
    pb::VerdictWhen& row = *effect.add_when();
    row.set_recording(when.recording);
    row.set_clock("cloud");
    for (const auto& [begin, end] : when.intervals) {
      pb::VerdictInterval& interval = *row.add_intervals_s();
      interval.set_begin(begin);
      interval.set_end(end);
    }
    for (const std::string& phase : when.phases) row.add_phases(phase);
    row.mutable_onset_s()->set_value(when.onset);
    row.mutable_onset_s()->set_low90(when.onset_low);
    row.mutable_onset_s()->set_high90(when.onset_high);
  }
}

std::string patch_text(const EntrantFit& entrant) {
  pb::Scene patch;
  apply_effects({entrant.effect}, patch);
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(patch, &text));
  return text;
}

/// Shares of the class by what each foretells of the folds.
void add_class(const std::vector<Contender>& members, pb::VerdictEffect& effect) {
  Eigen::MatrixXd density(static_cast<Eigen::Index>(members.front().folds.size()),
                          static_cast<Eigen::Index>(members.size()));
  for (Eigen::Index k = 0; k < density.cols(); ++k) {
    const Contender& member = members[static_cast<std::size_t>(k)];
    for (Eigen::Index r = 0; r < density.rows(); ++r)
      density(r, k) = member.folds[static_cast<std::size_t>(r)];
  }
  const Eigen::VectorXd shares = stacking_weights(density);
  for (Eigen::Index k = 0; k < density.cols(); ++k) {
    pb::VerdictMember& row = *effect.mutable_class_()->add_members();
    row.set_name(members[static_cast<std::size_t>(k)].fit.effect.name);
    row.set_probability(shares[k]);
  }
}

}  // namespace

const Candidate& Case::candidate(const std::string& key) const {
  return *std::ranges::find(candidates, key, &Candidate::key);
}

void add_settings(const Case& made, pb::Verdict& verdict) {
  verdict.set_format_version(1);
  verdict.set_seed(made.options.seed);
  verdict.set_threshold(made.options.thresholds.gain);
  verdict.set_floor_factor(made.options.floor_factor);
  verdict.set_dispersion(made.dispersion);
  pb::VerdictSolver& solver = *verdict.mutable_solver();
  solver.set_model("reference");
  for (const int count : made.base.fine.elements) solver.add_elements(count);
  for (const int count : made.base.coarse.elements) solver.add_coarse_elements(count);
  for (const Observation& seen : made.base.data.observations) {
    pb::VerdictRecording& row = *verdict.add_recordings();
    row.set_id(seen.name);
    row.set_role(seen.held_out ? "held_out" : seen.repeat_of.empty() ? "fit" : "repeat");
  }
  for (const std::string& name : made.options.ruled_out) verdict.add_ruled_out(name);
  const std::size_t folds = std::set<std::string>(made.folds.begin(), made.folds.end()).size();
  if (folds < kLeastTrimmed) {
    verdict.add_warnings(fmt::format("{} recordings that differ: nothing is trimmed below {}",
                                     folds, kLeastTrimmed));
  }
}

void add_limits(const Case& made, pb::Verdict& verdict) {
  const FoldEvidence folds = value_or_throw(make_folds(made.fitted, made.folds));
  const std::vector<DetectionLimit> limits = value_or_throw(
      detection_limits(folds, made.floors, made.options.thresholds, made.dispersion));
  // Of an effect with several places or directions that which is seen best, and the place that is
  // seen worst.
  std::map<std::string, const DetectionLimit*> best;
  std::map<std::string, double> anywhere;
  for (const DetectionLimit& limit : limits) {
    const Candidate& c = made.candidate(limit.atom);
    const std::string number = c.key.substr(0, c.key.find('@'));
    const DetectionLimit*& kept = best[number];
    if (kept == nullptr || (limit.testable && limit.detected < kept->detected)) kept = &limit;
    if (!c.place || c.secant != 0) continue;  // one place alone was simulated
    double& most = anywhere[number];
    most = std::max(most, limit.testable ? limit.detected : HUGE_VAL);
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
    const auto most = anywhere.find(number);
    if (most != anywhere.end() && std::isfinite(most->second))
      row.set_amplitude_anywhere(most->second);
  }
}

void add_scores(const Case& made, pb::Verdict& verdict) {
  for (const ScoreTest& test : made.tests) {
    if (!test.testable) continue;
    const Candidate& c = made.candidate(test.atom);
    pb::VerdictScore& row = *verdict.add_scores();
    row.set_key(test.atom);
    row.set_effect(c.effect);
    row.set_z(test.z);
    const auto gain = std::ranges::find(made.judged.gains, test.atom, &AtomGains::atom);
    if (gain != made.judged.gains.end()) row.set_gain(gain->agreed);
    if (!c.place) continue;
    row.add_place_m(c.place->x());
    row.add_place_m(c.place->y());
  }
}

void add_pulls(const Case& made, pb::Verdict& verdict) {
  constexpr double kWarned = 4;  // standard deviations
  constexpr int kMost = 12;
  const std::vector<Pull> all = value_or_throw(pulls(made.fitted));
  for (const Pull& pull : all) {
    if (verdict.pulls_size() >= kMost) break;
    pb::VerdictPull& row = *verdict.add_pulls();
    row.set_name(pull.name());
    row.set_pull(pull.pull);
  }
  for (const std::string& line : pull_lines(all, kWarned)) verdict.add_warnings(line);
}

void add_bounds(const BaseFit& base, pb::Verdict& verdict) {
  for (int k = 0; k < base.data.layout.unknowns.count; ++k) {
    const Unknown& unknown = base.data.unknowns[static_cast<std::size_t>(k)];
    if (!unknown.in_scene()) continue;
    const Range range = range_of(unknown);
    const double x = base.found.state.shared[k], near = 1e-3 * unknown.sd;
    if (x > range.low + near && x < range.high - near) continue;
    const double none = std::nan("");
    verdict.add_warnings(
        fmt::format("{} is at the bound of what can be believed, {} ({}): the base takes up what "
                    "no candidate describes; its numbers are no measurement",
                    with_words(unknown.path),
                    number_in_line(unknown.value(x), none, none, unknown.unit), unknown.prior));
  }
}

void add_rivals(const Case& made, const std::vector<Contender>& contenders, pb::Verdict& verdict) {
  constexpr std::size_t kMost = 10, kMostLeft = 5;
  for (const Contender& contender : contenders) {
    pb::VerdictRival& rival = *verdict.add_rivals();
    rival.set_name(contender.fit.effect.name);
    rival.set_key(contender.fit.candidate.key);
    rival.set_gain(contender.agreed);
    rival.set_simulated(true);
    for (const NamedValue& value : contender.fit.effect.parameters)
      rival.add_numbers(fmt::format("{} = {:.4g} {}", value.name, value.value, value.unit));
  }
  for (const Entrant& entrant : made.judged.entrants) {
    if (static_cast<std::size_t>(verdict.rivals_size()) >= kMost) break;
    pb::VerdictRival& rival = *verdict.add_rivals();
    rival.set_name(made.candidate(entrant.atom).effect);
    rival.set_key(entrant.atom);
    rival.set_gain(entrant.gain);
    rival.set_simulated(false);
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

void add_effect(const Case& made, const Case& beside, const std::vector<Contender>& contenders,
                pb::Verdict& verdict) {
  const Contender& winner = contenders.front();
  std::vector<Contender> members = {winner};
  for (const Contender& rival : std::span(contenders).subspan(1)) {
    const bool named = std::ranges::any_of(
        members, [&](const Contender& m) { return m.fit.effect.name == rival.fit.effect.name; });
    if (!named && lead(winner, rival) <= made.options.thresholds.reject) members.push_back(rival);
  }
  pb::VerdictEffect& effect = *verdict.add_effects();
  add_class(members, effect);
  effect.set_gain(winner.agreed);
  const EntrantFit& fit = winner.fit;
  const auto floor = made.floors.find(fit.candidate.key);
  for (std::size_t k = 0; k < fit.numbers.size(); ++k) {
    if (fit.candidate.place && (fit.numbers[k].name == "x" || fit.numbers[k].name == "y")) continue;
    const bool amplitude = k == 0 && floor != made.floors.end() && !fit.numbers[k].log;
    add_parameter(fit.numbers[k], fit.searched[k], fit.sd[k],
                  amplitude ? floor->second.amplitude : 0, effect);
  }
  add_derived(fit, effect);
  add_where(fit, effect);
  add_when(made.base, fit.fit, effect);
  confirm(made, beside, fit, verdict, effect);
  // Without the largest gain of a recording it would not be claimed.
  const auto most = std::ranges::max_element(winner.folds);
  double total = 0;
  for (const double gain : winner.folds) total += gain;
  if (winner.folds.size() > 1 && total - *most < made.options.thresholds.gain)
    effect.add_rests_on(winner.fold_names[static_cast<std::size_t>(most - winner.folds.begin())]);
  verdict.set_scene_patch(patch_text(fit));
}

void add_fit(const Case& made, const BaseFit& best, ReferenceForward& model, pb::Verdict& verdict) {
  const Numerics shell{pb::TISSUE_ELASTIC, {}, 1};
  const BaseFit& base = made.base;
  const bool compared = &best != &base && !base.held_out.empty();
  std::vector<Prediction> shell_base, shell_model;
  std::optional<Linearisation> own;
  if (compared) {
    shell_base = model.simulate(base.data, base.found.state, shell, false, base.held_out);
    shell_model = model.simulate(best.data, best.found.state, shell, false, base.held_out);
    own = with_columns(base, model, base.held_out);
  }
  for (const Which* which : {&base.fitted, &base.held_out}) {
    for (const std::size_t r : *which) {
      const bool held_out = which == &base.held_out;
      pb::VerdictFit& row = *verdict.add_fit();
      const BlockErrors errors = block_errors(base, base.surfaces, best, best.surfaces, r,
                                              held_out && own ? &*own : nullptr);
      row.set_recording(base.data.observations[r].name);
      row.set_role(held_out ? "held_out" : "fit");
      row.set_rmse_base(errors.base);
      row.set_rmse_model(errors.model);
      row.set_floor(errors.floor);
      row.set_mse_base_se(errors.base_mse_se);
      const double floor = errors.floor * errors.floor;
      const double excess = errors.base * errors.base - floor;
      // Where the base is not clearly off there is nothing to explain.
      if (excess > 2 * errors.base_mse_se)
        row.set_r((errors.model * errors.model - floor) / excess);
      if (!compared || !held_out) continue;
      const BlockErrors in_shell = block_errors(base, shell_base, best, shell_model, r, nullptr);
      row.set_rmse_shell_base(in_shell.base);
      row.set_rmse_shell_model(in_shell.model);
    }
  }
}

void add_channels(const Case& made, const BaseFit& best, pb::Verdict& verdict) {
  const std::optional<ForceChannel> force = compare_forces(force_rows(made.base, best));
  if (!force) {
    verdict.add_warnings("no force on the tool: stiffness is known against the weight alone");
    return;
  }
  pb::VerdictChannel& row = *verdict.add_channels();
  row.set_name("force");
  row.set_unit("N");
  row.set_rows(static_cast<int>(force->rows));
  row.set_rms_base(force->base);
  row.set_rms_model(force->model);
  row.set_gain(force->gain);
  row.set_contradicts(force->contradicts);
  if (!force->contradicts || verdict.effects_size() == 0) return;
  verdict.set_status("partly_explained");
  if (verdict.reason().empty()) verdict.set_reason("the force on the tool contradicts it");
}

void add_bad_recordings(const Case& made, pb::Verdict& verdict) {
  constexpr double kTimes = 5;  // of the others' residual
  std::vector<double> levels;
  for (const std::size_t r : made.base.fitted) {
    levels.push_back(rms_from_surface(made.base, r));
  }
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

}  // namespace omentum
