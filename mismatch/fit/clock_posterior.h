#pragma once

#include <vector>

#include "mismatch/fit/search.h"

namespace omentum {

/// A density that is known at two places or more, its logarithm straight between them.
struct KnownDensity {
  std::vector<double> x, log_density;  ///< x ascends
  /// What of an integral belongs to each place, if what is integrated is straight between them.
  std::vector<double> weights() const;
  /// Where the integral has reached that share.
  double quantile(double share) const;
  /// The shortest range that holds so much of the integral: where the density begins at a step that
  /// is part of it.
  Range shortest(double share) const;
};

/// What is known with the camera's clock integrated over all that it may be.
struct ClockPosterior {
  FitState state;          ///< mean
  FitPosterior posterior;  ///< covariances about it
  Range clock;             ///< of 90 % of it [s]
};

/// A cloud that was taken just before the tissue moved on shuts out one direction of the clock and
/// leaves the other open; no curvature says so. All other numbers are fitted at several clocks and
/// integrated there by their curvature, which says how likely each clock is [Rue09].
/// `found`: where the search ended, `posterior`: its covariances.
ClockPosterior integrate_clock(const FitData& data, const Linearisation& linear, const Which& which,
                               const SearchState& found, const FitPosterior& posterior);

}  // namespace omentum
