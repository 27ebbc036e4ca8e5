#include "mismatch/explain/pulls.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <tuple>

#include "mismatch/explain/left_out_gains.h"

namespace omentum {

using Eigen::Index;

namespace {

void add_pulls(const Posterior& posterior, std::vector<Pull>& found) {
  for (std::size_t k = 0; k < posterior.numbers.size(); ++k) {
    const Number& number = posterior.numbers[k];
    if (number.role == NumberRole::kBase || std::isinf(number.sd)) continue;
    found.push_back({number.key, number.owner, number.role, posterior.mean[static_cast<Index>(k)],
                     posterior.pull(k)});
  }
}

/// A recording's own numbers beside shared ones that are held at the fit to all recordings.
Evidence own_part(const Evidence& recording, const std::map<std::string, double>& shared) {
  Evidence part;
  part.name = recording.name;
  std::vector<Index> own;
  Eigen::VectorXd held = Eigen::VectorXd::Zero(recording.b.size());
  for (std::size_t k = 0; k < recording.numbers.size(); ++k) {
    const Number& number = recording.numbers[k];
    if (number.owner.empty()) {
      const auto value = shared.find(number.key);
      if (value != shared.end()) held[static_cast<Index>(k)] = value->second;
    } else {
      own.push_back(static_cast<Index>(k));
      part.numbers.push_back(number);
    }
  }
  const Eigen::VectorXd rest = recording.b - recording.A * held;
  part.A = recording.A(own, own);
  part.b = rest(own);
  return part;
}

}  // namespace

std::optional<Pull> repeated_pull(std::span<const Pull> pulls,
                                  const std::map<std::string, std::string>& folds) {
  std::set<std::string> names;
  for (const auto& [recording, fold] : folds) names.insert(fold);
  const bool enough = names.size() >= kLeastTrimmed;
  std::map<std::string, std::string> first;  // fold, by number
  for (const Pull& pull : pulls) {
    if (!enough || pull.owner.empty()) return pull;
    const std::string& fold = folds.at(pull.owner);
    if (first.try_emplace(pull.key, fold).first->second != fold) return pull;
  }
  return std::nullopt;
}

Result<std::vector<Pull>> pulls(std::span<const Evidence> recordings) {
  std::vector<Evidence> integrated;
  for (const Evidence& recording : recordings) {
    auto part = integrate_own(recording);
    if (!part) return Failure{part.error()};
    integrated.push_back(std::move(part).value());
  }
  auto sum = sum_evidence(integrated);
  if (!sum) return Failure{sum.error()};
  auto posterior = solve(sum.value());
  if (!posterior) return Failure{posterior.error()};
  std::vector<Pull> found;
  add_pulls(posterior.value(), found);
  std::map<std::string, double> shared;
  for (std::size_t k = 0; k < posterior.value().numbers.size(); ++k) {
    shared[posterior.value().numbers[k].key] = posterior.value().mean[static_cast<Index>(k)];
  }
  for (const Evidence& recording : recordings) {
    auto own = solve(own_part(recording, shared));
    if (!own) return Failure{own.error()};
    add_pulls(own.value(), found);
  }
  std::sort(found.begin(), found.end(), [](const Pull& x, const Pull& y) {
    const double one = std::fabs(x.pull), other = std::fabs(y.pull);
    return one != other ? one > other : std::tie(x.key, x.owner) < std::tie(y.key, y.owner);
  });
  return found;
}

}  // namespace omentum
