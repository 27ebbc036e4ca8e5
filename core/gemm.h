#pragma once

#include <cstddef>

namespace omentum {

/// Width of a column panel: two vectors of eight floats, one cache line.
inline constexpr int kPanel = 16;

constexpr int padded_columns(int columns) { return (columns + kPanel - 1) / kPanel * kPanel; }

/// The matrix product of policy and learner: C[i][j] = init[j] + sum over k of A[i][k] B[k][j].
///
/// Every output is one chain of fused multiply-adds with k = 0 ... inner-1 ascending, starting from
/// init[j] (0 when init is null). Lanes are output columns, so an output's bits depend on its own
/// row of A and on B alone: not on `rows`, not on the neighbours. That is what makes the policy
/// batch-invariant (docs/learner.md 3.1) and the gradients independent of threads. The AVX2 kernel
/// is 6 rows x 2 vectors of registers.
///
///   A[i][k] at a[i * a_row + k * a_inner]           (swap the strides for the transposed matrix)
///   B[k][j] at b[(j / 16) * b_panel + k * b_inner + j % 16]
///             packed:    b_panel = inner * 16, b_inner = 16
///             row-major: b_panel = 16, b_inner = leading dimension
///   C[i][j] at c[i * c_row + j]
///
/// `columns` must be a multiple of 8, which only debug builds check; a last panel of 8 columns is
/// allowed (B must still be readable as described). `init` has `columns` entries. C must not
/// overlap A, B or init. No allocation, no alignment requirement.
struct GemmOperands {
  const float* a = nullptr;
  std::ptrdiff_t a_row = 0;
  std::ptrdiff_t a_inner = 0;
  const float* b = nullptr;
  std::ptrdiff_t b_inner = 0;
  std::ptrdiff_t b_panel = 0;
  float* c = nullptr;
  std::ptrdiff_t c_row = 0;
  const float* init = nullptr;
};

/// Picks the widest kernel of this CPU; all kernels give the same bits (tests/core/gemm_test.cpp).
void gemm(int rows, int columns, int inner, const GemmOperands& operands);

/// The kernels by name, for the test and the benchmark. The second needs gemm_has_avx512().
void gemm_avx2(int rows, int columns, int inner, const GemmOperands& operands);
void gemm_avx512(int rows, int columns, int inner, const GemmOperands& operands);
bool gemm_has_avx512();

/// Packs the row-major rows x columns matrix for the B operand: panels of 16 columns, missing
/// columns zero. `packed` has rows * padded_columns(columns) floats.
void pack_panels(const float* source, int rows, int columns, std::ptrdiff_t leading, float* packed);

/// Packs the transpose of the row-major rows x columns matrix: B[k][j] = source[j][k], k < columns,
/// j < rows. `packed` has columns * padded_columns(rows) floats.
void pack_panels_transposed(const float* source, int rows, int columns, std::ptrdiff_t leading,
                            float* packed);

}  // namespace omentum
