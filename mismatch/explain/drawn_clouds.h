#pragma once

#include <cstddef>
#include <cstdint>

#include "mismatch/explain/base_fit.h"

namespace omentum {

/// Clouds of a camera that nobody has looked through yet.
struct DrawnClouds {
  double noise_m = 8e-4;     ///< standard deviation of a point along its ray
  std::size_t points = 400;  ///< of the sheet at rest, about
  std::uint64_t seed = 1;
};

/// Puts what the camera would see of the surfaces of a recording into its frames: where the rays of
/// a regular picture meet them first, with noise along the ray. Instruments hide nothing.
void draw_clouds(const DrawnClouds& drawn, std::size_t recording, BaseFit& base);

}  // namespace omentum
