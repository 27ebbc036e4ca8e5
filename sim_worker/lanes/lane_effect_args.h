#pragma once

#include <cstdint>

namespace omentum {

/// What the lane kernels of shell and solid know of effects that both have (docs/mismatch.md 1):
/// masks of the lanes in which each is on, parameters and memory per lane, lane index fastest. An
/// element is what has a stress of its own, with 3 components in a shell and 6 in a solid. A lane
/// in which an effect is off keeps its bits whatever the others do.
template <typename Real>
struct LaneEffectArgs {
  // In the material. Each model says what its stress and energy are relative to.
  std::uint32_t stiffening, softening, fibres, prony, slider;
  std::int32_t branches;         ///< most Prony branches of any lane
  const Real* density;           ///< 1 + change
  const Real* stiffening_scale;  ///< c2
  const Real* softening_share;   ///< of the stress
  const Real* softening_energy;  ///< m
  const Real* fibre;             ///< Ef
  const Real* fibre_axes;        ///< [xx, yy, xy][lane] of a (x) a
  const Real* prony_gains;       ///< sum of the gains
  const Real* prony_keep;        ///< [branch][lane]
  const Real* prony_gain;        ///< [branch][lane]
  const Real* slider_scale;      ///< Ep
  const Real* slider_yield;      ///< strain
  Real* stress;                  ///< [element][..][lane]: elastic, at the end of the last substep
  Real* branch;                  ///< [branch][element][..][lane]
  Real* bias;                    ///< [element][..][lane]: what the branches add in the next substep
  Real* plastic;                 ///< [element][..][lane]: strain at which the slider sits
  Real* energy_peak;  ///< [triangle or tetrahedron][lane]: largest energy per volume so far

  // On nodes.
  std::uint32_t bonds;     ///< cohesive springs: adhesion or anchors
  std::uint32_t adhesion;  ///< lanes whose nodes bond on touch
  std::uint32_t lubrication, drag;
  const std::uint8_t* is_anchor;  ///< per node: held by anchor springs
  const Real* anchor_limit;       ///< [m]
  const Real* adhesion_scale;     ///< [Pa/m]
  const Real* adhesion_limit;     ///< [m]
  const Real* lubrication_scale;  ///< [Pa s/m] / substep
  const Real* lubrication_reach;  ///< [m]
  const Real* drag_scale;         ///< Cd rho / 2 [kg/m^3]
  Real* bond_place;               ///< [node][xyz][lane]: where the spring is fixed in W [m]
  Real* bond_longest;             ///< [node][lane]: longest stretch so far [m], -1 = no spring
  Real* lubrication_now;     ///< scratch [node][lane]: drag over step at the substep's start [N/m]
  Real* lubrication_normal;  ///< scratch [node][xyz][lane]
};

}  // namespace omentum
