#pragma once

#include <array>

#include "proto/scene.pb.h"
#include "sim_worker/reference/pack.h"

namespace omentum {

/// Lame constants of a material at small strain [Pa].
struct Lame {
  double mu = 0, lambda = 0;
};

/// mu = E / (2 (1 + nu)), lambda = E nu / ((1 + nu)(1 - 2 nu)); nu below 0.5.
Lame make_lame(double young_modulus, double poisson_ratio);

/// Response of a law to a deformation gradient. Matrices are row-major 3 x 3 [row i, column J].
template <typename T>
struct ElasticResponse {
  T energy{};                   ///< Psi per rest volume [J/m^3]
  std::array<T, 9> stress{};    ///< first Piola-Kirchhoff stress P = dPsi/dF [Pa]
  std::array<T, 81> tangent{};  ///< dP_iJ / dF_kL at [9 (3 i + J) + 3 k + L], symmetric [Pa]
};

/// Hyperelastic laws in three dimensions, equal at small strain (docs/tissue.md 6, 13), at the
/// deformation gradient F. `tangent` is left alone unless wanted.
///
///   neo-Hooke             Psi = mu/2 (tr F^T F - 3 - 2 ln J) + lambda/2 (ln J)^2,   J = det F
///                         (Simo and Pister; coupled form: its volumetric energy is
///                         lambda/2 (ln J)^2 - mu ln J, not the (J - 1)^2 of CalculiX)
///   corotated             Psi = mu |F - R|^2 + lambda/2 tr(S - I)^2,   F = R S
///   St. Venant-Kirchhoff  Psi = mu |E|^2 + lambda/2 (tr E)^2,   E = (F^T F - I) / 2
///
/// An inverted element (J <= 0) gives NaN with neo-Hooke; the others accept it.
template <typename T>
void elastic_response(pb::ElasticLaw law, const std::array<T, 9>& F, T mu, T lambda,
                      bool want_tangent, ElasticResponse<T>& out);

extern template void elastic_response(pb::ElasticLaw, const std::array<double, 9>&, double, double,
                                      bool, ElasticResponse<double>&);
extern template void elastic_response(pb::ElasticLaw, const std::array<Pack, 9>&, Pack, Pack, bool,
                                      ElasticResponse<Pack>&);

}  // namespace omentum
