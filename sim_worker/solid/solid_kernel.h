#pragma once

#include <cstdint>

#include "sim_worker/lanes/lane_kernel.h"
#include "sim_worker/solid/solid_effects.h"

namespace omentum {

/// Raw arguments of the lane kernel of the elastic solid (docs/decisions/0018). Like lane_kernel.h:
/// plain pointers and numbers only, lane index fastest, node vectors are [node][xyz][lane], all
/// positions in W [m].
template <typename Real>
struct SolidArgs {
  // Mesh, shared by all lanes.
  std::int32_t nodes;
  std::int32_t tetrahedra;
  const std::int32_t* tetrahedron;  ///< 10 nodes each
  const Real* gradient;         ///< [tetrahedron][corner][xyz]: gradient of its volume share [1/m]
  const Real* volume;           ///< a quarter of each tetrahedron's volume [m^3]
  const Real* mass;             ///< per node [kg]
  const Real* mass_over_step2;  ///< per node: m / (effective step)^2 [N/m]
  const Real* contact_gain;     ///< per node: stiffness of contact [N/m]
  bool second_order;            ///< BDF2 instead of backward Euler
  Real effective_step;          ///< h, or 2 h / 3 for BDF2 [s]
  Real inverse_step;            ///< 1 / effective step [1/s]
  Real third;                   ///< 1/3 of BDF2, rounded once

  // State and scratch, per lane.
  Real* x;  ///< positions at the substep's start
  Real* v;
  Real* v_old;                 ///< BDF2: velocity one substep earlier
  Real* d_old;                 ///< BDF2: displacement of the last substep
  Real* d;                     ///< displacement since the substep's start, being solved
  Real* moved;                 ///< x + d
  Real* b;                     ///< residual [N]
  Real* step;                  ///< Newton step, being solved [m]
  Real* z;                     ///< preconditioned residual
  Real* p;                     ///< direction of the conjugate gradients
  Real* hp;                    ///< Hessian times p
  Real* contact_force;         ///< on each node at the substep's start [N]
  Real* contact_next;          ///< on each node now [N]
  Real* contact_normal;        ///< of the touched shape
  Real* contact_slide;         ///< [node][lane]: stiffness against slip now [N/m]
  std::uint32_t* touches;      ///< per node: lanes in which it touches
  std::uint32_t* free_mask;    ///< per node: lanes in which it moves by itself
  const Real* hold_stiffness;  ///< per node: spring of the jaw that covers it partly [lane] [N/m]
  const Real* hold_target;     ///< per node: where the jaw takes it [xyz][lane] [m]
  const Real* load;            ///< [node][xyz][lane]: forces from outside [N], or null

  // Parameters, per lane.
  const Real* stiffness;  ///< E / nominal E
  SolidEffectArgs<Real> effects;
  const Real* gravity;  ///< [xyz][lane]
  const Real* keep;     ///< exp(-damping x effective step)

  // Contact, as in KernelArgs.
  std::int32_t contacts;
  const std::int32_t* contact_node;    ///< nodes that may touch in some lane, ascending
  const std::uint32_t* candidates;     ///< [node][shape] lane masks
  const std::uint32_t* candidate_any;  ///< per node, bit per shape
  Real particle_radius;
  std::int32_t shapes;
  const KernelShape<Real>* shape;
  const Real* capsule;  ///< [xyz][lane]
  const Real* capsule_motion;
  const Real* static_friction;
  const Real* dynamic_friction;
};

/// One implementation of the solid kernel: same source, different width. SolidTissue::step calls
/// them. Lanes that a call does not change keep their bits.
template <typename T>
struct SolidKernel {
  using Real = T;
  int lanes;
  void (*start_substep)(const SolidArgs<Real>&);
  /// What effects on nodes are in this substep, and what effects remember after it.
  void (*start_effects)(const SolidArgs<Real>&);
  void (*remember_effects)(const SolidArgs<Real>&);
  /// b = gradient of the step's potential at x + d, also where a node is not free.
  void (*find_residual)(const SolidArgs<Real>&);
  /// Force of the tissue on whatever holds a node that is not free [N]; `out` is [node][xyz][lane].
  void (*find_reaction)(const SolidArgs<Real>&, Real* out);
  /// hp = Hessian at x + d times p, also where a node is not free.
  void (*multiply_hessian)(const SolidArgs<Real>&);
  /// Zeroes `vector` where a node is not free.
  void (*keep_free)(const SolidArgs<Real>&, Real* vector);
  void (*dot)(const SolidArgs<Real>&, const Real* a, const Real* b, Real* result);
  /// a += factor c per lane, in the given lanes.
  void (*add_scaled)(const SolidArgs<Real>&, Real* a, const Real* c, const Real* factor,
                     std::uint32_t lanes);
  /// p = z + factor p per lane.
  void (*advance_direction)(const SolidArgs<Real>&, const Real* factor);
  void (*finish_substep)(const SolidArgs<Real>&);
};

template <>
const SolidKernel<float>& kernel_of<SolidKernel<float>, 1>();
template <>
const SolidKernel<float>& kernel_of<SolidKernel<float>, 8>();
template <>
const SolidKernel<float>& kernel_of<SolidKernel<float>, 16>();
template <>
const SolidKernel<double>& kernel_of<SolidKernel<double>, 1>();

}  // namespace omentum
