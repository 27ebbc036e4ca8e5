#pragma once

#include <span>
#include <string>
#include <vector>

#include "mismatch/explain/left_out_gains.h"
#include "mismatch/explain/pulls.h"

namespace omentum {

/// What one atom gains beside another that is in the base [nats].
struct LeftGain {
  std::string atom;
  double gain = 0;  ///< trimmed
};

/// A claimed atom, put into the base (docs/mismatch.md 5.4).
struct Entrant {
  std::string atom;
  double gain = 0;             ///< S_k without others in the base [nats]
  std::vector<LeftGain> left;  ///< what it leaves to each other atom, largest first
  Pull largest_pull;           ///< of nuisances and numerics beside it
  bool adequate = false;       ///< it leaves nothing and pulls nothing
};

/// Which atoms are claimed, and which of them the data cannot tell apart.
struct VerdictClass {
  std::vector<AtomGains> gains;   ///< of all atoms beside the base
  std::vector<Entrant> entrants;  ///< what is claimed, largest gain first
  std::string winner;             ///< the first of these; empty: nothing is claimed
  /// The winner, every adequate rival, and every rival beside which the winner gains no more.
  /// Empty: no single atom is adequate. Largest gain first.
  std::vector<std::string> members;
};

/// `fold_of` is that of make_folds(). Every claimed atom is put into the base by itself and
/// everything is asked again.
Result<VerdictClass> judge_atoms(std::span<const Evidence> recordings,
                                 std::span<const std::string> fold_of, const Floors& floors,
                                 const Thresholds& thresholds = {});

/// An atom that could not act as it was found gains nothing and is not claimed. Class and winner
/// stay as they are.
void withdraw(const std::string& atom, VerdictClass& judged);

}  // namespace omentum
