// The product of core/gemm.h with 16 columns per vector. Compiled with AVX-512 flags of its own, so
// it includes nothing that emits shared inline code, keeps everything but the entry function in an
// unnamed namespace, and is only called after a check of the CPU. Each output is the same chain of
// fused multiply-adds as in gemm.cpp: the same bits.

#include <immintrin.h>

#include <utility>

#include "core/gemm.h"

namespace omentum {

namespace {

/// `mask` selects the columns of a panel that exist; where there are several, all do.
template <int Panels>
inline __attribute__((always_inline)) __m512 load(const float* p, __mmask16 mask) {
  return Panels > 1 ? _mm512_loadu_ps(p) : _mm512_maskz_loadu_ps(mask, p);
}

template <int Panels>
inline __attribute__((always_inline)) void store(float* p, __m512 v, __mmask16 mask) {
  if (Panels > 1) {
    _mm512_storeu_ps(p, v);
  } else {
    _mm512_mask_storeu_ps(p, mask, v);
  }
}

/// Rows x (Panels * 16) outputs in registers; the loops must be unrolled whole or the sums go
/// through memory.
template <int Rows, int Panels>
inline __attribute__((always_inline)) void tile(int inner, const GemmOperands& o, const float* a,
                                                const float* b, const float* init, float* c,
                                                __mmask16 mask) {
  __m512 sum[Rows][Panels];
#pragma GCC unroll 16
  for (int p = 0; p < Panels; ++p) {
    const __m512 start = init != nullptr ? load<Panels>(init + p * 16, mask) : _mm512_setzero_ps();
#pragma GCC unroll 16
    for (int r = 0; r < Rows; ++r) sum[r][p] = start;
  }
  const std::ptrdiff_t stride = o.a_row, step = o.a_inner;
  const float* from[4] = {a, a + 3 * stride, a + 6 * stride, a + 9 * stride};
  for (int k = 0; k < inner; ++k) {
    __m512 right[Panels];
#pragma GCC unroll 16
    for (int p = 0; p < Panels; ++p) right[p] = load<Panels>(b + p * o.b_panel, mask);
      // Rows by threes from four pointers: three strides fit the address modes, twelve offsets do
      // not fit the registers.
#pragma GCC unroll 16
    for (int r = 0; r < Rows; ++r) {
      const __m512 left = _mm512_set1_ps(from[r / 3][r % 3 * stride]);
#pragma GCC unroll 16
      for (int p = 0; p < Panels; ++p) sum[r][p] = _mm512_fmadd_ps(left, right[p], sum[r][p]);
    }
#pragma GCC unroll 16
    for (int q = 0; q < (Rows + 2) / 3; ++q) from[q] += step;
    b += o.b_inner;
  }
#pragma GCC unroll 16
  for (int r = 0; r < Rows; ++r) {
#pragma GCC unroll 16
    for (int p = 0; p < Panels; ++p) store<Panels>(c + r * o.c_row + p * 16, sum[r][p], mask);
  }
}

using Groups = std::make_integer_sequence<int, 12>;

/// The tile of as many rows as the group has, one of Rows + 1.
template <int Panels, int... Rows>
void rows_of(std::integer_sequence<int, Rows...>, int group, int inner, const GemmOperands& o,
             const float* a, const float* b, const float* init, float* c, __mmask16 mask) {
  ((group == Rows + 1 ? tile<Rows + 1, Panels>(inner, o, a, b, init, c, mask) : void()), ...);
}

/// All rows of one pair of panels or one panel, in groups of nearly equal size of at most twelve.
template <int Panels>
void all_rows(int rows, int inner, const GemmOperands& o, const float* b, const float* init,
              float* c, __mmask16 mask) {
  const int groups = (rows + 11) / 12;
  int row = 0;
  for (int g = 0; g < groups; ++g) {
    const int left = rows - row;
    const int group = left / (groups - g) + (left % (groups - g) != 0 ? 1 : 0);
    rows_of<Panels>(Groups(), group, inner, o, o.a + row * o.a_row, b, init, c + row * o.c_row,
                    mask);
    row += group;
  }
}

constexpr __mmask16 kAll = 0xFFFF;

}  // namespace

void gemm_avx512(int rows, int columns, int inner, const GemmOperands& o) {
  int column = 0;
  const auto init_at = [&o](int j) { return o.init != nullptr ? o.init + j : nullptr; };
  const auto panel_at = [&o](int j) { return o.b + j / 16 * o.b_panel; };
  if (rows <= 2) {  // too few chains to hide the latency: take eight or four panels at once
    for (; rows == 1 && column + 128 <= columns; column += 128)
      tile<1, 8>(inner, o, o.a, panel_at(column), init_at(column), o.c + column, kAll);
    for (; column + 64 <= columns; column += 64) {
      rows_of<4>(Groups(), rows, inner, o, o.a, panel_at(column), init_at(column), o.c + column,
                 kAll);
    }
  }
  for (; column + 32 <= columns; column += 32) {
    all_rows<2>(rows, inner, o, panel_at(column), init_at(column), o.c + column, kAll);
  }
  for (; column < columns; column += 16) {
    const __mmask16 mask = columns - column >= 16 ? kAll : 0x00FF;
    all_rows<1>(rows, inner, o, panel_at(column), init_at(column), o.c + column, mask);
  }
}

}  // namespace omentum
