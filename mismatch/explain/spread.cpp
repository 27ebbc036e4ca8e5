#include "mismatch/explain/spread.h"

#include <algorithm>
#include <cmath>
#include <set>

namespace omentum {

Result<Spread> spread_of(std::span<const std::string> keys, std::span<const Evidence> recordings,
                         std::span<const std::string> folds) {
  std::vector<Evidence> parts;
  for (const Evidence& recording : recordings) {
    auto part = integrate_own(recording);
    if (!part) return Failure{part.error()};
    parts.push_back(std::move(part).value());
  }
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
  const auto all = solve_without("");
  if (!all) return Failure{all.error()};
  std::vector<Eigen::Index> places;
  for (const std::string& key : keys) {
    const auto found = std::ranges::find(all.value().numbers, key, &Number::key);
    if (found == all.value().numbers.end()) return Failure{"no number is called " + key};
    places.push_back(found - all.value().numbers.begin());
  }
  const Eigen::VectorXd mean = all.value().mean(places);
  const Eigen::MatrixXd posterior = all.value().covariance(places, places);
  Eigen::MatrixXd jackknife = Eigen::MatrixXd::Zero(posterior.rows(), posterior.cols());
  const std::set<std::string> names(folds.begin(), folds.end());
  constexpr std::size_t kLeastFolds = 3;
  if (names.size() >= kLeastFolds) {
    const auto count = static_cast<Eigen::Index>(names.size());
    Eigen::MatrixXd without(mean.size(), count);
    Eigen::Index column = 0;
    for (const std::string& name : names) {
      const auto left = solve_without(name);
      if (!left) return Failure{left.error()};
      without.col(column++) = left.value().mean(places);
    }
    without.colwise() -= without.rowwise().mean().eval();
    jackknife =
        static_cast<double>(count - 1) / static_cast<double>(count) * without * without.transpose();
  }
  Spread spread;
  const Eigen::VectorXd variance = posterior.diagonal() + mean.cwiseAbs2() + jackknife.diagonal();
  for (const double v : variance) spread.sd.push_back(std::sqrt(v));
  const double ratio = posterior.ldlt().solve(jackknife).trace() / static_cast<double>(keys.size());
  spread.dispersion = std::max(1.0, ratio);
  return spread;
}

}  // namespace omentum
