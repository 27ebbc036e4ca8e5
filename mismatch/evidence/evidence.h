#pragma once

#include <Eigen/Core>
#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"

namespace omentum {

/// What a number of a fit is there for (docs/mismatch.md 5).
enum class NumberRole {
  kBase,      ///< of the believed scene, found in every fit
  kNuisance,  ///< no physics of interest: registration, clocks, the place of a pinch
  kNumerics,  ///< what two correct models may differ in: mesh, law, contact
  kAtom,      ///< of an effect at one place, held at zero: its score is wanted
};

/// One number of a fit. Values are changes from the linearisation point, in `unit`.
struct Number {
  std::string key;    ///< one name for one number, e.g. "stiffness" or "inclusion.k@12"
  std::string owner;  ///< recording that it belongs to alone; empty: all recordings share it
  NumberRole role = NumberRole::kBase;
  double mean = 0;                                      ///< of the prior, a normal distribution
  double sd = std::numeric_limits<double>::infinity();  ///< of the prior; infinite: free
  std::string unit;
  double floor_step = 0;    ///< of numerics: how far floors move it; 0: by its sd
  std::string effect = {};  ///< of an atom: its effect; atoms of one effect are no rivals
  double precision() const;
  /// A person reads the key, and the owner where there is one.
  std::string name() const;
};

/// What one recording, or several, say of numbers: normal equations of whitened rows about a
/// linearisation point. log p(rows | x) = log_constant + b' x - x' A x / 2. Priors are kept beside
/// it and not in it, so that evidence added twice is evidence of twice the data.
struct Evidence {
  std::string name;             ///< of the recording, for messages
  std::vector<Number> numbers;  ///< [n], each once
  Eigen::MatrixXd A;            ///< [n x n], information of the rows, J' W J
  Eigen::VectorXd b;            ///< [n], score of the rows at the linearisation point, J' W r
  double log_constant = 0;      ///< log density of the rows at the linearisation point
};

/// It fails where sizes disagree, a value is not finite, a number stands twice, a prior has no
/// positive sd, an atom belongs to one recording alone, or A has a negative diagonal or is not
/// symmetric.
Result<void> check_evidence(const Evidence& evidence);

/// Both add up. Numbers are matched by key and owner and ordered by them, so that the order of
/// what is added does not matter; a number that one of them does not know counts nothing there.
/// It fails where they disagree about role or prior of a number.
Result<Evidence> add_evidence(const Evidence& one, const Evidence& other);
Result<Evidence> sum_evidence(std::span<const Evidence> parts);

/// Numbers of which `gone` is true are integrated over their priors (a Schur complement). A free
/// number has density 1. It fails where data and prior do not determine them.
Result<Evidence> integrate(const Evidence& evidence,
                           const std::function<bool(const Number&)>& gone);
/// This integrates the numbers that belong to one recording alone.
Result<Evidence> integrate_own(const Evidence& evidence);

/// Normal distribution of numbers after rows and priors.
struct Posterior {
  std::vector<Number> numbers;
  Eigen::VectorXd mean;
  Eigen::MatrixXd covariance;
  double log_evidence = 0;  ///< log density of the rows, integrated over these numbers
  /// How far the mean is from the prior's in the prior's sd; it is 0 for free numbers.
  double pull(std::size_t k) const;
};

/// All numbers but atoms are fitted at once; atoms stay at zero.
Result<Posterior> solve(const Evidence& evidence);

}  // namespace omentum
