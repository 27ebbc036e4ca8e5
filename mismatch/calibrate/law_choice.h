#pragma once

#include <array>
#include <string>
#include <vector>

#include "mismatch/fit/descent.h"

namespace omentum {

inline constexpr std::array<pb::ElasticLaw, 3> kLaws = {pb::LAW_COROTATED, pb::LAW_NEO_HOOKE,
                                                        pb::LAW_ST_VENANT_KIRCHHOFF};

/// Of a law in a report: "neo-Hooke".
std::string law_name(pb::ElasticLaw law);

/// Where a search with one law of elasticity ended.
struct LawFit {
  pb::ElasticLaw law = pb::LAW_COROTATED;
  Descent d;
  std::vector<DifferenceColumn> differences;  ///< with that law
  double mesh_rms = 0;                        ///< [m]
  /// - log of likelihood and beliefs, at a noise and beliefs that all laws share. What mesh and
  /// step are worth is in it: they are nuisances of the fit.
  double cost = 0;
};

/// By so much of the log likelihood one law is better than another, odds of 20.
inline constexpr double kLawTold = 3;

/// The law of the least cost, if it is better than the believed one; else that.
const LawFit& choose_law(const std::vector<LawFit>& fits, pb::ElasticLaw believed);

/// Laws that `chosen` is not told from: it is no better, or their surfaces are no farther apart
/// than `numerics_m`, the errors of mesh and step. These can look like a law, whatever the log
/// likelihood, in which 100,000 points know a pattern of 0.02 mm.
std::vector<const LawFit*> laws_alike(const std::vector<LawFit>& fits, const LawFit& chosen,
                                      double numerics_m);

/// Covariances of a fit of which the law is one of several as likely as each other: what the
/// numbers of the other laws are apart from those of `chosen` widens them.
void widen_over_laws(const LawFit& chosen, const std::vector<const LawFit*>& alike,
                     const Which& which, FitPosterior& posterior);

}  // namespace omentum
