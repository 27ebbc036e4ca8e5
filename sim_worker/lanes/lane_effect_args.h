#pragma once

#include <cstdint>

namespace omentum {

/// Arguments of the effects that the kernels of shell and solid have in common (docs/mismatch.md
/// 1): masks of the lanes in which each is on, parameters and memory per lane, lane index fastest.
/// An element is a quadrature point of stress, of 3 components in a shell and 6 in a solid. A lane
/// in which an effect is off has the bits it has without it.
template <typename Real>
struct LaneEffectArgs {
  // In the material; units of stress and energy are each model's own.
  std::uint32_t stiffening, softening, fibres, prony, slider;
  std::int32_t branches;          ///< Prony branches, the most of any lane
  const Real* density;            ///< 1 + change
  const Real* stiffening_scale;   ///< c2
  std::uint32_t exponential;      ///< of `stiffening` those whose law is exponential, too
  const Real* exponential_scale;  ///< stress per strain at e^x - 1 = 1
  const Real* exponential_rate;   ///< b
  const Real* softening_share;    ///< fraction of the stress lost at most
  const Real* softening_energy;   ///< m
  const Real* fibre;              ///< Ef
  const Real* fibre_axes;         ///< [xx, yy, xy][lane] of a (x) a
  const Real* prony_gains;        ///< sum of the gains
  const Real* prony_keep;         ///< [branch][lane]
  const Real* prony_gain;         ///< [branch][lane]
  const Real* slider_scale;       ///< Ep
  const Real* slider_yield;       ///< strain
  Real* stress;                   ///< [element][..][lane]: elastic, at the end of the last substep
  Real* branch;                   ///< [branch][element][..][lane]: stress of the Prony branches
  Real* bias;         ///< [element][..][lane]: history term of the branches in the next substep
  Real* plastic;      ///< [element][..][lane]: plastic strain of the slider
  Real* energy_peak;  ///< [triangle or tetrahedron][lane]: largest energy per volume so far

  // On nodes.
  std::uint32_t bonds;     ///< cohesive springs: adhesion or anchors
  std::uint32_t adhesion;  ///< lanes whose nodes bond on touch
  std::uint32_t lubrication, drag;
  const std::uint8_t* is_anchor;  ///< per node: held by anchor springs
  const Real* anchor_limit;       ///< [m]
  const Real* adhesion_scale;     ///< [Pa/m]
  const Real* adhesion_limit;     ///< [m]
  const Real* adhesion_part;      ///< [node][lane]: share of it that sticks; null = all of all
  const Real* lubrication_scale;  ///< [Pa s/m] / substep
  const Real* lubrication_reach;  ///< [m]
  const Real* drag_scale;         ///< Cd rho / 2 [kg/m^3]
  Real* bond_place;               ///< [node][xyz][lane]: fixed end of the spring in W [m]
  Real* bond_longest;             ///< [node][lane]: longest stretch so far [m], -1 = no spring
  // A force on a disc of the body (local_force).
  std::uint32_t pull;
  const std::int32_t* pull_node;  ///< nodes that have a share of it in some lane
  std::int32_t pull_nodes;
  const std::int32_t* pull_index;  ///< per node: its entry in pull_node, -1 = none
  const Real* pull_share;          ///< [of pull_node][lane]
  const Real* pull_place;  ///< [of pull_node][xyz][lane]: where its string is made fast, in W [m]
  const Real* pull_stiffness;  ///< [N/m]
  const Real* pull_slack;      ///< [m]
  const Real* pull_damper;     ///< over the step [N/m]
  const Real* push;            ///< [xyz][lane] [N]
  const Real* push_keep;       ///< what a substep leaves of the push
  Real* push_left;             ///< [lane]: share of the push that is left, at the substep's end
  const Real* added_mass;      ///< per node, null = none: beside that of the body [kg]
  Real* lubrication_now;       ///< scratch [node][lane]: damping over step, of the substep [N/m]
  Real* lubrication_normal;    ///< scratch [node][xyz][lane]
};

}  // namespace omentum
