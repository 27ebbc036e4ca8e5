#include "mismatch/evidence/evidence.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <tuple>

#include "mismatch/evidence/positive_definite.h"

namespace omentum {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

auto place_of(const Number& number) { return std::tie(number.key, number.owner); }

bool same_number(const Number& one, const Number& other) {
  return one.role == other.role && one.mean == other.mean && one.sd == other.sd;
}

std::vector<std::string> names_of(const std::vector<Number>& numbers,
                                  const std::vector<Index>& which) {
  std::vector<std::string> names;
  for (const Index k : which) names.push_back(numbers[static_cast<std::size_t>(k)].name());
  return names;
}

/// Adds `part` to `sum`, whose numbers have those of `part` among them and are ordered.
void add_to(Evidence& sum, const Evidence& part) {
  std::vector<Index> at;
  for (const Number& number : part.numbers) {
    const auto found = std::lower_bound(
        sum.numbers.begin(), sum.numbers.end(), number,
        [](const Number& x, const Number& y) { return place_of(x) < place_of(y); });
    at.push_back(found - sum.numbers.begin());
  }
  sum.A(at, at) += part.A;
  sum.b(at) += part.b;
  sum.log_constant += part.log_constant;
}

}  // namespace

double Number::precision() const { return std::isinf(sd) ? 0 : 1 / (sd * sd); }

std::string Number::name() const { return owner.empty() ? key : key + " of " + owner; }

Result<void> check_evidence(const Evidence& evidence) {
  const auto size = static_cast<Index>(evidence.numbers.size());
  const auto fail = [&](const std::string& what) {
    return Result<void>(Failure{evidence.name + ": " + what});
  };
  if (evidence.A.rows() != size || evidence.A.cols() != size || evidence.b.size() != size) {
    return fail("normal equations have another size than the list of numbers");
  }
  if (!evidence.A.allFinite() || !evidence.b.allFinite() || !std::isfinite(evidence.log_constant)) {
    return fail("normal equations are not finite");
  }
  // Sums over rows are symmetric but for rounding.
  if (!evidence.A.isApprox(evidence.A.transpose(), 1e-9)) return fail("A is not symmetric");
  std::vector<Number> sorted = evidence.numbers;
  std::sort(sorted.begin(), sorted.end(),
            [](const Number& x, const Number& y) { return place_of(x) < place_of(y); });
  for (std::size_t k = 1; k < sorted.size(); ++k) {
    if (place_of(sorted[k - 1]) == place_of(sorted[k]))
      return fail(sorted[k].name() + " stands twice");
  }
  for (Index k = 0; k < size; ++k) {
    const Number& number = evidence.numbers[static_cast<std::size_t>(k)];
    if (!(number.sd > 0)) return fail(number.name() + " has no positive sd");
    if (!std::isfinite(number.mean)) return fail(number.name() + " has no finite mean");
    if (evidence.A(k, k) < 0) return fail(number.name() + " has negative information");
    if (number.role == NumberRole::kAtom && !number.owner.empty()) {
      return fail(number.name() + " is an atom of one recording alone");
    }
  }
  return {};
}

Result<Evidence> add_evidence(const Evidence& one, const Evidence& other) {
  const Evidence parts[] = {one, other};
  return sum_evidence(parts);
}

Result<Evidence> sum_evidence(std::span<const Evidence> parts) {
  Evidence sum;
  std::map<std::pair<std::string, std::string>, Number> numbers;
  for (const Evidence& part : parts) {
    if (auto checked = check_evidence(part); !checked) return Failure{checked.error()};
    sum.name += (sum.name.empty() ? "" : ", ") + part.name;
    for (const Number& number : part.numbers) {
      const auto [known, added] = numbers.try_emplace({number.key, number.owner}, number);
      if (!added && !same_number(known->second, number)) {
        return Failure{part.name + ": " + number.name() + " has another role or prior elsewhere"};
      }
    }
  }
  for (auto& [place, number] : numbers) sum.numbers.push_back(std::move(number));
  const auto size = static_cast<Index>(sum.numbers.size());
  sum.A = MatrixXd::Zero(size, size);
  sum.b = VectorXd::Zero(size);
  for (const Evidence& part : parts) add_to(sum, part);
  return sum;
}

Result<Evidence> integrate(const Evidence& evidence,
                           const std::function<bool(const Number&)>& gone) {
  std::vector<Index> out, kept;
  Evidence rest;
  rest.name = evidence.name;
  for (std::size_t k = 0; k < evidence.numbers.size(); ++k) {
    const bool leaves = gone(evidence.numbers[k]);
    (leaves ? out : kept).push_back(static_cast<Index>(k));
    if (!leaves) rest.numbers.push_back(evidence.numbers[k]);
  }
  MatrixXd H = evidence.A(out, out);
  VectorXd g = evidence.b(out);
  rest.log_constant = evidence.log_constant;
  for (std::size_t k = 0; k < out.size(); ++k) {
    const Number& number = evidence.numbers[static_cast<std::size_t>(out[k])];
    const double precision = number.precision();
    const auto at = static_cast<Index>(k);
    H(at, at) += precision;
    g[at] += precision * number.mean;
    rest.log_constant += precision > 0
                             ? (std::log(precision) - precision * number.mean * number.mean) / 2
                             : std::log(2 * std::numbers::pi) / 2;
  }
  auto factor = factorise(H, names_of(evidence.numbers, out));
  if (!factor) return Failure{evidence.name + ": " + factor.error()};
  // With H = L L': A - (L^-1 C)' (L^-1 C), which is symmetric to the bit.
  const auto L = factor.value().matrixL();
  const MatrixXd cross = L.solve(MatrixXd(evidence.A(out, kept)));
  const VectorXd half = L.solve(g);
  rest.A = evidence.A(kept, kept);
  rest.A.noalias() -= cross.transpose() * cross;
  rest.b = evidence.b(kept) - cross.transpose() * half;
  rest.log_constant += (half.squaredNorm() - log_determinant(factor.value())) / 2;
  return rest;
}

Result<Evidence> integrate_own(const Evidence& evidence) {
  return integrate(evidence, [](const Number& number) { return !number.owner.empty(); });
}

double Posterior::pull(std::size_t k) const {
  if (std::isinf(numbers[k].sd)) return 0;
  return (mean[static_cast<Index>(k)] - numbers[k].mean) / numbers[k].sd;
}

Result<Posterior> solve(const Evidence& evidence) {
  const auto fitted = [](const Number& number) { return number.role != NumberRole::kAtom; };
  auto integrated = integrate(evidence, fitted);
  if (!integrated) return Failure{integrated.error()};
  Posterior posterior;
  posterior.log_evidence = integrated.value().log_constant;
  std::vector<Index> at;
  for (std::size_t k = 0; k < evidence.numbers.size(); ++k) {
    if (!fitted(evidence.numbers[k])) continue;
    at.push_back(static_cast<Index>(k));
    posterior.numbers.push_back(evidence.numbers[k]);
  }
  MatrixXd H = evidence.A(at, at);
  VectorXd g = evidence.b(at);
  for (Index k = 0; k < H.rows(); ++k) {
    const Number& number = posterior.numbers[static_cast<std::size_t>(k)];
    H(k, k) += number.precision();
    g[k] += number.precision() * number.mean;
  }
  const CholeskyFactor factor(H);
  posterior.mean = factor.solve(g);
  posterior.covariance = factor.solve(MatrixXd::Identity(H.rows(), H.rows()));
  return posterior;
}

}  // namespace omentum
