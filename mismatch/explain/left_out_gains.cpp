#include "mismatch/explain/left_out_gains.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

namespace omentum {

using Eigen::Index;

namespace {

double floor_of(const Floors& floors, const std::string& atom) {
  const auto found = floors.find(atom);
  return found == floors.end() ? 0 : found->second.amplitude;
}

/// Log of the integral over the amplitude and all that is fitted, but for what does not depend on
/// this atom: s^2 / (2 S) - log(S) / 2, prior included.
double log_free(double score, double information) {
  return score * score / (2 * information) - std::log(information) / 2;
}

/// The same with the amplitude held: s a - S a^2 / 2, the prior of the atom left out.
double log_held(double score, double information, double amplitude) {
  return amplitude * (score - information * amplitude / 2);
}

/// `others`: the fit; `all`: the same and the fold. The terms of what is fitted beside the atom are
/// the same in both densities and cancel (docs/mismatch.md 5.3).
FoldGain fold_gain(const ProjectedAtoms& others, const ProjectedAtoms& all, const Number& atom,
                   Index k, double floor) {
  FoldGain result;
  const double prior = atom.precision(), prior_score = prior * atom.mean;
  const double s_others = others.score[k], S_others = others.information(k, k);
  const double s_all = all.score[k], S_all = all.information(k, k);
  if (!(S_others + prior > 0)) return result;  // nothing is known: there is no fit to foretell from
  result.amplitude = (s_others + prior_score) / (S_others + prior);
  result.against_zero = log_free(s_all + prior_score, S_all + prior) -
                        log_free(s_others + prior_score, S_others + prior);
  const double held = std::clamp(result.amplitude, -floor, floor);
  if (held == result.amplitude) return result;
  const double beyond = result.amplitude - held;
  result.foretold = beyond * beyond * std::max(0.0, S_all - S_others) / 2;
  result.gain =
      result.against_zero - (log_held(s_all, S_all, held) - log_held(s_others, S_others, held));
  return result;
}

FoldGain in_sample_gain(const ProjectedAtoms& all, Index k, double floor) {
  FoldGain result;
  const double S = all.information(k, k);
  if (!(S > 0)) return result;
  result.amplitude = all.score[k] / S;
  const double beyond = result.amplitude - std::clamp(result.amplitude, -floor, floor);
  result.gain = result.foretold = S * beyond * beyond / 2;
  result.against_zero = S * result.amplitude * result.amplitude / 2;
  return result;
}

double median_of(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t half = values.size() / 2;
  return values.size() % 2 == 1 ? values[half] : (values[half - 1] + values[half]) / 2;
}

/// Jackknife variance of the amplitude over the variance that its information says.
double dispersion_of(const std::vector<FoldGain>& folds, double information) {
  const auto count = static_cast<double>(folds.size());
  double sum = 0, squares = 0;
  for (const FoldGain& fold : folds) sum += fold.amplitude;
  for (const FoldGain& fold : folds) squares += std::pow(fold.amplitude - sum / count, 2);
  return std::max(1.0, (count - 1) / count * squares * information);
}

void judge(AtomGains& atom, double information, const Thresholds& thresholds) {
  std::vector<double> gains;
  for (const FoldGain& fold : atom.folds) gains.push_back(fold.gain);
  atom.total = std::accumulate(gains.begin(), gains.end(), 0.0);
  atom.dispersion = dispersion_of(atom.folds, information);
  atom.trimmed = trimmed_sum(gains);
  atom.agreed = atom.trimmed / (thresholds.by_dispersion ? atom.dispersion : 1);
  atom.without_worst = gains.size() < 2 ? atom.total : atom.total - std::ranges::min(gains);
  atom.median = median_of(gains);
  atom.in_sample = gains.size() == 1;
  if (gains.size() < kLeastTrimmed) {
    for (const FoldGain& fold : atom.folds) {
      if (fold.foretold >= thresholds.foretold && !(fold.gain > 0)) atom.against = fold.fold;
    }
  }
  atom.claimed = atom.agreed > thresholds.gain && atom.against.empty();
}

}  // namespace

double trimmed_sum(std::vector<double> gains) {
  const double sum = std::accumulate(gains.begin(), gains.end(), 0.0);
  if (gains.size() < kLeastTrimmed) return sum;
  return sum - std::ranges::max(gains) - std::ranges::min(gains);
}

Result<std::vector<AtomGains>> left_out_gains(const FoldEvidence& evidence, const Floors& floors,
                                              const Thresholds& thresholds) {
  auto all = project_atoms(evidence);
  if (!all) return Failure{all.error()};
  std::vector<AtomGains> atoms(static_cast<std::size_t>(evidence.atoms()));
  for (std::size_t k = 0; k < atoms.size(); ++k) {
    atoms[k].atom = evidence.atom(static_cast<int>(k)).key;
    atoms[k].floor = floor_of(floors, atoms[k].atom);
  }
  const bool single = evidence.folds.size() == 1;
  for (std::size_t r = 0; r < evidence.folds.size(); ++r) {
    auto others = single ? all : project_atoms_without(evidence, {&r, 1});
    if (!others) return Failure{others.error()};
    for (std::size_t k = 0; k < atoms.size(); ++k) {
      const auto at = static_cast<Index>(k);
      FoldGain gain = single ? in_sample_gain(all.value(), at, atoms[k].floor)
                             : fold_gain(others.value(), all.value(),
                                         evidence.atom(static_cast<int>(k)), at, atoms[k].floor);
      gain.fold = evidence.folds[r].name;
      atoms[k].folds.push_back(gain);
    }
  }
  for (std::size_t k = 0; k < atoms.size(); ++k) {
    const auto at = static_cast<Index>(k);
    judge(atoms[k], all.value().information(at, at), thresholds);
  }
  return atoms;
}

Result<std::vector<FoldDensity>> foretold_densities(std::span<const Evidence> recordings,
                                                    std::span<const std::string> fold_of) {
  std::vector<Evidence> parts;
  std::vector<FoldDensity> densities;
  for (std::size_t r = 0; r < recordings.size(); ++r) {
    auto part = integrate_own(recordings[r]);
    if (!part) return Failure{part.error()};
    parts.push_back(std::move(part).value());
    if (std::ranges::count(densities, fold_of[r], &FoldDensity::fold) == 0)
      densities.push_back({fold_of[r], 0});
  }
  const auto log_evidence = [&](std::optional<std::string> without) -> Result<double> {
    std::vector<Evidence> kept;
    for (std::size_t r = 0; r < parts.size(); ++r) {
      if (fold_of[r] != without) kept.push_back(parts[r]);
    }
    if (kept.empty()) return 0.0;
    auto sum = sum_evidence(kept);
    if (!sum) return Failure{sum.error()};
    auto posterior = solve(sum.value());
    if (!posterior) return Failure{posterior.error()};
    return posterior.value().log_evidence;
  };
  auto all = log_evidence(std::nullopt);
  if (!all) return Failure{all.error()};
  for (FoldDensity& density : densities) {
    auto others = log_evidence(density.fold);
    if (!others) return Failure{others.error()};
    density.log_density = all.value() - others.value();
  }
  return densities;
}

Result<std::vector<std::vector<FoldGain>>> held_out_gains(const FoldEvidence& evidence,
                                                          std::span<const std::size_t> held_out,
                                                          const Floors& floors) {
  auto fit = project_atoms_without(evidence, held_out);
  if (!fit) return Failure{fit.error()};
  std::vector<std::vector<FoldGain>> gains(static_cast<std::size_t>(evidence.atoms()));
  for (const std::size_t r : held_out) {
    std::vector<std::size_t> others;
    for (const std::size_t other : held_out) {
      if (other != r) others.push_back(other);
    }
    auto with = project_atoms_without(evidence, others);
    if (!with) return Failure{with.error()};
    for (std::size_t k = 0; k < gains.size(); ++k) {
      const Number& atom = evidence.atom(static_cast<int>(k));
      gains[k].push_back(fold_gain(fit.value(), with.value(), atom, static_cast<Index>(k),
                                   floor_of(floors, atom.key)));
      gains[k].back().fold = evidence.folds[r].name;
    }
  }
  return gains;
}

}  // namespace omentum
