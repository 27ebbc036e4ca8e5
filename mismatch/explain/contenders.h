#pragma once

#include <string>
#include <vector>

#include "mismatch/explain/entrant.h"
#include "mismatch/explain/score_tests.h"

namespace omentum {

/// An effect that was simulated and refitted.
struct Contender {
  EntrantFit fit;
  std::vector<std::string> fold_names;
  /// Log density that it adds to each fold, simulated, by kDispersion [nats].
  std::vector<double> folds;
  double gain = 0;    ///< their trimmed sum
  double agreed = 0;  ///< the same by how far folds disagree about its numbers (Spread)
};

/// What `one` adds beyond `other`, trimmed [nats].
double lead(const Contender& one, const Contender& other);

/// Candidates to be simulated, those whose trimmed gain by columns exceeds `least`: of every
/// effect, and of every amplitude that was simulated, the one of the largest gain, most of all
/// first.
std::vector<Candidate> first_candidates(const std::vector<Candidate>& candidates,
                                        const std::vector<ScoreTest>& tests,
                                        const std::vector<AtomGains>& gains, double least,
                                        std::size_t most);

/// Refits one after the other; those that fit better than the base, in their order. `folds` are
/// those of the recordings that were fitted, in their order.
std::vector<Contender> refit(const BaseFit& base, const std::vector<Candidate>& first,
                             const std::vector<Candidate>& candidates,
                             const std::vector<ScoreTest>& tests,
                             const std::vector<std::string>& folds, ReferenceForward& model,
                             const ProgressOf& progress);

/// The largest of what counts first.
void sort_by_agreed(std::vector<Contender>& contenders);

}  // namespace omentum
