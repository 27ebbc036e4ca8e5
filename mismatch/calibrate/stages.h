#pragma once

#include <string>

#include "mismatch/calibrate/calibration_run.h"

// Stages of a calibration that all models share (docs/calibrate.md 3), in the order of their use.
namespace omentum {

/// Where the markers sit on the body, by the simulation as believed.
void bind_markers(const Numerics& numerics, CalibrationRun& run);

/// What a descent of a run is about.
struct DescentStage {
  Numerics numerics;
  int most_simulations = 3;
  double small_move = kSmallMove;
  double work = 1;  ///< of one simulation, as of WorkPlan
  std::string name;
};
/// Simulates and improves from where the run stands until nothing moves. `frames`: those that are
/// looked at instead of all of FitData; recordings that cannot be simulated are dropped.
void descend(const DescentStage& stage, CalibrationRun& run,
             const std::vector<Observation>* frames = nullptr);

/// Takes where a descent ended.
void take(Descent descent, CalibrationRun& run);

/// The step as a nuisance, by a simulation with half of it, whose difference is the error over
/// `fall`.
void measure_step(double fall, CalibrationRun& run);

/// The smooth discrepancy and the scales of what recordings have of their own, with the numbers.
void settle_scales(CalibrationRun& run, const std::vector<Observation>* frames = nullptr);
/// The scales move the numbers, and what is simulated follows them. `work`: as of DescentStage.
void settle(double work, CalibrationRun& run);

/// Figures of the fit, of pinch points left out and of recordings held out; numbers, findings and
/// the scene. The run is over.
Calibration finish(CalibrationRun run);

}  // namespace omentum
