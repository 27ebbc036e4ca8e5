#pragma once

#include "proto/config.pb.h"

namespace omentum {

// Which rows of a sheet are clamped (scene.tissue.anchor_max_y_m, anchor_min_y_m), the same for the
// scene and every model of it. y: y_B at rest [m]. A row that lies exactly on the bound is clamped
// whatever its rounding.

inline constexpr double kOnClampBound = 1e-9;  ///< [m]

inline bool in_lower_clamp(const pb::Tissue& tissue, double y) {
  return y <= tissue.anchor_max_y_m() + kOnClampBound;
}
inline bool in_upper_clamp(const pb::Tissue& tissue, double y) {
  return y >= tissue.anchor_min_y_m() - kOnClampBound;
}

}  // namespace omentum
