#include "mismatch/explain/verdict_class.h"

#include <algorithm>
#include <cmath>

namespace omentum {

namespace {

/// Largest first; equal ones by name, so that the order of atoms does not matter.
template <typename Gains>
void sort_by_gain(std::vector<Gains>& gains) {
  std::sort(gains.begin(), gains.end(), [](const Gains& x, const Gains& y) {
    return x.gain != y.gain ? x.gain > y.gain : x.atom < y.atom;
  });
}

Result<Entrant> try_in_base(std::span<const Evidence> recordings, const FoldEvidence& evidence,
                            const AtomGains& claim, const Floors& floors,
                            const Thresholds& thresholds) {
  Entrant entrant;
  entrant.atom = claim.atom;
  entrant.gain = claim.agreed;
  const std::string base[] = {claim.atom};
  auto folds = with_in_base(evidence, base);
  if (!folds) return Failure{folds.error()};
  auto beside = left_out_gains(folds.value(), floors, thresholds);
  if (!beside) return Failure{beside.error()};
  for (const AtomGains& other : beside.value()) entrant.left.push_back({other.atom, other.agreed});
  sort_by_gain(entrant.left);
  auto pulled = pulls(with_in_base(recordings, base));
  if (!pulled) return Failure{pulled.error()};
  if (!pulled.value().empty()) entrant.largest_pull = pulled.value().front();
  const bool leaves = !entrant.left.empty() && entrant.left.front().gain > thresholds.reject;
  entrant.adequate = !leaves && std::fabs(entrant.largest_pull.pull) <= thresholds.pull;
  return entrant;
}

/// What `entrant` leaves to `atom`.
double left_to(const Entrant& entrant, const std::string& atom) {
  const auto found = std::find_if(entrant.left.begin(), entrant.left.end(),
                                  [&](const LeftGain& left) { return left.atom == atom; });
  return found == entrant.left.end() ? 0 : found->gain;
}

}  // namespace

Result<VerdictClass> judge_atoms(std::span<const Evidence> recordings,
                                 std::span<const std::string> fold_of, const Floors& floors,
                                 const Thresholds& thresholds) {
  auto evidence = make_folds(recordings, fold_of);
  if (!evidence) return Failure{evidence.error()};
  auto gains = left_out_gains(evidence.value(), floors, thresholds);
  if (!gains) return Failure{gains.error()};
  VerdictClass verdict;
  verdict.gains = std::move(gains).value();
  for (const AtomGains& atom : verdict.gains) {
    if (!atom.claimed) continue;
    auto entrant = try_in_base(recordings, evidence.value(), atom, floors, thresholds);
    if (!entrant) return Failure{entrant.error()};
    verdict.entrants.push_back(std::move(entrant).value());
  }
  sort_by_gain(verdict.entrants);
  if (verdict.entrants.empty()) return verdict;
  verdict.winner = verdict.entrants.front().atom;
  const bool winner_stands = verdict.entrants.front().adequate;
  for (const Entrant& entrant : verdict.entrants) {
    const bool replaces = winner_stands && entrant.atom != verdict.winner &&
                          left_to(entrant, verdict.winner) <= thresholds.reject;
    if (entrant.adequate || replaces) verdict.members.push_back(entrant.atom);
  }
  return verdict;
}

void withdraw(const std::string& atom, VerdictClass& judged) {
  AtomGains& gains = *std::ranges::find(judged.gains, atom, &AtomGains::atom);
  gains.trimmed = gains.agreed = 0;
  gains.claimed = false;
  std::erase_if(judged.entrants, [&](const Entrant& entrant) { return entrant.atom == atom; });
}

}  // namespace omentum
