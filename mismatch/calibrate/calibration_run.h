#pragma once

#include <string>
#include <utility>
#include <vector>

#include "mismatch/calibrate/calibration.h"
#include "mismatch/fit/descent.h"
#include "mismatch/fit/forward_model.h"

namespace omentum {

/// How much of the work is done, for people.
class WorkPlan {
 public:
  /// `stages`: work of each, in simulations of all recordings without derivatives.
  WorkPlan(ProgressOf progress, std::vector<double> stages, std::size_t recordings)
      : progress_(std::move(progress)), stages_(std::move(stages)), recordings_(recordings) {}
  void begin_stage();
  /// So many simulations of a recording are done. What takes longer than planned waits at the end
  /// of its stage.
  void add(const std::string& stage, double simulations);

 private:
  ProgressOf progress_;
  std::vector<double> stages_;
  std::size_t recordings_ = 0;
  std::size_t next_ = 0;
  double done_ = 0, stage_end_ = 0;  ///< simulations
};

/// A calibration under way: what is fitted and how, where the search stands, and what was found.
/// Stages (stages.h) are functions that take it further.
struct CalibrationRun {
  CalibrationRun(const CalibrationOptions& chosen, FitData fitted_data, ForwardModel& by,
                 WorkPlan plan)
      : options(chosen), model(by), data(std::move(fitted_data)), work(std::move(plan)) {}

  CalibrationOptions options;
  ForwardModel& model;
  FitData data;
  WorkPlan work;
  Numerics fine;          ///< how the answer is simulated
  DescentOptions search;  ///< what all its searches have in common
  Which fitted;           ///< recordings that can be simulated

  Linearisation linear;                            ///< the last surfaces
  SearchState found;                               ///< where their derivatives lead
  FitPosterior posterior;                          ///< there
  bool settled = true;                             ///< the last descent came to rest
  Range clock;                                     ///< of 90 % of the camera's [s]
  double mesh_rms = 0, step_rms = 0, law_rms = 0;  ///< of the surface [m]

  Linearisation believed;  ///< surfaces as believed, on the mesh of the answer
  Calibration result;

  double numerics_rms() const;  ///< of mesh and step
};

/// `stages`: as of WorkPlan. Throws Error where nothing can be fitted.
CalibrationRun begin_calibration(const std::string& method, const CalibrationOptions& options,
                                 FitData data, ForwardModel& model, std::vector<double> stages);

}  // namespace omentum
