#pragma once

#include "mismatch/calibrate/surface_fit.h"

namespace omentum {

/// By the converged solid and its columns. Where a recording cannot be simulated all are tried with
/// smoother friction, which stays if it helps.
class ReferenceFit : public SurfaceFit {
 public:
  using SurfaceFit::SurfaceFit;

 protected:
  std::vector<Prediction> predict_all(const FitState& state, const Numerics& numerics,
                                      bool with_columns,
                                      const std::vector<std::size_t>& which) override;

 private:
  double slip_speed_ = 0;  ///< of friction, where the scene's is too sharp to be solved [m/s]
};

}  // namespace omentum
