#pragma once

#include <cstdint>

#include "sim_worker/lanes/lane_args.h"
#include "sim_worker/solid/solid_effects.h"

namespace omentum {

/// Raw arguments of the lane kernel of the elastic solid (docs/decisions/0018). Like lane_kernel.h:
/// plain pointers and numbers only, lane index fastest, node vectors are [node][xyz][lane], all
/// positions in W [m].
template <typename Real>
struct SolidArgs : ImplicitArgs<Real> {
  // Mesh, shared by all lanes.
  std::int32_t tetrahedra;
  const std::int32_t* tetrahedron;  ///< 10 nodes each
  const Real* gradient;  ///< [tetrahedron][corner][xyz]: gradient of its volume coordinate [1/m]
  const Real* volume;    ///< a quarter of each tetrahedron's volume [m^3]
  const Real* mass;      ///< per node [kg]
  const Real* mass_over_step2;  ///< per node: m / (effective step)^2 [N/m]
  const Real* contact_gain;     ///< per node: stiffness of contact [N/m]

  // State and scratch, per lane.
  Real* step;                  ///< Newton step, being solved [m]
  Real* z;                     ///< preconditioned residual
  Real* p;                     ///< direction of the conjugate gradients
  Real* hp;                    ///< Hessian times p
  Real* contact_next;          ///< on each node now [N]
  Real* contact_normal;        ///< of the touched shape
  Real* contact_slide;         ///< [node][lane]: stiffness against slip now [N/m]
  std::uint32_t* touches;      ///< per node: lanes in which it touches
  const Real* hold_stiffness;  ///< per node: spring of the jaw that covers it partly [lane] [N/m]
  const Real* hold_target;     ///< per node: where the jaw takes it [xyz][lane] [m]
  const Real* load;            ///< [node][xyz][lane]: forces from outside [N], or null

  SolidEffectArgs<Real> effects;

  std::int32_t contacts;
  const std::int32_t* contact_node;  ///< nodes that may touch in some lane, ascending
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
