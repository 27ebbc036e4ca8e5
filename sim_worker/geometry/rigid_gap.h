#pragma once

#include <Eigen/Core>

#include "sim_worker/geometry/rigid_shape.h"

namespace omentum {

/// Where a point lies relative to a rigid surface.
struct Gap {
  double distance = 0;                                ///< negative inside [m]
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< out of the body, in W
};

/// Distance of p_W to a body, in double precision. Exact for half-space, sphere, box and, less deep
/// than half its shortest semi-axis, ellipsoid. Of a mesh its distance grid, 1 m outside the grid.
Gap rigid_gap(const RigidShape& body, const Eigen::Vector3d& p_W);

/// Distance to a capsule of the given radius [m] around the segment from a to b, in W.
Gap capsule_gap(const Eigen::Vector3d& a, const Eigen::Vector3d& b, double radius,
                const Eigen::Vector3d& p_W);

}  // namespace omentum
