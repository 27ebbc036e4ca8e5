#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "mismatch/evidence/evidence.h"

namespace omentum {

/// A recording and its repeats: what is left out together (docs/mismatch.md 5.3).
struct Fold {
  std::string name;
  Eigen::MatrixXd A;  ///< [n x n], own numbers of each recording integrated
  Eigen::VectorXd b;  ///< [n]
};

/// The evidence of a case stands by folds, on the numbers that recordings share.
struct FoldEvidence {
  std::vector<Number> numbers;  ///< [n]: first what is fitted, then atoms, each by key
  int fitted = 0;               ///< base, nuisances, numerics
  Eigen::VectorXd precision;    ///< [n], of the priors
  Eigen::VectorXd mean;         ///< [n], of the priors
  std::vector<Fold> folds;
  Eigen::MatrixXd A;  ///< sum over the folds
  Eigen::VectorXd b;

  int atoms() const { return static_cast<int>(numbers.size()) - fitted; }
  const Number& atom(int k) const { return numbers[static_cast<std::size_t>(fitted + k)]; }
};

/// Recordings with one name in `fold_of` [recordings] are one fold; where it is empty each is its
/// own. Folds come in the order of the recordings. It fails where recordings contradict each other
/// (sum_evidence) or an own number is open.
Result<FoldEvidence> make_folds(std::span<const Evidence> recordings,
                                std::span<const std::string> fold_of = {});

/// The named atoms go into the base, where they are fitted with their priors. It fails on an
/// unknown name.
Result<FoldEvidence> with_in_base(const FoldEvidence& evidence, std::span<const std::string> atoms);
/// In recordings the named atoms go into the base; what is no atom of theirs stays as it is.
std::vector<Evidence> with_in_base(std::span<const Evidence> recordings,
                                   std::span<const std::string> atoms);

/// What is left of atoms when all that is fitted has been projected out: s and S of
/// docs/mismatch.md 5.1, at amplitude zero.
struct ProjectedAtoms {
  Eigen::VectorXd score;        ///< [atoms]
  Eigen::MatrixXd information;  ///< [atoms x atoms]
};

/// `A` and `b` are sums over some folds of `evidence`. An atom of which less than 1e-11 of its
/// information is left has none, nor a score. It fails where what is fitted is left open.
Result<ProjectedAtoms> project_atoms(const FoldEvidence& evidence, const Eigen::MatrixXd& A,
                                     const Eigen::VectorXd& b);
/// This takes all folds.
Result<ProjectedAtoms> project_atoms(const FoldEvidence& evidence);
/// This takes all folds but those named by index, by a downdate of the sums.
Result<ProjectedAtoms> project_atoms_without(const FoldEvidence& evidence,
                                             std::span<const std::size_t> folds);

}  // namespace omentum
