#pragma once

#include <string>
#include <vector>

#include "mismatch/explain/contenders.h"
#include "mismatch/explain/explain.h"
#include "mismatch/explain/verdict_class.h"

namespace omentum {

/// A case on its way to a verdict.
struct Case {
  const ExplainOptions& options;
  BaseFit base;
  std::vector<Candidate> candidates;
  std::vector<Evidence> fitted, held_out;
  std::vector<std::string> folds;  ///< of `fitted`: a recording and its repeats are one
  /// Folds scatter so many times as much as what is stated (learned_dispersion()).
  double dispersion = 1;
  Floors floors;
  std::vector<ScoreTest> tests;
  VerdictClass judged;

  const Candidate& candidate(const std::string& key) const;
};

// Parts of a verdict, each from what is known of a case.

void add_settings(const Case& made, pb::Verdict& verdict);
/// Of an effect with several places or directions that which is seen best.
void add_limits(const Case& made, pb::Verdict& verdict);
void add_scores(const Case& made, pb::Verdict& verdict);
void add_pulls(const Case& made, pb::Verdict& verdict);
/// A line for every number of the base that would leave the range of its belief.
void add_bounds(const BaseFit& base, pb::Verdict& verdict);
/// What columns claim, and what each leaves; then what of it was simulated.
void add_rivals(const Case& made, const std::vector<Contender>& contenders, pb::Verdict& verdict);
/// After add_fit(): the first of `contenders`, in a class with those that simulations do not tell
/// from it; `beside` is the case with it in the base.
void add_effect(const Case& made, const Case& beside, const std::vector<Contender>& contenders,
                pb::Verdict& verdict);
/// Errors of each recording without and with `best` (block_errors()), of those held out in the
/// shell besides.
void add_fit(const Case& made, const BaseFit& best, ReferenceForward& model, pb::Verdict& verdict);
/// Forces on the tool without and with `best`. A claim that they contradict does not explain all.
void add_channels(const Case& made, const BaseFit& best, pb::Verdict& verdict);
/// A recording several times as far off as the others, or that cannot be simulated.
void add_bad_recordings(const Case& made, pb::Verdict& verdict);

}  // namespace omentum
