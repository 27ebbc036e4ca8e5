#pragma once

#include "sim_worker/kernel.h"
#include "sim_worker/scene.h"

namespace omentum {

/// A rigid body of the scene as the lane kernels take it: plain numbers in the kernel's precision,
/// pose and sizes in W [m]. The distance grid of a mesh is pointed to, not copied: `body` must
/// outlive the shape. Real: float, double.
template <typename Real>
KernelShape<Real> make_kernel_shape(const RigidShape& body);

/// The tool's shaft as a contact shape: a capsule of `radius` along `axis` (unit, in W) from its
/// start to `length` [m].
template <typename Real>
KernelShape<Real> make_tool_shape(double radius, double length, const Eigen::Vector3d& axis);

}  // namespace omentum
