#pragma once

#include "mismatch/calibrate/calibration.h"
#include "mismatch/fit/search.h"

namespace omentum {

/// Distances of a recording's points from surfaces carried to `state`, and from those simulated as
/// `believed`. Role and floor are left empty.
FitRow score(const FitData& data, const Linearisation& linear, const FitState& state,
             std::size_t recording, const Linearisation& believed);

/// White part of the distances along the rays, from neighbours in a cloud [m]; where there is no
/// cloud, that of the distances of markers, as measured in holds or from frame to frame, if less.
double floor_of(const Observation& seen, const NormalEquations& compared);

/// Adds to surfaces simulated at `state`, to first order, what shared numbers do that are in no
/// scene; its derivatives from another simulation of the recording that has some.
void add_nuisances(const FitData& data, const Prediction& with_columns, const FitState& state,
                   Prediction& prediction);

/// A recording for the report: frames that were simulated both now and as believed.
ShownRecording show(const FitData& data, const Linearisation& linear, const FitState& state,
                    std::size_t recording, const Linearisation& believed);

}  // namespace omentum
