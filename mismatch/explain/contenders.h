#pragma once

#include <string>
#include <vector>

#include "mismatch/explain/entrant.h"
#include "mismatch/explain/score_tests.h"

namespace omentum {

/// An effect that columns claim, simulated and refitted.
struct Contender {
  EntrantFit fit;
  std::vector<std::string> fold_names;
  /// Log density that it adds to each fold, simulated, by kDispersion [nats].
  std::vector<double> folds;
  double gain = 0;  ///< their trimmed sum
};

/// What `one` adds beyond `other`, trimmed [nats].
double lead(const Contender& one, const Contender& other);

/// Candidates to be simulated: of every effect, and of every amplitude that was simulated, the one
/// of the largest gain, most of all first.
std::vector<Candidate> first_candidates(const std::vector<Candidate>& candidates,
                                        const std::vector<ScoreTest>& tests,
                                        const std::vector<AtomGains>& gains, std::size_t most);

/// Refits one after the other; those that fit better than the base, the largest gain first. `folds`
/// are those of the recordings that were fitted, in their order.
std::vector<Contender> refit(const BaseFit& base, const std::vector<Candidate>& first,
                             const std::vector<Candidate>& candidates,
                             const std::vector<ScoreTest>& tests,
                             const std::vector<std::string>& folds, ReferenceForward& model,
                             const ProgressOf& progress);

}  // namespace omentum
