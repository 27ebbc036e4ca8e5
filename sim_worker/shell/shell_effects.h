#pragma once

#include <cstdint>

namespace omentum {

/// What the lane kernel of the elastic shell knows of effects (mismatch.md 5.1): masks of the lanes
/// in which each is on, parameters and memory per lane. Lane index fastest, as in ShellArgs.
/// Triangles of a grid are numbered 2 cell + (0 low, 1 high), cell = (count_y - 1) ix + iy; in a
/// mesh a cell is a triangle. A lane in which an effect is off keeps its bits whatever the others
/// do.
template <typename Real>
struct ShellEffectArgs {
  bool membrane;  ///< some lane needs the general membrane
  std::uint32_t stiffening, softening, fibres, prony, slider, drag;
  std::uint32_t bonds;     ///< cohesive springs: adhesion or anchors
  std::uint32_t adhesion;  ///< lanes whose nodes bond on touch
  std::uint32_t film;
  std::uint32_t springs;  ///< lanes that now hang on springs stiffer than the metric knows
  std::int32_t branches;  ///< most Prony branches of any lane

  // Maps; null = as the model's own.
  const Real* mass;   ///< [node][lane], without density [kg]
  const Real* plate;  ///< [stencil][as BendStencil::stiffness][lane]
  const Real* cell;   ///< [cell][shear, area][lane] [N/m]

  // Parameters, [lane].
  const Real* shear;             ///< 2 mu t / 2 [N/m]
  const Real* area;              ///< lambda t / 2 [N/m]
  const Real* inverse_pitch2;    ///< of the stretched rest shape [1/m^2]
  const Real* density;           ///< 1 + change
  const Real* stiffening_scale;  ///< 4 c2 / mu
  const Real* softening_share;   ///< of the stress
  const Real* softening_energy;  ///< m / (2 mu)
  const Real* lateral;           ///< nu / (1 - nu): thickness strain of plane stress
  const Real* fibre;             ///< Ef / (2 mu)
  const Real* fibre_axes;        ///< [xx, xy, yy][lane] of a (x) a
  const Real* prony_gains;       ///< sum of the gains
  const Real* prony_keep;        ///< [branch][lane]
  const Real* prony_gain;        ///< [branch][lane]
  const Real* slider_scale;      ///< Ep / (2 mu)
  const Real* slider_yield;
  const Real* rest_moment;  ///< [stencil][xx, yy, xy][lane] of the rest curvature, times the area
                            ///< [N m^2]; null = flat at rest in every lane
  const Real* drag_scale;   ///< Cd rho / 2 [kg/m^3]
  const Real* adhesion_scale;  ///< [Pa/m]
  const Real* adhesion_limit;  ///< [m]
  const Real* anchor_limit;    ///< [m]
  const Real* film_scale;      ///< [Pa s/m] / substep
  const Real* film_reach;      ///< [m]

  const Real* node_area;          ///< per node [m^2]
  const std::uint8_t* is_anchor;  ///< per node: held by anchor springs
  const Real* anchor;             ///< [node][lane] fresh spring [N/m]

  // Memory.
  Real* stress;         ///< [triangle][xx, xy, yy][lane]: elastic, at the end of the last substep
  Real* branch;         ///< [branch][triangle][xx, xy, yy][lane]
  Real* bias;           ///< [triangle][..][lane]: what the branches add in the next substep
  Real* plastic;        ///< [triangle][..][lane]: strain at which the slider sits
  Real* energy_peak;    ///< [triangle][lane]: largest energy per volume / (2 mu) so far
  Real* moment;         ///< [stencil][xx, yy, xy][lane]: elastic, at the end of the last substep
  Real* moment_branch;  ///< [branch][stencil][xx, yy, xy][lane]
  Real* moment_bias;    ///< [stencil][..][lane]: what the branches add in the next substep
  Real* bond_place;     ///< [node][xyz][lane]: where the spring is fixed in W [m]
  Real* bond_longest;   ///< [node][lane]: longest stretch so far [m], -1 = no spring
  Real* film_now;       ///< scratch [node][lane]: drag over step at the start of the substep [N/m]
  Real* film_normal;    ///< scratch [node][xyz][lane]
  Real* peak;           ///< [lane]: largest tangent over nominal stiffness in this substep

  // Scratch of the solve with springs, [node][xyz][lane] and [lane].
  Real *rest, *direction, *metric_direction, *solution, *answer, *last_product;
};

}  // namespace omentum
