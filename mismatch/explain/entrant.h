#pragma once

#include <optional>
#include <string>
#include <vector>

#include "mismatch/explain/base_fit.h"

namespace omentum {

/// An effect in the base: simulated with it, base and nuisances refitted beside it
/// (docs/mismatch.md 5.6).
struct EntrantFit {
  Candidate candidate;
  std::vector<EffectNumber> numbers;
  std::vector<double> searched;  ///< where these ended, as EffectNumber::searched()
  std::vector<double> sd;        ///< of these
  std::vector<double> values() const;
  std::vector<std::string> keys() const;  ///< of these among the unknowns and in evidence
  NamedEffect effect;                     ///< with these numbers
  double gained = 0;                      ///< cost that it takes off, in and beside the base [nats]
  pb::Scene base_scene;                   ///< without it
  BaseFit fit;  ///< with the effect in the scene; its numbers are among the unknowns
};

/// Steps of Gauss and Newton on the numbers of the effect, each simulated, from what columns
/// foretell, at `place` where it has one. One that gains no more than `worth` [nats] along the
/// first of them, on the coarse mesh and on the finer one, goes no farther. Nothing where the
/// recordings cannot be simulated with it, or fit no better.
std::optional<EntrantFit> fit_entrant(const BaseFit& base, const Candidate& candidate,
                                      const std::vector<Candidate>& candidates,
                                      const std::optional<Eigen::Vector2d>& place, double worth,
                                      ReferenceForward& model);

/// Evidence of the recordings with the effect in the base: that of `before`, moved to the surfaces
/// of the entrant, its own numbers in the base and candidates of its effect gone.
std::vector<Evidence> gather_evidence(const EntrantFit& entrant, ReferenceForward& model,
                                      const ExplainOptions& options);

}  // namespace omentum
