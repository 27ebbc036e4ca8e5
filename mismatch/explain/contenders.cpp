#include "mismatch/explain/contenders.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>
#include <tuple>

#include "mismatch/explain/left_out_gains.h"

namespace omentum {
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
  std::ranges::stable_sort(order, std::greater<>(), [](const AtomGains* gain) {
    return gain->trimmed / std::sqrt(gain->dispersion);
  });
  std::vector<Candidate> first;
  std::set<std::tuple<std::string, double, bool>> there;
  for (const AtomGains* gain : order) {
    const Candidate& c = *std::ranges::find(candidates, gain->atom, &Candidate::key);
    const bool more = std::ranges::find(tests, gain->atom, &ScoreTest::atom)->amplitude > 0;
    const double setting = c.effect == "obstacle" ? c.setting : 0;
    if (first.size() < most && there.emplace(c.effect, setting, more).second) first.push_back(c);
  }
  return first;
}

void sort_by_gain(std::vector<Contender>& contenders) {
  // By index: the buffer of std::stable_sort (GCC 12) is not aligned as states of Eigen must be.
  std::vector<std::size_t> order(contenders.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, std::greater<>(),
                           [&](std::size_t k) { return contenders[k].gain; });
  std::vector<Contender> sorted;
  for (const std::size_t k : order) sorted.push_back(std::move(contenders[k]));
  contenders = std::move(sorted);
}

}  // namespace omentum
