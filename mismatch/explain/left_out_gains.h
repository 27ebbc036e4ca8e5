#pragma once

#include <span>
#include <string>
#include <vector>

#include "mismatch/explain/fold_evidence.h"
#include "mismatch/explain/score_tests.h"

namespace omentum {

/// What decides (docs/mismatch.md 5.3, 5.4): measured on simulations of other engines.
struct Thresholds {
  double gain = 50;     ///< G* [nats]: a claim out of nothing
  double reject = 8;    ///< [nats]: what an adequate effect may leave to another
  double foretold = 4;  ///< [nats]: from here on an effect acts in a recording
  double pull = 5;      ///< [sd]: of a nuisance, what an adequate effect may leave
  /// Gains are divided by the dispersion of their amplitude.
  bool by_dispersion = false;
};

/// Fewest folds of which the largest and the smallest gain are trimmed.
inline constexpr std::size_t kLeastTrimmed = 5;

/// What an atom adds to a fold that was left out of the fit.
struct FoldGain {
  std::string fold;
  double gain = 0;       ///< G_kr [nats]
  double foretold = 0;   ///< the gain to be expected of the others' fit [nats]
  double amplitude = 0;  ///< of the others' fit [unit of the atom]
  /// Log density of the fold with the amplitude free, against amplitude zero [nats]: no floor.
  double against_zero = 0;
};

struct AtomGains {
  std::string atom;
  double floor = 0;  ///< a0 [unit of the atom]
  std::vector<FoldGain> folds;
  /// The amplitude scatters over folds so many times as much as its information says, in variance,
  /// at least 1: by leaving out one fold each (jackknife).
  double dispersion = 1;
  double trimmed = 0;        ///< S_k [nats]
  double agreed = 0;         ///< the same, by `dispersion` where thresholds say so
  double total = 0;          ///< sum over all folds
  double without_worst = 0;  ///< sum without the smallest
  double median = 0;         ///< of a fold
  bool claimed = false;
  bool in_sample = false;  ///< one fold alone, tested by its own fit: never confirmed
  std::string against;     ///< fold that forbids the claim of 2 - 4; empty: none
};

/// Five or more are summed without the largest and the smallest, fewer all of them.
double trimmed_sum(std::vector<double> gains);

/// Each fold is left out by a downdate of the normal equations. With one fold the gain is
/// in-sample: the likelihood of the amplitude found against that of the nearest in the floor.
/// Floors of atoms that `floors` does not have are zero. It fails where the other folds leave a
/// number open.
Result<std::vector<AtomGains>> left_out_gains(const FoldEvidence& evidence, const Floors& floors,
                                              const Thresholds& thresholds = {});

struct FoldDensity {
  std::string fold;
  double log_density = 0;  ///< of its rows [nats]
};

/// Density of each fold as the others foretell it, all numbers but atoms integrated; folds in the
/// order of their first recordings. Of one fold alone priors foretell it. It fails where the other
/// folds leave a number open.
Result<std::vector<FoldDensity>> foretold_densities(std::span<const Evidence> recordings,
                                                    std::span<const std::string> fold_of);

/// Folds that no fit has seen gain by a fit to all others: `held_out` are their indices in
/// `evidence`, which holds both. There is one list per atom, in their order.
Result<std::vector<std::vector<FoldGain>>> held_out_gains(const FoldEvidence& evidence,
                                                          std::span<const std::size_t> held_out,
                                                          const Floors& floors);

}  // namespace omentum
