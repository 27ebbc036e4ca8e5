#pragma once

#include <cstdint>

namespace omentum {

/// Raw arguments of the lane kernel. Plain pointers and numbers only: the AVX-512 translation unit
/// includes this file and must not emit shared inline code. Arrays "per lane" have the lane index
/// fastest: particle vectors are [index][xyz][lane]. All positions in W [m].

enum class ShapeKind : std::int32_t { kSphere, kEllipsoid, kBox, kHalfSpace, kSdf, kCapsule };

/// A rigid contact shape. The capsule is the tool: its axis starts at `capsule_from/to` of the step
/// (per lane).
template <typename Real>
struct KernelShape {
  ShapeKind kind;
  Real rotation[9];   ///< R_SW row-major: W to shape frame
  Real origin[3];     ///< p_WS
  Real size[3];       ///< radius, semi-axes or half extents
  Real axis[3];       ///< capsule: direction in W
  Real length;        ///< capsule
  Real bound_radius;  ///< sphere around origin that holds the shape; ignored by half-space and
                      ///< capsule
  const float* sdf;   ///< kSdf: node values, x fastest
  std::int32_t sdf_count[3];
  Real sdf_origin[3];  ///< in the shape frame
  Real sdf_pitch;
};

inline constexpr int kMaxShapes = 12;

template <typename Real>
struct KernelArgs {
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
  Real* plastic_rest;              ///< r0 per lane [membership][xyz][lane], or null
  const std::uint32_t* free_mask;  ///< per particle: lanes in which it moves by itself
  const std::uint32_t* held_mask;  ///< per particle: lanes in which the grasp holds it
  std::uint32_t* candidates;       ///< [particle][shape] lane masks
  std::uint32_t* candidate_any;    ///< per particle, bit per shape
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
  Real step_s;  ///< control step, for the candidate margin
  Real margin;  ///< constant part of the candidate margin [m]

  // Contact.
  std::int32_t shapes;
  KernelShape<Real> shape[kMaxShapes];
  const Real* capsule;         ///< [xyz][lane] start of the tool's axis now
  const Real* capsule_motion;  ///< [xyz][lane] its motion in this substep
  const Real* capsule_sweep;   ///< [lane] length of its motion in the whole step

  Real* held_force;  ///< [xyz][lane]: adds the correction the held particles refuse [m]; null = not
                     ///< wanted
};

/// Projection of the drawn surface into the exposure camera and search for triangles near the
/// tumour.
template <typename Real>
struct ProjectArgs {
  std::int32_t vertices;
  const Real* position;  ///< [vertex][xyz][lane]
  Real rotation[9];      ///< R_CW row-major
  Real origin[3];        ///< p_WC
  Real window[4];        ///< u_min, u_max, v_min, v_max of the tumour's image (tangent plane)
  std::int32_t triangles;
  const std::int32_t* triangle;  ///< 3 vertices each
  Real* projected;               ///< [vertex][u v depth][lane]
  std::uint32_t* overlap;        ///< per triangle: lanes whose bounding box meets the window
  std::uint32_t lanes_wanted;
};

/// Skins surface vertices to cluster transforms left by the last match.
template <typename Real>
struct SkinArgs {
  std::int32_t vertices;
  const std::int32_t* cluster;  ///< 4 per vertex
  const Real* weight;           ///< 4 per vertex, sum 1
  const Real*
      offset;  ///< [vertex][4][xyz]: rest position relative to the cluster's rest mean, in B
  const Real* goal;
  const Real* cluster_weight;
  Real* position;  ///< out [vertex][xyz][lane]
};

template <typename Real>
struct NearestArgs {
  std::int32_t particles;
  const Real* x;
  const Real* point;  ///< [xyz][lane]
  Real* distance2;    ///< out [lane]
  Real* index;        ///< out [lane], exact integer
};

/// One implementation of the lane kernel: same source, different width. Every function is straight
/// line code over particles or clusters; Tissue::step calls them in the order of tissue.md
/// section 4.
template <typename Real>
struct Kernel {
  int lanes;
  const char* name;
  void (*find_candidates)(const KernelArgs<Real>&);
  void (*predict)(const KernelArgs<Real>&);
  void (*match_clusters)(const KernelArgs<Real>&);
  void (*apply_corrections)(const KernelArgs<Real>&);
  void (*finish_substep)(const KernelArgs<Real>&);
  void (*nearest_particle)(const NearestArgs<Real>&);
  void (*skin_surface)(const SkinArgs<Real>&);
  void (*project_surface)(const ProjectArgs<Real>&);
};

/// Kernels by name. The 16-lane one may only be called when cpu_has_avx512().
extern const Kernel<float> kKernelF32x1;
extern const Kernel<float> kKernelF32x8;
extern const Kernel<float> kKernelF32x16;
extern const Kernel<double> kKernelF64x1;

}  // namespace omentum
