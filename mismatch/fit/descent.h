#pragma once

#include <functional>
#include <vector>

#include "mismatch/fit/search.h"

namespace omentum {

/// A search that simulates again where its steps lead, and where it ended.
struct Descent {
  Linearisation linear;    ///< the best state that was simulated
  SearchState found;       ///< where its derivatives lead
  FitPosterior posterior;  ///< there
  bool settled = false;    ///< nothing that is simulated moves any more
};

struct DescentOptions {
  int most_simulations = 3;
  double small_move = 0.25;     ///< standard deviations: needs no further simulation
  double cost_tolerance = 0.5;  ///< of a log likelihood: what equal simulations differ by
  SearchLimits limits;
};

/// Simulates a state with its columns, of every recording that counts.
using LineariseAt = std::function<Linearisation(const FitState&)>;

/// How far a state is from where it was simulated: the farthest number in its standard deviations.
double moved(const FitData& data, const Which& which, const FitState& at, const FitState& state,
             const FitPosterior& posterior);
inline constexpr double kSmallMove = 0.25;  ///< needs no further simulation

/// Begins with surfaces simulated at a state: improves on the derivatives, simulates, and again. A
/// step after which the simulation fits worse, or after which a recording cannot be simulated any
/// more, is taken back, and the derivatives are trusted less.
Descent descend(const FitData& data, const LineariseAt& linearise, const Which& which,
                const DescentOptions& options, Linearisation begin, const Scales& scales);

}  // namespace omentum
