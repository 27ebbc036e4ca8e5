#pragma once

#include <string>
#include <vector>

#include "mismatch/explain/left_out_gains.h"

namespace omentum {

/// How large an effect must be to be claimed and named in this data (docs/mismatch.md 5.5).
struct DetectionLimit {
  std::string atom;
  bool testable = false;  ///< false: amplitudes are infinite
  Floor floor;
  double detected = 0;     ///< claimed with 84 % power [unit of the atom]
  double named = 0;        ///< also claimed beside the most alike atom of another effect
  std::string look_alike;  ///< that one; empty: there is no other effect
  double cosine = 0;       ///< of both, its size
};

/// There is one for each atom, in the order of `evidence`. With five or more folds the sd is that
/// without the folds whose own evidence knows most and least of the atom. Amplitudes scatter by so
/// many times the variance that is stated (`dispersion`, at least 1).
Result<std::vector<DetectionLimit>> detection_limits(const FoldEvidence& evidence,
                                                     const Floors& floors,
                                                     const Thresholds& thresholds = {},
                                                     double dispersion = 1);

}  // namespace omentum
