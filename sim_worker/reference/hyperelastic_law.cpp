#include "sim_worker/reference/hyperelastic_law.h"

#include "core/check.h"
#include "sim_worker/reference/tensor.h"

namespace omentum {
namespace {

/// Rotation of the polar decomposition by Newton's iteration R <- (R + R^-T) / 2 (Higham 1986).
/// Twelve steps reach rounding for principal stretches of 1/50 ... 50.
template <typename T>
Tensor<T> polar_rotation(const Tensor<T>& F) {
  constexpr int kSteps = 12;
  Tensor<T> R = F;
  for (int step = 0; step < kSteps; ++step) {
    const Tensor<T> c = cofactor(R);
    const T scale = T(0.5) / determinant(R, c);
    for (int k = 0; k < 9; ++k) R[k] = fma(scale, c[k], T(0.5) * R[k]);
  }
  return R;
}

template <typename T>
void neo_hooke(const Tensor<T>& F, T mu, T lambda, bool want_tangent, ElasticResponse<T>& out) {
  Tensor<T> G = cofactor(F);  // becomes F^-T
  const T J = determinant(F, G);
  for (T& g : G) g = g / J;
  const T log_j = logarithm(J);
  out.energy = T(0.5) * (mu * (dot(F, F) - T(3.0) - T(2.0) * log_j) + lambda * log_j * log_j);
  const T pressure = lambda * log_j - mu;
  for (int k = 0; k < 9; ++k) out.stress[k] = fma(mu, F[k], pressure * G[k]);
  if (!want_tangent) return;
  // d(F^-T)_iJ = -G_iL G_kJ dF_kL and d ln J = G_kL dF_kL.
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      T* row = &out.tangent[9 * (3 * i + j)];
      for (int k = 0; k < 3; ++k) {
        for (int l = 0; l < 3; ++l) {
          row[3 * k + l] =
              lambda * G[3 * i + j] * G[3 * k + l] - pressure * G[3 * i + l] * G[3 * k + j];
        }
      }
      row[3 * i + j] = row[3 * i + j] + mu;
    }
  }
}

// With Q = R^T dF the rotation changes by dR = R [w]x where (tr(S) I - S) w = axial(Q - Q^T); the
// derivative of tr S = R : F is R, because F : dR = S : [w]x = 0.
template <typename T>
void corotated(const Tensor<T>& F, T mu, T lambda, bool want_tangent, ElasticResponse<T>& out) {
  const Tensor<T> R = polar_rotation(F);
  const Tensor<T> S = product_transposed(R, F);
  const T trace = S[0] + S[4] + S[8];
  const T stretch = trace - T(3.0);
  Tensor<T> D;
  for (int k = 0; k < 9; ++k) D[k] = F[k] - R[k];
  out.energy = fma(mu, dot(D, D), T(0.5) * lambda * stretch * stretch);
  for (int k = 0; k < 9; ++k) out.stress[k] = fma(T(2.0) * mu, D[k], lambda * stretch * R[k]);
  if (!want_tangent) return;
  Tensor<T> B;
  for (int k = 0; k < 9; ++k) B[k] = -S[k];
  for (int k = 0; k < 9; k += 4) B[k] = B[k] + trace;
  Tensor<T> B_inverse = cofactor(B);  // symmetric up to rounding
  const T scale = T(1.0) / determinant(B, B_inverse);
  for (T& b : B_inverse) b = scale * b;
  const T rotation_part = lambda * stretch - T(2.0) * mu;
  for (int k = 0; k < 3; ++k) {
    for (int l = 0; l < 3; ++l) {
      // dF = e_k e_l^T: Q_mn = R_km delta_nl. axial(Q - Q^T)_a = Q_{a+2,a+1} - Q_{a+1,a+2}.
      std::array<T, 3> axial{T(0.0), T(0.0), T(0.0)};
      axial[(l + 2) % 3] = R[3 * k + (l + 1) % 3];
      axial[(l + 1) % 3] = -R[3 * k + (l + 2) % 3];
      std::array<T, 3> w;
      for (int a = 0; a < 3; ++a) {
        w[a] = fma(B_inverse[3 * a], axial[0],
                   fma(B_inverse[3 * a + 1], axial[1], B_inverse[3 * a + 2] * axial[2]));
      }
      // (v [w]x)_j = (v x w)_j with v a row of R.
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
          const int j1 = (j + 1) % 3;
          const int j2 = (j + 2) % 3;
          const T rotation = R[3 * i + j1] * w[j2] - R[3 * i + j2] * w[j1];
          T value = fma(rotation_part, rotation, lambda * R[3 * i + j] * R[3 * k + l]);
          if (i == k && j == l) value = value + T(2.0) * mu;
          out.tangent[9 * (3 * i + j) + 3 * k + l] = value;
        }
      }
    }
  }
}

template <typename T>
void st_venant_kirchhoff(const Tensor<T>& F, T mu, T lambda, bool want_tangent,
                         ElasticResponse<T>& out) {
  const Tensor<T> E = green_strain(F);
  const T trace = E[0] + E[4] + E[8];
  out.energy = fma(mu, dot(E, E), T(0.5) * lambda * trace * trace);
  Tensor<T> S;  // second Piola-Kirchhoff stress
  for (int k = 0; k < 9; ++k) S[k] = T(2.0) * mu * E[k];
  for (int k = 0; k < 9; k += 4) S[k] = fma(lambda, trace, S[k]);
  out.stress = product(F, S);
  if (!want_tangent) return;
  // dP = dF S + F (lambda tr(dE) I + 2 mu dE), 2 dE = dF^T F + F^T dF.
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      const T left =
          fma(F[3 * i], F[3 * k], fma(F[3 * i + 1], F[3 * k + 1], F[3 * i + 2] * F[3 * k + 2]));
      for (int j = 0; j < 3; ++j) {
        for (int l = 0; l < 3; ++l) {
          T value = fma(lambda * F[3 * i + j], F[3 * k + l], mu * F[3 * i + l] * F[3 * k + j]);
          if (j == l) value = fma(mu, left, value);
          if (i == k) value = value + S[3 * j + l];
          out.tangent[9 * (3 * i + j) + 3 * k + l] = value;
        }
      }
    }
  }
}

}  // namespace

Lame make_lame(double young_modulus, double poisson_ratio) {
  return {young_modulus / (2 * (1 + poisson_ratio)),
          young_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))};
}

template <typename T>
void elastic_response(pb::ElasticLaw law, const std::array<T, 9>& F, T mu, T lambda,
                      bool want_tangent, ElasticResponse<T>& out) {
  switch (law) {
    case pb::LAW_NEO_HOOKE:
      return neo_hooke(F, mu, lambda, want_tangent, out);
    case pb::LAW_COROTATED:
      return corotated(F, mu, lambda, want_tangent, out);
    case pb::LAW_ST_VENANT_KIRCHHOFF:
      return st_venant_kirchhoff(F, mu, lambda, want_tangent, out);
    case pb::LAW_STABLE_NEO_HOOKE:
      break;  // refused by make_reference_model
  }
  OMENTUM_CHECK(false, "law {}", static_cast<int>(law));
}

template void elastic_response(pb::ElasticLaw, const std::array<double, 9>&, double, double, bool,
                               ElasticResponse<double>&);
template void elastic_response(pb::ElasticLaw, const std::array<Pack, 9>&, Pack, Pack, bool,
                               ElasticResponse<Pack>&);

}  // namespace omentum
