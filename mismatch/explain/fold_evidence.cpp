#include "mismatch/explain/fold_evidence.h"

#include <fmt/core.h>

#include <algorithm>

#include "mismatch/evidence/positive_definite.h"

namespace omentum {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

/// Projection subtracts numbers as large as the information itself; below this share the rest is
/// rounding.
constexpr double kLeastShare = 1e-11;

/// Fitted numbers first, then atoms; numbers of sum_evidence() are in the order of their keys.
std::vector<Index> fitted_first(const std::vector<Number>& numbers) {
  std::vector<Index> order;
  for (const bool atoms : {false, true}) {
    for (std::size_t k = 0; k < numbers.size(); ++k) {
      if ((numbers[k].role == NumberRole::kAtom) == atoms) order.push_back(static_cast<Index>(k));
    }
  }
  return order;
}

/// Sets all but the folds.
void arrange(FoldEvidence& evidence) {
  const auto size = static_cast<Index>(evidence.numbers.size());
  evidence.fitted = 0;
  evidence.precision = VectorXd::Zero(size);
  evidence.mean = VectorXd::Zero(size);
  for (Index k = 0; k < size; ++k) {
    const Number& number = evidence.numbers[static_cast<std::size_t>(k)];
    if (number.role != NumberRole::kAtom) ++evidence.fitted;
    evidence.precision[k] = number.precision();
    evidence.mean[k] = number.mean;
  }
  evidence.A = MatrixXd::Zero(size, size);
  evidence.b = VectorXd::Zero(size);
  for (const Fold& fold : evidence.folds) {
    evidence.A += fold.A;
    evidence.b += fold.b;
  }
}

}  // namespace

Result<FoldEvidence> make_folds(std::span<const Evidence> recordings,
                                std::span<const std::string> fold_of) {
  if (recordings.empty()) return Failure{"no recording has evidence"};
  OMENTUM_CHECK(fold_of.empty() || fold_of.size() == recordings.size());
  std::vector<Evidence> parts;
  for (const Evidence& recording : recordings) {
    if (auto checked = check_evidence(recording); !checked) return Failure{checked.error()};
    auto part = integrate_own(recording);
    if (!part) return Failure{part.error()};
    parts.push_back(std::move(part).value());
  }
  // One list of numbers for all: that of their sum.
  auto total = sum_evidence(parts);
  if (!total) return Failure{total.error()};
  const std::vector<Index> order = fitted_first(total.value().numbers);
  FoldEvidence evidence;
  for (const Index k : order) {
    evidence.numbers.push_back(total.value().numbers[static_cast<std::size_t>(k)]);
  }
  Evidence empty;
  empty.numbers = total.value().numbers;
  empty.A = MatrixXd::Zero(total.value().A.rows(), total.value().A.cols());
  empty.b = VectorXd::Zero(total.value().b.size());
  for (std::size_t r = 0; r < parts.size(); ++r) {
    const std::string& name = fold_of.empty() ? parts[r].name : fold_of[r];
    const auto same = [&](const Fold& fold) { return !fold_of.empty() && fold.name == name; };
    auto fold = std::find_if(evidence.folds.begin(), evidence.folds.end(), same);
    const Evidence part = add_evidence(empty, parts[r]).value();
    if (fold == evidence.folds.end()) {
      evidence.folds.push_back({name, part.A(order, order), part.b(order)});
    } else {
      fold->A += part.A(order, order);
      fold->b += part.b(order);
    }
  }
  arrange(evidence);
  return evidence;
}

std::vector<Evidence> with_in_base(std::span<const Evidence> recordings,
                                   std::span<const std::string> atoms) {
  std::vector<Evidence> changed(recordings.begin(), recordings.end());
  for (Evidence& recording : changed) {
    for (Number& number : recording.numbers) {
      if (number.role == NumberRole::kAtom &&
          std::find(atoms.begin(), atoms.end(), number.key) != atoms.end()) {
        number.role = NumberRole::kBase;
      }
    }
  }
  return changed;
}

Result<FoldEvidence> with_in_base(const FoldEvidence& evidence,
                                  std::span<const std::string> atoms) {
  FoldEvidence changed = evidence;
  for (const std::string& atom : atoms) {
    const auto number =
        std::find_if(changed.numbers.begin(), changed.numbers.end(),
                     [&](const Number& x) { return x.role == NumberRole::kAtom && x.key == atom; });
    if (number == changed.numbers.end()) return Failure{fmt::format("no atom is called {}", atom)};
    number->role = NumberRole::kBase;
  }
  const std::vector<Index> order = fitted_first(changed.numbers);
  const std::vector<Number> numbers = changed.numbers;
  for (std::size_t k = 0; k < order.size(); ++k) {
    changed.numbers[k] = numbers[static_cast<std::size_t>(order[k])];
  }
  for (Fold& fold : changed.folds) {
    fold.A = MatrixXd(fold.A(order, order));
    fold.b = VectorXd(fold.b(order));
  }
  arrange(changed);
  return changed;
}

Result<ProjectedAtoms> project_atoms(const FoldEvidence& evidence, const MatrixXd& A,
                                     const VectorXd& b) {
  const Index n = evidence.fitted, atoms = evidence.atoms();
  MatrixXd H = A.topLeftCorner(n, n);
  H.diagonal() += evidence.precision.head(n);
  const VectorXd g = b.head(n) + evidence.precision.head(n).cwiseProduct(evidence.mean.head(n));
  std::vector<std::string> names;
  for (Index k = 0; k < n; ++k)
    names.push_back(evidence.numbers[static_cast<std::size_t>(k)].name());
  auto factor = factorise(H, names);
  if (!factor) return Failure{factor.error()};
  const auto L = factor.value().matrixL();
  const MatrixXd cross = L.solve(MatrixXd(A.topRightCorner(n, atoms)));
  ProjectedAtoms projected;
  projected.information = A.bottomRightCorner(atoms, atoms);
  projected.information.noalias() -= cross.transpose() * cross;
  projected.score = b.tail(atoms) - cross.transpose() * L.solve(g);
  for (Index k = 0; k < atoms; ++k) {
    if (projected.information(k, k) > kLeastShare * A(n + k, n + k)) continue;
    projected.information.row(k).setZero();
    projected.information.col(k).setZero();
    projected.score[k] = 0;
  }
  return projected;
}

Result<ProjectedAtoms> project_atoms(const FoldEvidence& evidence) {
  return project_atoms(evidence, evidence.A, evidence.b);
}

Result<ProjectedAtoms> project_atoms_without(const FoldEvidence& evidence,
                                             std::span<const std::size_t> folds) {
  MatrixXd A = evidence.A;
  VectorXd b = evidence.b;
  std::string names;
  for (const std::size_t r : folds) {
    A -= evidence.folds[r].A;
    b -= evidence.folds[r].b;
    names += (names.empty() ? "" : ", ") + evidence.folds[r].name;
  }
  auto projected = project_atoms(evidence, A, b);
  if (!projected) return Failure{fmt::format("without {}: {}", names, projected.error())};
  return projected;
}

}  // namespace omentum
