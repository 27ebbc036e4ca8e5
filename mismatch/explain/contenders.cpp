#include "mismatch/explain/contenders.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "mismatch/explain/dispersion.h"
#include "mismatch/explain/left_out_gains.h"

namespace omentum {
namespace {

/// - log density of each fitted recording at a state, its own numbers beside it [nats].
std::vector<double> costs_of(const BaseFit& fit) {
  const Linearisation linear{fit.found.state, fit.surfaces};
  const auto cost = [&](const Which& which) {
    return cost_of(fit.data, linear, which, fit.found.state, fit.found.scales);
  };
  const double beliefs = cost({});
  std::vector<double> costs;
  for (const std::size_t r : fit.fitted) costs.push_back(cost({r}) - beliefs);
  return costs;
}

/// Where its columns say an effect is: weighted centroid of z^2 over the places near the best.
std::optional<Eigen::Vector2d> place_of(const Candidate& best,
                                        const std::vector<Candidate>& candidates,
                                        const std::vector<ScoreTest>& tests) {
  if (!best.place || best.secant != 0) return best.place;
  const auto test_of = [&](const std::string& key) {
    return *std::ranges::find(tests, key, &ScoreTest::atom);
  };
  const double most = std::fabs(test_of(best.key).z);
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double weights = 0;
  for (const Candidate& c : candidates) {
    if (c.effect != best.effect || !c.place || c.secant != 0) continue;
    const ScoreTest test = test_of(c.key);
    const bool near = (*c.place - *best.place).norm() < 3 * best.size + 1e-9;
    const bool alike = test.z * test_of(best.key).z > 0;
    if (!test.testable || !near || !alike || std::fabs(test.z) < 0.5 * most) continue;
    sum += test.z * test.z * *c.place;
    weights += test.z * test.z;
  }
  return weights > 0 ? Eigen::Vector2d(sum / weights) : *best.place;
}

}  // namespace

double lead(const Contender& one, const Contender& other) {
  std::vector<double> more;
  for (std::size_t k = 0; k < one.folds.size(); ++k) more.push_back(one.folds[k] - other.folds[k]);
  return trimmed_sum(std::move(more));
}

std::vector<Candidate> first_candidates(const std::vector<Candidate>& candidates,
                                        const std::vector<ScoreTest>& tests,
                                        const std::vector<AtomGains>& gains, double least,
                                        std::size_t most) {
  std::vector<const AtomGains*> order;
  for (const AtomGains& gain : gains) {
    if (gain.trimmed > least && gain.against.empty()) order.push_back(&gain);
  }
  std::ranges::stable_sort(order, std::greater<>(),
                           [](const AtomGains* gain) { return gain->trimmed; });
  std::vector<Candidate> first;
  for (const AtomGains* gain : order) {
    const Candidate& c = *std::ranges::find(candidates, gain->atom, &Candidate::key);
    const auto test = std::ranges::find(tests, gain->atom, &ScoreTest::atom);
    if (c.one_sided && test->amplitude <= 0) continue;
    const bool there = std::ranges::any_of(first, [&](const Candidate& other) {
      return other.effect == c.effect && other.setting * c.setting >= 0 &&
             (other.effect != "obstacle" || other.setting == c.setting);
    });
    if (!there && first.size() < most) first.push_back(c);
  }
  return first;
}

std::vector<Contender> refit(const BaseFit& base, const std::vector<Candidate>& first,
                             const std::vector<Candidate>& candidates,
                             const std::vector<ScoreTest>& tests,
                             const std::vector<std::string>& folds, ReferenceForward& model,
                             const ProgressOf& progress) {
  std::vector<Contender> contenders;
  const std::vector<double> before = costs_of(base);
  double most = 0, most_gained = 0;
  for (const Candidate& candidate : first) {
    // Columns foretell z^2 / 2 nats; what would not lead with twice of it is not simulated.
    const double z = std::ranges::find(tests, candidate.key, &ScoreTest::atom)->z;
    if (z * z < most) continue;
    if (progress)
      progress(0.7 + 0.15 * static_cast<double>(&candidate - first.data()) /
                         static_cast<double>(first.size()),
               "refit with " + candidate.effect);
    std::optional<EntrantFit> fit = fit_entrant(
        base, candidate, candidates, place_of(candidate, candidates, tests), most_gained, model);
    if (!fit) continue;
    most_gained = std::max(most_gained, fit->gained);
    Contender made{std::move(*fit), {}, {}, 0};
    const std::vector<double> after = costs_of(made.fit.fit);
    for (std::size_t k = 0; k < folds.size(); ++k) {
      const auto found = std::ranges::find(made.fold_names, folds[k]);
      const auto fold = static_cast<std::size_t>(found - made.fold_names.begin());
      if (found == made.fold_names.end()) {
        made.fold_names.push_back(folds[k]);
        made.folds.push_back(0);
      }
      made.folds[fold] += (before[k] - after[k]) / kDispersion;
    }
    made.gain = trimmed_sum(made.folds);
    most = std::max(most, made.gain);
    contenders.push_back(std::move(made));
  }
  return contenders;
}

void sort_by_agreed(std::vector<Contender>& contenders) {
  // By index: the buffer of std::stable_sort (GCC 12) is not aligned as states of Eigen must be.
  std::vector<std::size_t> order(contenders.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, std::greater<>(),
                           [&](std::size_t k) { return contenders[k].agreed; });
  std::vector<Contender> sorted;
  for (const std::size_t k : order) sorted.push_back(std::move(contenders[k]));
  contenders = std::move(sorted);
}

}  // namespace omentum
