#pragma once

#include <cstdint>

#include "sim_worker/lanes/lane_args.h"
#include "sim_worker/shell/shell_effects.h"

namespace omentum {

/// Raw arguments of the lane kernel of the elastic shell (docs/tissue.md 6, 7, 8, 9). Like
/// lane_kernel.h: plain pointers and numbers only, lane index fastest, node vectors are
/// [node][xyz][lane], all positions in W [m]. Nodes form a grid, index = count_y ix + iy, or a
/// mesh.

/// Rows of a grasp: mean position, mean slope along x_B, along y_B (SheetPatch).
inline constexpr int kPatchRows = 3;

/// Of elasticity, all in plane stress (shell_laws.inl).
enum class ShellLaw : std::int32_t { kCorotated, kNeoHooke, kStVenant };

/// A triangle of a mesh at rest: its edges 1 - 0 and 2 - 0 times `inverse` give the legs of a right
/// triangle of legs one pitch long, in the frame of the material.
template <typename Real>
struct MeshTriangle {
  std::int32_t node[3];
  Real inverse[4];  ///< xx, xy, yx, yy: leg x = xx edge 1 + yx edge 2
};

/// The normal of a stencil is the cross product of its tangents over its length, 1 at rest, or over
/// this where a fold has brought it below: its direction is ill-conditioned there.
inline constexpr double kLeastNormal = 0.1;

/// A stencil of the plate (plate_stencils.h): curvatures xx, yy, xy from the places of its nodes
/// relative to `base`.
template <typename Real>
struct BendStencil {
  std::int32_t base;
  std::int32_t entry_begin, entry_end;  ///< in ShellArgs::bend_entry
  Real stiffness[4];  ///< moments per curvature xx, yy, xx by yy, xy, times the area [N m^3]
};

/// Another node of a stencil.
template <typename Real>
struct BendEntry {
  std::int32_t node;
  Real weight[5];  ///< of the second derivatives xx, yy, xy [1/m^2] and the tangents x, y [1/m]
};

/// A deformable surface: one more contact shape, whose number is ShellArgs::shapes. Its near
/// points are found by the host (soft_contact.h), one per node and lane.
template <typename Real>
struct SurfaceArgs {
  bool active;
  const Real* plane;   ///< [node][distance of x + d, normal xyz][lane] [m]
  const Real* motion;  ///< [node][xyz][lane]: of the near point in this substep [m]
  Real* force;         ///< [node][xyz][lane]: part of contact_force that acts on it [N]
  Real* force_before;  ///< scratch: before the change
  const Real* work;    ///< [lane]: of the change on the surface's response to it [N m]
  Real* step_length;   ///< [lane] out: along the direction, in [0, 1]
  // The direction of the pass before, for conjugate ones (shell_contact.inl).
  bool follows;          ///< there was a pass before in this substep
  const Real* cross;     ///< [lane]: work of the change on the surface's response to the direction
  Real* beta;            ///< [lane] out: coefficient of the last direction in the new one
  Real* direction;       ///< [node][xyz][lane]: change of contact_force [N]
  Real* direction_part;  ///< [node][xyz][lane]: and of `force`
  Real* direction_displacement;  ///< [node][xyz][lane]: minus the sheet's response to it [m]
  Real* direction_work;          ///< [lane]: of the direction on the response of both [N m]
};

template <typename Real>
struct ShellArgs : ImplicitArgs<Real> {
  // Mesh, shared by all lanes.
  std::int32_t count_x, count_y;  ///< of a grid
  std::int32_t triangles;
  const MeshTriangle<Real>* mesh;    ///< per triangle; null = the grid
  const std::uint8_t* fixed;         ///< per node, 1 = anchored
  const Real* mass;                  ///< per node [kg]
  const BendStencil<Real>* stencil;  ///< the first ones are those of the nodes
  std::int32_t stencils;
  const BendEntry<Real>* bend_entry;
  ShellLaw law;
  bool at_start;  ///< d is still the inertial displacement
  bool has_contact;

  std::uint32_t lanes;  ///< which lanes a call may change

  // Grasp, per lane: rows over nodes, sum_k weight x_node = target. Those of lanes that hold less
  // nodes or nothing are zero.
  std::int32_t patch_size;         ///< most nodes of any lane
  std::int32_t patch_room;         ///< nodes that the arrays have room for
  const std::int32_t* patch_node;  ///< [patch_room][lane]
  const Real* patch_weight;        ///< [patch_room][row][lane]
  const Real* patch_tip;           ///< [xyz][lane], in W [m]
  const Real* patch_offset;        ///< [row][xyz][lane]: targets, the mean from the tip on [m]
  const Real* patch_compliance;    ///< [lane] of the jaws [m/N]
  const Real* patch_inverse;       ///< (C A^-1 C^T + c)^-1 [row][row][lane] [N/m]
  const Real* patch_response;      ///< A^-1 C^T [node][row][lane] [m/N]
  Real* patch_force;               ///< lambda [row][xyz][lane] [N]

  // Contact: planes of nodes and shapes that may touch in some lane, by nodes.
  const std::int32_t* plane_begin;  ///< per node, nodes + 1
  const std::int32_t* plane_shape;
  Real* plane;  ///< scratch [plane][depth of x + d, normal xyz][lane] [m]
  const std::int32_t* preconditioner_begin;   ///< per node, nodes + 1: row of `preconditioner`
  const std::int32_t* preconditioner_middle;  ///< per node: where nodes after it begin in its row
  const std::int32_t* preconditioner_node;    ///< ascending
  const Real* preconditioner;                 ///< off-diagonal of A at nominal E [N/m]
  const Real* key_stiffness;                  ///< per lane: E of its factor / nominal E
  const Real* own_stiffness;                  ///< diagonal of A [node][lane] [N/m]
  const Real* own_compliance;                 ///< 1 / own_stiffness [m/N]
  std::uint32_t* contact_lanes;  ///< per node: lanes in which it may touch in this control step
  Real* contact_motion;          ///< scratch [node][xyz][lane]: e [m]
  Real* contact_before_sum;      ///< scratch, of the same: what the nodes before it sum to
  Real* contact_face;  ///< scratch [node][xyz][lane]: displacement of the face relative to its node
                       ///< [m]
  Real* contact_displacement;  ///< scratch [node][xyz][lane]: onto the deepest plane, without slip
                               ///< [m]
  Real* contact_before;        ///< scratch [node][xyz][lane]: forces before the change [N]
  Real contact_tolerance;      ///< change of a force per mass that counts as settled [N/kg]

  SurfaceArgs<Real> surface;
  ShellEffectArgs<Real> effects;
};

/// One implementation of the elastic kernel: same source, different width. ShellTissue::step
/// calls them in the order of docs/tissue.md 7.
template <typename T>
struct ShellKernel {
  using Real = T;
  int lanes;
  void (*start_substep)(const ShellArgs<Real>&);
  void (*find_residual)(const ShellArgs<Real>&);
  void (*subtract_solution)(const ShellArgs<Real>&);
  void (*hold_patch)(const ShellArgs<Real>&);
  void (*place_contacts)(const ShellArgs<Real>&);
  /// Parts of the contact solver for the lanes of args.lanes; they return lanes.
  std::uint32_t (*unsettled_contacts)(const ShellArgs<Real>&);
  std::uint32_t (*sweep_contacts)(const ShellArgs<Real>&, int sweep);
  void (*load_contact_change)(const ShellArgs<Real>&);
  void (*take_contact_change)(const ShellArgs<Real>&);
  void (*take_surface_change)(const ShellArgs<Real>&);
  void (*drop_far_contacts)(const ShellArgs<Real>&);
  void (*remember_effects)(const ShellArgs<Real>&);
  /// Rounds of the solve with springs (shell_effects.inl).
  void (*start_springs)(const ShellArgs<Real>&);
  void (*take_response)(const ShellArgs<Real>&);
  void (*advance_springs)(const ShellArgs<Real>&, bool first);
  void (*load_solution)(const ShellArgs<Real>&);
  void (*finish_substep)(const ShellArgs<Real>&);
};

template <>
const ShellKernel<float>& kernel_of<ShellKernel<float>, 1>();
template <>
const ShellKernel<float>& kernel_of<ShellKernel<float>, 8>();
template <>
const ShellKernel<float>& kernel_of<ShellKernel<float>, 16>();
template <>
const ShellKernel<double>& kernel_of<ShellKernel<double>, 1>();

}  // namespace omentum
