#pragma once

#include <vector>

#include "mismatch/explain/base_fit.h"

namespace omentum {

/// Errors of two surfaces against a recording, as medians over blocks: what single points scatter
/// by goes, what a model misses stays (docs/mismatch.md 5.6).
struct BlockErrors {
  double base = 0, model = 0;  ///< rms over blocks [m]; NaN where there is none
  double base_mse_se = 0;      ///< standard error of the square of `base` [m2]
  double floor = 0;            ///< what a right model would leave [m]
  std::size_t blocks = 0;
};

/// Of recording `r`: blocks of 20 mm by 20 mm of the sheet at rest by 0.2 s. `base` and `model`
/// without discrepancy. The floor is the sensor's noise, and where `own` is given what own numbers
/// that are not known move the surface by: its derivatives by them, at base.found.state.
BlockErrors block_errors(const BaseFit& base, const std::vector<Prediction>& base_surfaces,
                         const BaseFit& model, const std::vector<Prediction>& model_surfaces,
                         std::size_t r, const Linearisation* own);

/// By how many nats a frame is better by `model`, with blocks of the sheet off by the noise of
/// their mean and by the stated discrepancy.
struct FrameGain {
  double t = 0;  ///< [s]
  double gain = 0;
};
std::vector<FrameGain> frame_gains(const BaseFit& base, const BaseFit& model, std::size_t r);

/// Signed distances of the points of a recording from a surface without discrepancy, by frame [m];
/// NaN beyond 30 mm.
std::vector<std::vector<double>> distances_from(const BaseFit& fit,
                                                const std::vector<Prediction>& surfaces,
                                                std::size_t r);

}  // namespace omentum
