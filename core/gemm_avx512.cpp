// The product of core/gemm.h with 16 columns per vector. Compiled with AVX-512 flags of its own, so
// it includes nothing that emits shared inline code, keeps everything but the entry function in an
// unnamed namespace, and is only called after a check of the CPU. Each output is the same chain of
// fused multiply-adds as in gemm.cpp: the same bits.

#include <immintrin.h>

#include "core/gemm.h"

namespace omentum {

namespace {

/// Rows x (Panels * 16) outputs in registers; the loops must be unrolled whole or the sums go
/// through memory. `mask` selects the columns of the last panel that exist.
template <int Rows, int Panels>
inline __attribute__((always_inline)) void tile(int inner, const GemmOperands& o, const float* a,
                                                const float* b, const float* init, float* c,
                                                __mmask16 mask) {
  __m512 sum[Rows][Panels];
#pragma GCC unroll 16
  for (int p = 0; p < Panels; ++p) {
    const __m512 start =
        init != nullptr ? _mm512_maskz_loadu_ps(mask, init + p * 16) : _mm512_setzero_ps();
#pragma GCC unroll 16
    for (int r = 0; r < Rows; ++r) sum[r][p] = start;
  }
  const std::ptrdiff_t stride = o.a_row, step = o.a_inner;
  const float* from[4] = {a, a + 3 * stride, a + 6 * stride, a + 9 * stride};
  for (int k = 0; k < inner; ++k) {
    __m512 right[Panels];
#pragma GCC unroll 16
    for (int p = 0; p < Panels; ++p) right[p] = _mm512_maskz_loadu_ps(mask, b + p * o.b_panel);
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
    for (int p = 0; p < Panels; ++p)
      _mm512_mask_storeu_ps(c + r * o.c_row + p * 16, mask, sum[r][p]);
  }
}

template <int Panels>
void rows_of(int group, int inner, const GemmOperands& o, const float* a, const float* b,
             const float* init, float* c, __mmask16 mask) {
  switch (group) {
    case 1:
      tile<1, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 2:
      tile<2, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 3:
      tile<3, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 4:
      tile<4, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 5:
      tile<5, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 6:
      tile<6, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 7:
      tile<7, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 8:
      tile<8, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 9:
      tile<9, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 10:
      tile<10, Panels>(inner, o, a, b, init, c, mask);
      break;
    case 11:
      tile<11, Panels>(inner, o, a, b, init, c, mask);
      break;
    default:
      tile<12, Panels>(inner, o, a, b, init, c, mask);
      break;
  }
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
    rows_of<Panels>(group, inner, o, o.a + row * o.a_row, b, init, c + row * o.c_row, mask);
    row += group;
  }
}

constexpr __mmask16 kAll = 0xFFFF;

}  // namespace

void gemm_avx512(int rows, int columns, int inner, const GemmOperands& o) {
  int column = 0;
  if (rows <= 2) {  // too few chains to hide the latency: take eight or four panels at once
    for (; rows == 1 && column + 128 <= columns; column += 128) {
      tile<1, 8>(inner, o, o.a, o.b + column / 16 * o.b_panel,
                 o.init != nullptr ? o.init + column : nullptr, o.c + column, kAll);
    }
    for (; column + 64 <= columns; column += 64) {
      const float* b = o.b + column / 16 * o.b_panel;
      const float* init = o.init != nullptr ? o.init + column : nullptr;
      rows_of<4>(rows, inner, o, o.a, b, init, o.c + column, kAll);
    }
  }
  for (; column + 32 <= columns; column += 32) {
    all_rows<2>(rows, inner, o, o.b + column / 16 * o.b_panel,
                o.init != nullptr ? o.init + column : nullptr, o.c + column, kAll);
  }
  for (; column < columns; column += 16) {
    const __mmask16 mask = columns - column >= 16 ? kAll : 0x00FF;
    all_rows<1>(rows, inner, o, o.b + column / 16 * o.b_panel,
                o.init != nullptr ? o.init + column : nullptr, o.c + column, mask);
  }
}

}  // namespace omentum
