#pragma once

#include <Eigen/Core>

#include "core/psm.h"

namespace omentum {

/// Jaw tip T of a pose of the control point C, in the frame F of that pose, whichever it is [m]:
/// the jaw points along z_C (docs/dvrk.md 1).
inline Eigen::Vector3d tip_of(const ToolMount& mount, const Eigen::Matrix3d& R_FC,
                              const Eigen::Vector3d& p_FC) {
  return p_FC + mount.tip_offset * R_FC.col(2);
}
/// The control point of a tip.
inline Eigen::Vector3d control_point_of(const ToolMount& mount, const Eigen::Matrix3d& R_FC,
                                        const Eigen::Vector3d& p_FT) {
  return p_FT - mount.tip_offset * R_FC.col(2);
}

}  // namespace omentum
