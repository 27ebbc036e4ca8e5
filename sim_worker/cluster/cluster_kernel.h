#pragma once

#include <cstdint>

#include "sim_worker/lanes/lane_args.h"
#include "sim_worker/lanes/lane_effect_args.h"

// cluster/ is the tissue of the paper: particles and shape-matched clusters (docs/tissue.md 2-5).
// Fast and robust; its stiffness depends on step and iterations, so it has no material in SI units.
// cooker.h makes the clusters, cluster_kernel.inl moves them.

namespace omentum {

/// What match_clusters does to the particles after their correction.
enum class AfterMatch : std::int32_t {
  kIterate,  ///< nothing: another iteration follows
  kPredict,  ///< ends the substep and predicts the next one
  kFinish,   ///< ends the last substep of a control step: velocities as well
};

/// Raw arguments of the lane kernel of the cluster model; see lane_kernel.h.
template <typename Real>
struct ClusterArgs : LaneArgs<Real> {
  // Model, shared by all lanes. Clusters own memberships in order; particles list theirs in cluster
  // order.
  std::int32_t particles;
  std::int32_t clusters;
  const std::int32_t* cluster_begin;
  const std::int32_t* cluster_member;  ///< particle of each membership
  const Real* rest;                    ///< r0_B of each membership [xyz]
  const Real* rest_sum;                ///< per cluster, sum of r0 as rounded [xyz]
  const Real* cluster_weight;          ///< per cluster: stiffness relative to the common one
  // Memberships of each cluster again, grouped: those that are both the first and the last one of
  // their particle, the first but not the last, neither, the last but not the first.
  const std::int32_t* turn;        ///< membership
  const std::int32_t* turn_begin;  ///< 4 per cluster, and the end
  std::int32_t loose;              ///< particles in no cluster
  const std::int32_t* loose_particle;
  const Real* particle_memberships;  ///< per particle: its number of memberships
  const Real* particle_weight;       ///< per particle: sum of cluster weights
  const Real* particle_scale;        ///< per particle: 1 / max(n / relaxation, 1)
  bool planar;                       ///< r0_z is zero everywhere
  std::int32_t rotation_iterations;

  // State and scratch, per lane.
  Real* xs;        ///< x*, the unknown positions
  Real* q;         ///< cluster rotations q_WB, [cluster][xyzw][lane], warm start of the next call
  Real* goal;      ///< [cluster][c, R row-major, weight = 13][lane] for the skin, or null
  Real* goal_sum;  ///< [particle][sum of goals, sum of weights = 4][lane], within match_clusters
  Real* plastic_rest;              ///< r0 per lane [membership][xyz][lane], or null
  const std::uint32_t* held_mask;  ///< per particle: lanes in which the grasp holds it
  // Particles that may reach a shape in the control step, ascending: [shape][particles], and after
  // the last shape those that may reach any.
  const std::int32_t* near;
  const std::int32_t* near_count;
  const Real* pair_sum;  ///< [particle][dx dy dz count][lane] of links and self-contacts, or null

  // Parameters of the call.
  Real h;
  Real max_speed;
  Real plastic_threshold;
  Real plastic_creep;
  AfterMatch after;

  LaneEffectArgs<Real> effects;  ///< adhesion
  const Real* bond_gain;  ///< [lane]: h^2 over the mass per area: way in a substep per Pa [m/Pa]

  Real* held_force;  ///< [xyz][lane]: adds the corrections of held particles [m], or null
};

/// One implementation of the cluster kernel: same source, different width.
template <typename T>
struct ClusterKernel {
  using Real = T;
  int lanes;
  void (*predict)(const ClusterArgs<Real>&);
  /// What sticks is pulled from where it was predicted towards where it first touched.
  void (*pull_bonds)(const ClusterArgs<Real>&);
  /// One iteration: match, correction, contact; then what `after` says.
  void (*match_clusters)(const ClusterArgs<Real>&);
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
