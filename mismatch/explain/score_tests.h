#pragma once

#include <Eigen/Core>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "mismatch/explain/fold_evidence.h"

namespace omentum {

/// One atom is tested with everything fitted projected out (docs/mismatch.md 5.1). The test ranks
/// and draws maps; it decides nothing.
struct ScoreTest {
  std::string atom;
  bool testable = false;  ///< false: the data know nothing of it beside what is fitted
  double z = 0;           ///< score over its sd
  double amplitude = 0;   ///< [unit of the atom]
  double sd = 0;          ///< of the amplitude; infinite where it is not testable
  /// This is d' of an amplitude that is present [1].
  double detectability(double present) const { return present / sd; }
};

/// There is one for each atom, in the order of `evidence`.
Result<std::vector<ScoreTest>> score_tests(const FoldEvidence& evidence);

/// They say how alike atoms look beside what is fitted, [atoms x atoms]; it is 0 beside an atom
/// that is not testable.
Result<Eigen::MatrixXd> cosines(const FoldEvidence& evidence);

/// Amplitude by which two correct models of the same thing differ.
struct Floor {
  double amplitude = 0;  ///< [unit of the atom]
  std::string numerics;  ///< key of the column that makes it
};
using Floors = std::map<std::string, Floor>;  ///< by key of the atom

/// Each numerics column is left out of the fit in turn and set to its floor_step in every recording
/// that has it; the floor is `factor` times the largest amplitude that the score tests then find
/// (docs/mismatch.md 5.2). Every atom has one; it is 0 where no column moves it. It fails where a
/// column has neither a step nor a prior.
Result<Floors> amplitude_floors(std::span<const Evidence> recordings, double factor);

}  // namespace omentum
