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
  /// Log density that it adds to each fold, simulated, as the others foretell the fold [nats].
  std::vector<double> folds;
  double gain = 0;    ///< their trimmed sum
  double agreed = 0;  ///< the same by how far folds disagree about its numbers (Spread)
};

/// What `one` adds beyond `other`, trimmed [nats].
double lead(const Contender& one, const Contender& other);

/// Candidates to be simulated, those whose trimmed gain by columns exceeds `least`: of every effect
/// on either side of zero one, of obstacles one below and one above. First comes the largest
/// geometric mean of the gain as it is, which a strong effect has, and divided by its dispersion,
/// which a look-alike has not.
std::vector<Candidate> first_candidates(const std::vector<Candidate>& candidates,
                                        const std::vector<ScoreTest>& tests,
                                        const std::vector<AtomGains>& gains, double least,
                                        std::size_t most);

/// Where its columns say an effect is: weighted centroid of z^2 over the places near the best.
std::optional<Eigen::Vector2d> place_of(const Candidate& best,
                                        const std::vector<Candidate>& candidates,
                                        const std::vector<ScoreTest>& tests);

/// The largest gain first.
void sort_by_gain(std::vector<Contender>& contenders);

}  // namespace omentum
