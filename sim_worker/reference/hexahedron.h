#pragma once

#include <array>

#include "sim_worker/reference/hyperelastic_law.h"
#include "sim_worker/tissue/effect_catalogue.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {

/// Brick with eight nodes and enhanced modes, four bricks at a time. At rest it is a box of edge
/// lengths `size`, axes along B.
///
///   node a = ix + 2 iy + 4 iz, each 0 or 1 along its axis; local coordinates xi in [-1, 1]^3
///   F(xi) = sum_a x_a (grad N_a(xi))^T + F0 G(xi),   G_iJ = xi_i (2 / size_J) m_iJ
///
/// F0 is the deformation gradient in the middle. The nine modes m_iJ (internal to the element,
/// without mass, the same in every frame of reference) let the strains vary as bending needs: no
/// shear locking and, in thickness direction, no Poisson locking, so one element through a thin
/// sheet is enough. They integrate to zero over the box, so every constant strain is exact (patch
/// test). At small strain they are the incompatible modes of Wilson; at large strain they are the
/// transpose of those (Q1/ET9 [GlaserArmero97]): they take the parasitic shear away instead
/// of turning it into a rotation, whose geometric stiffness makes Q1/E9 give way under compression
/// (docs/decisions/0028). Quadrature 2 x 2 x 2 Gauss points.
constexpr int kHexNodes = 8;

inline constexpr int kHexPoints = 8;  ///< Gauss points

/// Symmetric tensor, row-major 3 x 3.
using PackTensor = std::array<Pack, 9>;

/// Rest shape of four bricks other than the box: at each Gauss point the map from gradients with
/// respect to the box to those with respect to the stress-free shape (row vector times map), and
/// the volume relative to the box.
struct HexRest {
  std::array<std::array<Pack, 9>, kHexPoints> map;
  std::array<Pack, kHexPoints> volume;
};

/// Memory of the effects (effect_catalogue.h) in four bricks, per Gauss point; stresses are second
/// Piola-Kirchhoff stresses [Pa].
struct HexMemory {
  std::array<PackTensor, kHexPoints> stress;   ///< elastic, at the end of the last step
  std::array<PackTensor, kHexPoints> bias;     ///< history term of the Prony branches in this step
  std::array<PackTensor, kHexPoints> plastic;  ///< plastic strain of the slider
  std::array<Pack, kHexPoints> energy_peak;    ///< largest energy per volume / mu so far
  std::array<std::array<PackTensor, kHexPoints>, kMaxBranches> branch;
};

/// Effects in the material of four bricks. Moduli are relative to mu.
///
///   stiffening  c2 I^2,  I = 2 E:E                      E = (F^T F - I) / 2
///   exponential (exp(b I) - 1 - b I) / (2 b)
///   fibres      Ef (taut(E4)),  taut' = (E4 + sqrt(E4^2 + w^2) - w) / 2,  E4 = a . E a, w = 1e-3
///   softening   of law and stiffening: stress x eta(W), as in the shell (shell_effects.inl)
///   branches    (1 + gains) x all elastic stress + bias (sim_worker/tissue/effect_catalogue.h)
///   slider      Ep |e|^2 / 2 up to |e| = yield, then Ep yield (|e| - yield / 2);  e = E - plastic
struct HexEffects {
  double stiffening = 0;                       ///< c2
  double exponential = 0;                      ///< b
  double fibre = 0;                            ///< Ef
  std::array<double, 2> axis{1, 0};            ///< of the fibres in x_B, y_B
  double softening = 0, softening_energy = 1;  ///< fraction of the stress lost at most, m
  double gains = 0;
  bool branches = false;
  double slider = 0, yield = 1;  ///< Ep, strain
  const HexRest* rest = nullptr;
  const HexMemory* memory = nullptr;  ///< needed for softening, branches and slider
};

/// Four bricks and where they are.
struct HexShape {
  std::array<Pack, 24> x;    ///< nodes, [node][xyz] [m]
  std::array<Pack, 9> mode;  ///< m, row by row [m]
  std::array<Pack, 3> size;  ///< edge lengths at rest [m]
  Pack mu, lambda;           ///< [Pa]
  /// Factor on the energy at each Gauss point: as many times stiffer there; null = 1.
  const std::array<Pack, kHexPoints>* stiffness = nullptr;
  const HexEffects* effects = nullptr;  ///< null = none
};

/// First derivative of the elastic energy.
struct HexForce {
  Pack energy;                     ///< [J]
  std::array<Pack, 24> force;      ///< d energy / d x, [node][xyz] [N]
  std::array<Pack, 9> mode_force;  ///< d energy / d b [N]
};

/// Static condensation of the modes: with H = L L^T the tangent of b,
/// db = -L^-T (rhs + coupling dx).
struct HexInner {
  std::array<Pack, 45> factor;     ///< L, row by row; the diagonal holds 1 / L_rr
  std::array<Pack, 216> coupling;  ///< L^-1 d2 energy / db dx, [9][24]
  std::array<Pack, 9> rhs;         ///< L^-1 d energy / db
};

/// Second derivative of the energy with b eliminated.
struct HexTangent {
  /// Lower node blocks: block (a, b), a >= b, at 9 (a (a + 1) / 2 + b), row-major 3 x 3 [N/m].
  std::array<Pack, 324> stiffness;
  HexInner inner;
};

/// Response of material and effects at a Gauss point with deformation gradient F
/// (hex_material.cpp).
void point_response(pb::ElasticLaw law, const HexShape& shape, int point, const PackTensor& F,
                    bool want_tangent, ElasticResponse<Pack>& out);
/// Memory of the effects there at the end of a step.
void remember_point(pb::ElasticLaw law, const HexShape& shape, int point, const PackTensor& F,
                    const PronyStep& prony, HexMemory& memory);

void hex_force(pb::ElasticLaw law, const HexShape& shape, HexForce& out);
/// The same, what each Gauss point adds to it.
void hex_point_forces(pb::ElasticLaw law, const HexShape& shape,
                      std::array<HexForce, kHexPoints>& out);
void hex_tangent(pb::ElasticLaw law, const HexShape& shape, HexTangent& out);

/// End of a step: updates the memory of the effects of the shape.
void hex_remember(pb::ElasticLaw law, const HexShape& shape, const PronyStep& prony,
                  HexMemory& memory);

/// Renews `rhs` for another state and the same factor.
void hex_condense(const std::array<Pack, 9>& mode_force, HexInner& inner);
/// Many loads of the modes of one element at once, [9][load]: replaced by L^-1 of them; what they
/// do to the nodes once the modes are eliminated, [24][load].
void hex_condense(const HexInner& inner, int lane, Eigen::Ref<Eigen::MatrixXd> mode_loads,
                  Eigen::MatrixXd& node_loads);

/// Change of the modes for a change of the nodes.
void hex_recover(const HexInner& inner, const std::array<Pack, 24>& dx, std::array<Pack, 9>& dmode);

}  // namespace omentum
