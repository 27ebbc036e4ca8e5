#include "mismatch/explain/spread.h"

#include <algorithm>
#include <cmath>
#include <set>

namespace omentum {

Result<std::vector<double>> spread_of(std::span<const std::string> keys,
                                      std::span<const Evidence> recordings,
                                      std::span<const std::string> folds) {
  std::vector<Evidence> parts;
  for (const Evidence& recording : recordings) {
    auto part = integrate_own(recording);
    if (!part) return Failure{part.error()};
    parts.push_back(std::move(part).value());
  }
  const std::set<std::string> names(folds.begin(), folds.end());
  // Of all folds, or without one of them.
  const auto solve_without = [&](const std::string& fold) -> Result<Posterior> {
    std::vector<Evidence> kept;
    for (std::size_t r = 0; r < parts.size(); ++r) {
      if (folds[r] != fold) kept.push_back(parts[r]);
    }
    auto sum = sum_evidence(kept);
    if (!sum) return Failure{sum.error()};
    return solve(sum.value());
  };
  const auto mean_of = [](const Posterior& posterior, const std::string& key) {
    const auto found = std::ranges::find(posterior.numbers, key, &Number::key);
    return posterior.mean[found - posterior.numbers.begin()];
  };
  const auto all = solve_without("");
  if (!all) return Failure{all.error()};
  std::vector<Posterior> without;
  constexpr std::size_t kLeastFolds = 3;
  if (names.size() >= kLeastFolds) {
    for (const std::string& name : names) {
      auto left = solve_without(name);
      if (!left) return Failure{left.error()};
      without.push_back(std::move(left).value());
    }
  }
  std::vector<double> spread;
  for (const std::string& key : keys) {
    const auto at =
        std::ranges::find(all.value().numbers, key, &Number::key) - all.value().numbers.begin();
    if (at == static_cast<std::ptrdiff_t>(all.value().numbers.size()))
      return Failure{"no number is called " + key};
    const double mean = all.value().mean[at];
    double variance = all.value().covariance(at, at) + mean * mean;
    const auto count = static_cast<double>(without.size());
    double centre = 0, squares = 0;
    for (const Posterior& left : without) centre += mean_of(left, key) / count;
    for (const Posterior& left : without)
      squares += (mean_of(left, key) - centre) * (mean_of(left, key) - centre);
    if (count > 0) variance += (count - 1) / count * squares;
    spread.push_back(std::sqrt(variance));
  }
  return spread;
}

}  // namespace omentum
