#pragma once

#include "mismatch/calibrate/surface_fit.h"

namespace omentum {

/// Of a step in the logarithm of the stiffness, which should change nothing that is seen.
inline constexpr double kTouch = 1e-6;

/// By the shell of the scene, whose derivatives are differences of simulations. So any number of
/// the scene that a prior names can be looked for, and the time between frames. Where the jaws
/// closed is as recorded: on one recording of a free sheet that cannot be told from where it lay.
class ShellFit : public SurfaceFit {
 public:
  ShellFit(const pb::Scene& scene, std::vector<Observation> observations,
           const CalibrationOptions& options);

  /// Steps of the differences move the sheet so many times as far as chance does, where that is
  /// less than half a standard deviation of the belief.
  double clear = 5;

 protected:
  std::vector<Prediction> predict_all(const FitState& state, const Numerics& numerics,
                                      bool with_columns,
                                      const std::vector<std::size_t>& which) override;

 private:
  double step_of(std::size_t number) const;

  std::vector<double> moved_;  ///< what a step of 1 in each number moves [m, rms]; 0: not known
  double chance_ = 0;          ///< what a step that should move nothing does [m, rms]
};

}  // namespace omentum
