#pragma once

#include <Eigen/Core>
#include <limits>
#include <optional>
#include <vector>

#include "mismatch/fit/fit_data.h"

namespace omentum {

/// Scales that a search adapts to what it finds: of the noise, and of what recordings have of their
/// own.
struct Scales {
  NoiseModel noise;
  Eigen::VectorXd own_sd;  ///< [Layout::own()]
};
/// Before anything is found.
Scales first_scales(const FitData& data);

/// How far a search may go on derivatives, and what it leaves where it is.
struct SearchLimits {
  double trust = 1;                  ///< in the derivatives
  double hold_for = 2;               ///< standard deviations of a belief that they hold for
  std::optional<double> held_clock;  ///< the camera's is known to be this [s]; else looked for
  bool hold_shared = false;          ///< shared numbers stay where they are
  bool hold_noise = false;           ///< its scale is stated, not adapted
};

/// Where a search stands.
struct SearchState {
  FitState state;
  Scales scales;
};

/// Least and largest of the shared numbers, [Layout::shared()].
struct Ranges {
  Eigen::VectorXd low, high;
};
/// Where shared numbers may go from derivatives at `at`.
Ranges ranges_of(const FitData& data, const FitState& at, const SearchLimits& limits);

/// The normal equations of the recordings in `which`, in its order, by what rows are worth. All
/// functions below give the same result on any number of threads.
std::vector<NormalEquations> compare(const FitData& data, const Linearisation& linear,
                                     const Which& which, const FitState& state,
                                     const NoiseModel& noise, bool with_columns);

/// - log of likelihood and beliefs, at some scales.
double cost_of(const FitData& data, const Linearisation& linear, const Which& which,
               const FitState& state, const Scales& scales);

/// Steps of Gauss and Newton from `begin` on surfaces simulated once, until they are small against
/// what the recordings tell, `most_steps` at most (docs/calibrate.md 3). None makes the fit worse,
/// and none leads farther than `limits` allow, nor out of the ranges of the numbers. Adapts the
/// scale of the noise.
SearchState improve(const FitData& data, const Linearisation& linear, const Which& which,
                    int most_steps, const SearchLimits& limits, SearchState begin);

/// Covariances at a state.
FitPosterior posterior_at(const FitData& data, const Linearisation& linear, const Which& which,
                          const SearchLimits& limits, const SearchState& at);

/// Scales of what recordings have of their own, from how they came out.
void adapt_own_scales(const FitData& data, const FitPosterior& posterior, const Which& which,
                      const FitState& state, Scales& scales);

/// Distances of points from the surface, above zero outside of it, per frame [m]; own numbers and
/// modes as given.
std::vector<std::vector<double>> distances(const FitData& data, const Linearisation& linear,
                                           const FitState& state, std::size_t recording,
                                           double reach);

}  // namespace omentum
