#pragma once

#include <cstdint>

#include "sim_worker/lanes/lane_effect_args.h"

namespace omentum {

/// Effects in the lane kernel of the elastic shell. Stresses are relative to 2 mu, energies per
/// volume to 2 mu as well. Triangles of a grid are numbered 2 cell + (0 low, 1 high), cell =
/// (count_y - 1) ix + iy; in a mesh a cell is a triangle. Tensors are [xx, xy, yy].
template <typename Real>
struct ShellEffectArgs : LaneEffectArgs<Real> {
  bool membrane;          ///< some lane needs the general membrane
  std::uint32_t springs;  ///< lanes that now hang on springs stiffer than the preconditioner knows

  // Maps; null = as the model's own.
  const Real* mass;   ///< [node][lane], without density [kg]
  const Real* plate;  ///< [stencil][as BendStencil::stiffness][lane]
  const Real* cell;   ///< [cell][shear, area][lane] [N/m]

  // Parameters, [lane].
  const Real* shear;           ///< 2 mu t / 2 [N/m]
  const Real* area;            ///< lambda t / 2 [N/m]
  const Real* inverse_pitch2;  ///< of the stretched rest shape [1/m^2]
  const Real* lateral;         ///< nu / (1 - nu): thickness strain of plane stress
  const Real* rest_moment;  ///< [stencil][xx, yy, xy][lane] of the rest curvature, times the area
                            ///< [N m^2]; null = flat at rest in every lane
  const Real* node_area;    ///< per node [m^2]
  const Real* anchor;       ///< [node][lane] fresh spring of the anchor [N/m]
  /// [node][lane]: how much more stiffly than by their springs a node and the next one are held
  /// against being moved apart (ShellTissueModel::make_anchor_turn) [N/m]; null = nowhere.
  const Real* anchor_turn;

  // Memory of bending.
  Real* moment;         ///< [stencil][xx, yy, xy][lane]: elastic, at the end of the last substep
  Real* moment_branch;  ///< [branch][stencil][xx, yy, xy][lane]
  Real* moment_bias;    ///< [stencil][..][lane]: what the branches add in the next substep
  Real* peak;           ///< [lane]: largest tangent over nominal stiffness in this substep

  // Scratch of the solve with springs, [node][xyz][lane] and [lane].
  Real *rest, *direction, *preconditioner_direction, *solution, *response, *last_product;
};

}  // namespace omentum
