#pragma once

#include <cstdint>

namespace omentum {

/// What the lane kernel of the elastic solid knows of effects (mismatch.md 5.1): parameters and
/// memory per lane, and masks of the lanes in which an effect is on that needs more than a number.
/// Lane index fastest, as in SolidArgs; point = 4 tetrahedron + integration point; tensors are
/// symmetric, [xx, yy, zz, yz, xz, xy] in B. A lane in which an effect is off keeps its bits
/// whatever the others do.
template <typename Real>
struct SolidEffectArgs {
  // Parameters, [lane].
  const Real* mu;      ///< stable neo-Hooke [Pa]
  const Real* lambda;  ///< [Pa]
  const Real* alpha;
  const Real* bulk;     ///< the part of lambda that acts on the mean of an element [Pa]
  const Real* density;  ///< 1 + change

  /// [point][lane]: stiffness there over that of the lane; null = 1.
  const Real* map;

  // Effects in the material, stresses [Pa] at the nominal stiffness.
  std::uint32_t material;  ///< lanes in which one of these is on
  std::uint32_t stiffening, softening, fibres, prony, slider;
  const Real* stiffening_scale;  ///< c2 [Pa]
  const Real* softening_share;   ///< of the stress
  const Real* softening_energy;  ///< m [Pa]
  const Real* fibre;             ///< Ef [Pa]
  const Real* fibre_axes;        ///< [xx, yy, xy][lane] of a (x) a
  std::int32_t branches;         ///< most Prony branches of any lane
  const Real* prony_gains;       ///< sum of the gains
  const Real* prony_keep;        ///< [branch][lane]
  const Real* prony_gain;        ///< [branch][lane]
  const Real* slider_scale;      ///< Ep [Pa]
  const Real* slider_yield;
  Real* stress;       ///< [point][tensor][lane]: elastic, at the end of the last substep
  Real* branch;       ///< [branch][point][tensor][lane]
  Real* bias;         ///< [point][tensor][lane]: what the branches add in the next substep
  Real* plastic;      ///< [point][tensor][lane]: strain at which the slider sits
  Real* energy_peak;  ///< [tetrahedron][lane]: largest energy per volume so far [Pa]

  // Effects on nodes.
  std::uint32_t bonds;     ///< cohesive springs: adhesion or anchors
  std::uint32_t adhesion;  ///< lanes whose nodes bond on touch
  std::uint32_t film, drag;
  const std::uint8_t* is_anchor;  ///< per node: held by anchor springs
  const Real* anchor_limit;       ///< [m]
  const Real* adhesion_scale;     ///< [Pa/m]
  const Real* adhesion_limit;     ///< [m]
  const Real* film_scale;         ///< [Pa s/m] / substep
  const Real* film_reach;         ///< [m]
  const Real* drag_scale;         ///< Cd rho / 2 [kg/m^3]
  const std::int32_t* skin;       ///< 3 nodes of each triangle, counter-clockwise from outside
  std::int32_t skin_triangles;
  Real* bond_place;    ///< [node][xyz][lane]: where the spring is fixed in W [m]
  Real* bond_fresh;    ///< [node][lane]: its stiffness before it was stretched [N/m]
  Real* bond_longest;  ///< [node][lane]: longest stretch so far [m], -1 = no spring
  Real* bond_now;      ///< scratch [node][lane]: stiffness in this substep [N/m]
  Real* area;          ///< scratch [node][xyz][lane]: area of the skin, outwards [m^2]
  Real* film_now;      ///< scratch [node][lane]: drag over step at the substep's start [N/m]
  Real* film_normal;   ///< scratch [node][xyz][lane]
  Real* drag_now;      ///< scratch [node][xyz][lane]: force of the air at the substep's start [N]
};

}  // namespace omentum
