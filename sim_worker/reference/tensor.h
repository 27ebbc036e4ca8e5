#pragma once

#include <array>

#include "sim_worker/reference/pack.h"

namespace omentum {

/// 3 x 3 matrix of doubles or packs, row-major.
template <typename T>
using Tensor = std::array<T, 9>;

/// a : b.
template <typename T>
T dot(const Tensor<T>& a, const Tensor<T>& b) {
  T sum = a[0] * b[0];
  for (int k = 1; k < 9; ++k) sum = fma(a[k], b[k], sum);
  return sum;
}

/// a b.
template <typename T>
Tensor<T> product(const Tensor<T>& a, const Tensor<T>& b) {
  Tensor<T> c;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j)
      c[3 * i + j] = fma(a[3 * i], b[j], fma(a[3 * i + 1], b[3 + j], a[3 * i + 2] * b[6 + j]));
  }
  return c;
}

/// a^T b.
template <typename T>
Tensor<T> product_transposed(const Tensor<T>& a, const Tensor<T>& b) {
  Tensor<T> c;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j)
      c[3 * i + j] = fma(a[i], b[j], fma(a[3 + i], b[3 + j], a[6 + i] * b[6 + j]));
  }
  return c;
}

/// Cofactor matrix: det(a) a^-T.
template <typename T>
Tensor<T> cofactor(const Tensor<T>& a) {
  Tensor<T> c;
  for (int i = 0; i < 3; ++i) {
    const int i1 = 3 * ((i + 1) % 3);
    const int i2 = 3 * ((i + 2) % 3);
    for (int j = 0; j < 3; ++j) {
      const int j1 = (j + 1) % 3;
      const int j2 = (j + 2) % 3;
      c[3 * i + j] = a[i1 + j1] * a[i2 + j2] - a[i1 + j2] * a[i2 + j1];
    }
  }
  return c;
}

template <typename T>
T determinant(const Tensor<T>& a, const Tensor<T>& cofactors) {
  return fma(a[0], cofactors[0], fma(a[1], cofactors[1], a[2] * cofactors[2]));
}

/// E = (F^T F - I) / 2.
template <typename T>
Tensor<T> green_strain(const Tensor<T>& F) {
  Tensor<T> E = product_transposed(F, F);
  for (int k = 0; k < 9; k += 4) E[k] = E[k] - T(1.0);
  for (T& e : E) e = T(0.5) * e;
  return E;
}

}  // namespace omentum
