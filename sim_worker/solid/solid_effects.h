#pragma once

#include <cstdint>

#include "sim_worker/lanes/lane_effect_args.h"

// solid/ is the elastic solid in SI units (docs/decisions/0018): quadratic tetrahedra of stable
// neo-Hooke material, each substep solved by Newton and conjugate gradients. solid_tissue.cpp has
// the step, solid_kernel.inl the arithmetic, solid_model.cpp what all lanes share.

namespace omentum {

/// Effects in the lane kernel of the elastic solid, stresses and energies per volume in Pa at the
/// nominal stiffness. Elements are integration points, 4 tetrahedron + point; tensors are
/// symmetric, [xx, yy, zz, yz, xz, xy] in B.
template <typename Real>
struct SolidEffectArgs : LaneEffectArgs<Real> {
  std::uint32_t material;  ///< lanes with an effect in the material that needs more than a number

  // Parameters, [lane].
  const Real* mu;      ///< stable neo-Hooke [Pa]
  const Real* lambda;  ///< [Pa]
  const Real* alpha;
  const Real* bulk;  ///< the part of lambda that acts on the mean of an element [Pa]

  /// [point][lane]: stiffness there over that of the lane; null = 1.
  const Real* map;

  // Nodes.
  const std::int32_t* skin;  ///< 3 nodes of each triangle, counter-clockwise from outside
  std::int32_t skin_triangles;
  Real* bond_fresh;  ///< [node][lane]: stiffness of a spring before it was stretched [N/m]
  Real* bond_now;    ///< scratch [node][lane]: stiffness in this substep [N/m]
  Real* area;        ///< scratch [node][xyz][lane]: area of the skin, outwards [m^2]
  Real* drag_now;    ///< scratch [node][xyz][lane]: force of the air at the substep's start [N]
};

}  // namespace omentum
