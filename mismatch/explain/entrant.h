#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/explain/base_fit.h"

namespace omentum {

/// An effect in the base: simulated with it, base and nuisances refitted beside it
/// (docs/mismatch.md 5.6).
struct EntrantFit {
  Candidate candidate;
  /// A number of the effect: its amplitude, then x_B and y_B of its place where it has one.
  struct Parameter {
    std::string name, unit;
    double value = 0, sd = 0;
  };
  std::vector<Parameter> numbers;
  NamedEffect effect;    ///< with these numbers
  pb::Scene base_scene;  ///< without it
  BaseFit fit;           ///< with the effect in the scene; its numbers are among the unknowns
};

/// Steps of Gauss and Newton from what columns foretell, at `place`, each simulated;
/// derivatives of base and nuisances as they were. Nothing where the recordings cannot be simulated
/// with it, or fit no better.
std::optional<EntrantFit> fit_entrant(const BaseFit& base, const Candidate& candidate,
                                      const std::optional<Eigen::Vector2d>& place,
                                      ReferenceForward& model);

/// Evidence of the recordings with the effect in the base: that of `before`, moved to the surfaces
/// of the entrant, its own numbers in the base and candidates of its effect gone.
std::vector<Evidence> gather_evidence(const EntrantFit& entrant, ReferenceForward& model,
                                      const ExplainOptions& options);

}  // namespace omentum
