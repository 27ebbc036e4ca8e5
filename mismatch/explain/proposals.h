#pragma once

#include <string>
#include <vector>

#include "mismatch/explain/base_fit.h"
#include "mismatch/explain/candidates.h"

namespace omentum {

/// Mean distance of clouds from the surface, along its normal, at the places of the grid of the
/// upper face [m]; NaN where nothing was seen. It shows where the error is, not its cause.
struct ResidualMap {
  std::vector<Eigen::Vector2d> places;  ///< x_B, y_B [m]
  std::vector<double> at_rest;          ///< before anything moves
  std::vector<double> lifted;           ///< while the place is lifted
  std::vector<double> highest;          ///< where the model's upper face gets [m above the board]
};
ResidualMap residual_map(const BaseFit& base);

/// Candidates that columns do not find, since they begin somewhere on the way: obstacles under and
/// above the sheet where the map proposes them, slip, turned jaws, detached pieces of the clamp,
/// adhesion that holds (docs/mismatch.md 5.6).
std::vector<Candidate> simulated_candidates(const BaseFit& base, const ResidualMap& map,
                                            const std::vector<std::string>& ruled_out);

}  // namespace omentum
