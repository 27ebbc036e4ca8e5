#pragma once

#include "mismatch/calibrate/surface_fit.h"

namespace omentum {

/// Distances of a recording's points from what was simulated at `at` and follows its derivatives to
/// `state`, and from the simulation as believed. Role and floor are left empty.
FitRow score(SurfaceFit& fit, std::size_t recording, const Prediction& prediction,
             const FitState& at, const FitState& state, const Prediction& base);

/// White part of the distances along the rays, from neighbours in a cloud [m]; where there is no
/// cloud, that of the distances of markers, as measured in holds or from frame to frame, if less.
double floor_of(const Observation& seen, const Block& block);

/// Adds to surfaces simulated at `state`, to first order, what shared numbers do that are in no
/// scene; its derivatives from another simulation of the recording that has some.
void add_nuisances(const SurfaceFit& fit, const Prediction& with_columns, const FitState& state,
                   Prediction& prediction);

/// A recording for the report: frames that were simulated both now and as believed.
ShownRecording show(SurfaceFit& fit, std::size_t recording, const Prediction& prediction,
                    const FitState& at, const FitState& state, const Prediction& base);

}  // namespace omentum
