#pragma once

#include <cstdint>

#include "sim_worker/lanes/lane_kernel.h"

// cluster/ is the tissue of the paper: particles pulled to shape-matched clusters (docs/tissue.md
// 2-5). Fast and robust; its stiffness is void without step and iterations, so that it has no
// material in SI units. cooker.h makes the clusters, cluster_kernel.inl moves them.

namespace omentum {

/// Raw arguments of the lane kernel of the cluster model; see lane_kernel.h.
template <typename Real>
struct ClusterArgs {
  // Model, shared by all lanes. Clusters own memberships in order; particles list theirs in cluster
  // order.
  std::int32_t particles;
  std::int32_t clusters;
  const std::int32_t* cluster_begin;
  const std::int32_t* cluster_member;  ///< particle of each membership
  const Real* rest;                    ///< r0_B of each membership [xyz]
  const Real* rest_sum;                ///< per cluster, sum of r0 as rounded [xyz]
  const Real* cluster_weight;          ///< per cluster: stiffness relative to the common one
  const std::uint8_t*
      first_of_particle;             ///< per membership: 1 = the particle's first, in cluster order
  const Real* particle_memberships;  ///< per particle: its number of memberships
  const Real* particle_weight;       ///< per particle: sum of cluster weights
  const Real* particle_scale;        ///< per particle: 1 / max(n / relaxation, 1)
  bool planar;                       ///< r0_z is zero everywhere
  std::int32_t rotation_iterations;

  // State and scratch, per lane.
  Real* x;  ///< positions at the substep's start
  Real* v;
  Real* xs;    ///< x*, being solved
  Real* q;     ///< cluster rotations q_WB, [cluster][xyzw][lane], warm start of the next call
  Real* goal;  ///< [cluster][c, R row-major, weight = 13][lane]
  Real* pull;  ///< [particle][sum of goals, sum of weights = 4][lane], left by the match
  Real* plastic_rest;                  ///< r0 per lane [membership][xyz][lane], or null
  const std::uint32_t* free_mask;      ///< per particle: lanes in which it moves by itself
  const std::uint32_t* held_mask;      ///< per particle: lanes in which the grasp holds it
  const std::uint32_t* candidates;     ///< [particle][shape] lane masks
  const std::uint32_t* candidate_any;  ///< per particle, bit per shape
  const Real* extra;  ///< [particle][dx dy dz count][lane] of links and self-collision, or null

  // Parameters, per lane.
  const Real* stiffness;
  const Real* gravity;  ///< [xyz][lane]
  const Real* keep;     ///< 1 - min(1, damping h)
  const Real* static_friction;
  const Real* dynamic_friction;

  // Parameters of the call.
  Real h;
  Real max_speed;
  Real particle_radius;
  Real plastic_threshold;
  Real plastic_creep;

  // Contact.
  std::int32_t shapes;
  const KernelShape<Real>* shape;
  const Real* capsule;         ///< [xyz][lane] start of the tool's axis now
  const Real* capsule_motion;  ///< [xyz][lane] its motion in this substep

  Real* held_force;  ///< [xyz][lane]: adds the correction the held particles refuse [m]; null = not
                     ///< wanted
};

/// One implementation of the cluster kernel: same source, different width.
template <typename T>
struct ClusterKernel {
  using Real = T;
  int lanes;
  void (*predict)(const ClusterArgs<Real>&);
  void (*match_clusters)(const ClusterArgs<Real>&);
  void (*apply_corrections)(const ClusterArgs<Real>&);
  void (*finish_substep)(const ClusterArgs<Real>&);
};

template <>
const ClusterKernel<float>& kernel_of<ClusterKernel<float>, 1>();
template <>
const ClusterKernel<float>& kernel_of<ClusterKernel<float>, 8>();
template <>
const ClusterKernel<float>& kernel_of<ClusterKernel<float>, 16>();
template <>
const ClusterKernel<double>& kernel_of<ClusterKernel<double>, 1>();

}  // namespace omentum
