#pragma once

#include <span>
#include <string>

#include "mismatch/evidence/evidence.h"

namespace omentum {

/// Two correct models differ by more than white noise and a smooth difference, in each recording
/// otherwise, and many points make a fit sure of it: what recordings say is worth so many times
/// less [Miller19]. Stated, by what those of other engines scatter where nothing was left out
/// (docs/decisions/0046-dispersion.md), never by what a fit leaves, where an effect hides itself.
inline constexpr double kDispersion = 6;

/// What rows say is worth so much less.
void disperse(double dispersion, std::span<Evidence> recordings);

/// How much more folds disagree about effects than their information says, the ratio of variances,
/// at least 1, at most 100. Of every atom the amplitudes found without one fold each scatter
/// (jackknife); the answer is the smallest factor by which all information can be divided so that
/// half of the atoms scatter no more than they should. `fold_of` as in make_folds(); below five
/// folds the answer is 1. It fails where the evidence leaves a number open.
Result<double> learned_dispersion(std::span<const Evidence> recordings,
                                  std::span<const std::string> fold_of);

}  // namespace omentum
