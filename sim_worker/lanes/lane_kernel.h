#pragma once

#include <cstdint>
#include <type_traits>

#include "sim_worker/lanes/panel_solve.h"

namespace omentum {

// Raw arguments of the kernel: plain pointers and numbers only, since the AVX-512 translation unit
// includes this file and must not emit shared inline code. Arrays "per lane" have the lane index
// fastest: vectors of points are [index][xyz][lane]. All positions in W [m].

enum class ShapeKind : std::int32_t { kSphere, kEllipsoid, kBox, kHalfSpace, kSdf, kCapsule };

/// A rigid contact shape. The capsule is the tool: foot and direction of its axis are arguments of
/// the kernels, per lane.
template <typename Real>
struct KernelShape {
  ShapeKind kind;
  Real rotation[9];   ///< R_SW row-major: W to shape frame
  Real origin[3];     ///< p_WS
  Real size[3];       ///< radius, semi-axes or half extents
  Real length;        ///< capsule
  Real bound_radius;  ///< of the bounding sphere around origin; not of half-space and capsule
  const float* sdf;   ///< kSdf: node values, x fastest
  std::int32_t sdf_count[3];
  Real sdf_origin[3];  ///< in the shape frame
  Real sdf_pitch;
};

inline constexpr int kMaxShapes = 12;

/// Search for the points that a rigid shape may touch within a control step.
template <typename Real>
struct CandidateArgs {
  std::int32_t points;
  const Real* x;                   ///< at the step's start
  const Real* v;                   ///< [m/s]
  const std::uint32_t* free_mask;  ///< per point: lanes in which it can collide
  const Real* gravity;             ///< [xyz][lane] [m/s^2]
  const Real* radius;              ///< [lane]: collision distance of a point [m]
  Real step_s;                     ///< control step [s]
  Real margin;                     ///< displacement by elastic forces at most [m]
  std::int32_t shapes;
  const KernelShape<Real>* shape;
  const Real* capsule;           ///< [foot, direction][xyz][lane] of the tool's axis
  const Real* capsule_sweep;     ///< [lane] longest way of a point of it in the whole step
  std::uint32_t* candidates;     ///< out [point][shape] lane masks
  std::uint32_t* candidate_any;  ///< out per point, bit per shape
};

/// Projection of the drawn surface into the exposure camera.
template <typename Real>
struct ProjectArgs {
  std::int32_t vertices;
  const Real* position;  ///< [vertex][xyz][lane]
  Real rotation[9];      ///< R_CW row-major
  Real origin[3];        ///< p_WC
  Real* projected;       ///< out [vertex][u v depth][lane]; u, v in the tangent plane
};

/// Skinning of surface vertices by the cluster transforms of the last match.
template <typename Real>
struct SkinArgs {
  std::int32_t vertices;
  const std::int32_t* cluster;  ///< 4 per vertex
  const Real* weight;           ///< 4 per vertex, sum 1
  const Real* offset;           ///< [vertex][4][xyz]: from the cluster's mean at rest, in B
  const Real* goal;             ///< of ClusterArgs
  const Real* cluster_weight;
  Real* position;  ///< out [vertex][xyz][lane]
};

/// Search for the particle nearest to a point.
template <typename Real>
struct NearestArgs {
  std::int32_t particles;
  const Real* x;
  const Real* point;  ///< [xyz][lane]
  Real* distance2;    ///< out [lane]
  Real* index;        ///< out [lane], exact integer
};

/// One implementation of the lane kernel: same source, different width.
template <typename T>
struct LaneKernel {
  using Real = T;
  int lanes;
  const char* name;
  void (*find_candidates)(const CandidateArgs<Real>&);
  void (*nearest_particle)(const NearestArgs<Real>&);
  void (*skin_surface)(const SkinArgs<Real>&);
  void (*project_surface)(const ProjectArgs<Real>&);
  /// b <- (L L^T)^-1 b, b [row][xyz][lane] or [row][lane].
  void (*solve_vectors)(const PanelArgs<Real>&, Real* b);
  void (*solve_scalars)(const PanelArgs<Real>&, Real* b);
};

/// The kernel of a kind (LaneKernel<float>, ShellKernel<double>, ...) of a width: 1, 8 or 16 lanes
/// of float, 1 of double. Specialised in the one source of the kind, which is compiled once per
/// width. Those of 16 lanes may only be called on a CPU with AVX-512.
template <typename Kernel, int kWidth>
const Kernel& kernel_of();

/// The same for a width known at run time.
template <typename Kernel>
const Kernel& kernel_of(int width) {
  if constexpr (std::is_same_v<typename Kernel::Real, float>) {
    if (width == 16) return kernel_of<Kernel, 16>();
    if (width == 8) return kernel_of<Kernel, 8>();
  }
  return kernel_of<Kernel, 1>();
}

template <>
const LaneKernel<float>& kernel_of<LaneKernel<float>, 1>();
template <>
const LaneKernel<float>& kernel_of<LaneKernel<float>, 8>();
template <>
const LaneKernel<float>& kernel_of<LaneKernel<float>, 16>();
template <>
const LaneKernel<double>& kernel_of<LaneKernel<double>, 1>();

/// The lane kernels by name.
inline const LaneKernel<float>& f32x1() { return kernel_of<LaneKernel<float>, 1>(); }
inline const LaneKernel<float>& f32x8() { return kernel_of<LaneKernel<float>, 8>(); }
inline const LaneKernel<float>& f32x16() { return kernel_of<LaneKernel<float>, 16>(); }
inline const LaneKernel<double>& f64x1() { return kernel_of<LaneKernel<double>, 1>(); }

}  // namespace omentum
