#pragma once

#include <array>
#include <cstdint>

#include "sim_worker/lanes/lane_kernel.h"
#include "sim_worker/tissue/surroundings.h"

namespace omentum {

/// A rigid body of the scene as the lane kernels take it: plain numbers in the kernel's precision,
/// pose and sizes in W [m]. The distance grid of a mesh is pointed to, not copied: `body` must
/// outlive the shape. Aborts for a mesh without such a grid. Real: float, double.
template <typename Real>
KernelShape<Real> make_kernel_shape(const RigidShape& body);

/// What a tissue collides with: the rigid bodies, then the tool's shaft where it can touch, a
/// capsule whose axis is an argument of the kernels. Entries from `count` on are zero. At most
/// kMaxShapes in all, which make_surroundings() has checked.
template <typename Real>
struct KernelShapes {
  std::array<KernelShape<Real>, kMaxShapes> shape{};
  std::int32_t count = 0;
};
template <typename Real>
KernelShapes<Real> make_kernel_shapes(const Surroundings& around);

}  // namespace omentum
