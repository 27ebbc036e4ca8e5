#pragma once

#include <cstdint>

#include "sim_worker/lanes/lane_kernel.h"

// lanes/ is the arithmetic of many environments at once: one environment per SIMD lane, one source
// at 1, 8 and 16 lanes of float and 1 of double, the same bits at every width. What all tissue
// models share of it: contact with rigid shapes, implicit steps, triangular solves, nearest point,
// skin, picture.

namespace omentum {

/// What the kernels of all tissue models in lanes get: raw arguments, see lane_kernel.h. A node is
/// a particle or a node of a mesh.
template <typename Real>
struct LaneArgs {
  Real* x;  ///< positions at the substep's start [node][xyz][lane]
  Real* v;
  const std::uint32_t* free_mask;  ///< per node: lanes in which it moves by itself

  // Parameters, per lane.
  const Real* stiffness;  ///< E / nominal E
  const Real* gravity;    ///< [xyz][lane]
  const Real* keep;       ///< part of the velocity that damping leaves per substep
  const Real* static_friction;
  const Real* dynamic_friction;
  const Real* particle_radius;  ///< collision distance [m]

  // Contact.
  const std::uint32_t* candidates;     ///< [node][shape] lane masks
  const std::uint32_t* candidate_any;  ///< per node, bit per shape
  std::int32_t shapes;
  const KernelShape<Real>* shape;
  const Real* capsule;  ///< [foot, direction][xyz][lane] of the tool's axis at the substep's end
  const Real* capsule_motion;  ///< [xyz][lane]: motion of its foot in this substep
};

/// The same of models that take implicit steps (implicit_step.inl), in metres and newtons.
template <typename Real>
struct ImplicitArgs : LaneArgs<Real> {
  std::int32_t nodes;
  bool second_order;    ///< BDF2 instead of backward Euler
  Real effective_step;  ///< h, or 2 h / 3 for BDF2 [s]
  Real inverse_step;    ///< 1 / effective step [1/s]
  Real third;           ///< 1/3 of BDF2, rounded once

  // Scratch and history, [node][xyz][lane].
  Real* v_old;          ///< BDF2: velocity one substep earlier
  Real* d_old;          ///< BDF2: displacement of the last substep
  Real* d;              ///< displacement since the substep's start, being solved
  Real* moved;          ///< x + d
  Real* b;              ///< residual of the step [N]
  Real* contact_force;  ///< of the surroundings [N]
};

}  // namespace omentum
