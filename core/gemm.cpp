#include "core/gemm.h"

#include <immintrin.h>

#include <utility>

#include "core/check.h"

namespace omentum {

namespace {

/// Rows x (Vectors * 8) outputs in registers. Vectors are consecutive in memory within a panel and
/// b_panel apart between panels. g++ keeps the accumulators in registers because both counts are
/// constants.
template <int Rows, int Vectors>
inline __attribute__((always_inline)) void tile(int inner, const GemmOperands& o, const float* a,
                                                const float* b, const float* init, float* c) {
  __m256 sum[Rows][Vectors];
  const auto column = [&](int v) { return (v / 2) * kPanel + (v % 2) * 8; };
  for (int v = 0; v < Vectors; ++v) {
    const __m256 start = init != nullptr ? _mm256_loadu_ps(init + column(v)) : _mm256_setzero_ps();
    for (int r = 0; r < Rows; ++r) sum[r][v] = start;
  }
  for (int k = 0; k < inner; ++k) {
    __m256 right[Vectors];
    for (int v = 0; v < Vectors; ++v)
      right[v] = _mm256_loadu_ps(b + (v / 2) * o.b_panel + (v % 2) * 8);
    for (int r = 0; r < Rows; ++r) {
      const __m256 left = _mm256_broadcast_ss(a + r * o.a_row);
      for (int v = 0; v < Vectors; ++v) sum[r][v] = _mm256_fmadd_ps(left, right[v], sum[r][v]);
    }
    a += o.a_inner;
    b += o.b_inner;
  }
  for (int r = 0; r < Rows; ++r) {
    for (int v = 0; v < Vectors; ++v) _mm256_storeu_ps(c + r * o.c_row + column(v), sum[r][v]);
  }
}

/// The tile of as many rows as the group has, one of Rows + 1.
template <int Vectors, int... Rows>
void row_group(std::integer_sequence<int, Rows...>, int group, int inner, const GemmOperands& o,
               const float* a, const float* b, const float* init, float* c) {
  ((group == Rows + 1 ? tile<Rows + 1, Vectors>(inner, o, a, b, init, c) : void()), ...);
}

/// All rows of one panel, in groups of nearly equal size of at most six.
template <int Vectors>
void panel(int rows, int inner, const GemmOperands& o, const float* b, const float* init,
           float* c) {
  const int groups = (rows + 5) / 6;
  int row = 0;
  for (int g = 0; g < groups; ++g) {
    const int group = (rows - row) / (groups - g) + ((rows - row) % (groups - g) != 0 ? 1 : 0);
    row_group<Vectors>(std::make_integer_sequence<int, 6>(), group, inner, o, o.a + row * o.a_row,
                       b, init, c + row * o.c_row);
    row += group;
  }
}

}  // namespace

bool gemm_has_avx512() {
  static const bool has = __builtin_cpu_supports("avx512f") != 0;
  return has;
}

void gemm(int rows, int columns, int inner, const GemmOperands& operands) {
  if (gemm_has_avx512()) {
    gemm_avx512(rows, columns, inner, operands);
  } else {
    gemm_avx2(rows, columns, inner, operands);
  }
}

void gemm_avx2(int rows, int columns, int inner, const GemmOperands& o) {
  OMENTUM_DCHECK(columns % 8 == 0);
  int column = 0;
  const auto init_at = [&](int j) { return o.init != nullptr ? o.init + j : nullptr; };
  const auto panel_at = [&](int j) { return o.b + (j / kPanel) * o.b_panel; };
  // Few rows leave too few chains to hide the latency of the multiply-add: take several panels at
  // once.
  if (rows <= 3) {
    for (; rows == 1 && column + 4 * kPanel <= columns; column += 4 * kPanel) {
      tile<1, 8>(inner, o, o.a, panel_at(column), init_at(column), o.c + column);
    }
    for (; rows == 2 && column + 2 * kPanel <= columns; column += 2 * kPanel) {
      tile<2, 4>(inner, o, o.a, panel_at(column), init_at(column), o.c + column);
    }
    for (; rows == 3 && column + 2 * kPanel <= columns; column += 2 * kPanel) {
      tile<3, 4>(inner, o, o.a, panel_at(column), init_at(column), o.c + column);
    }
  }
  for (; column + kPanel <= columns; column += kPanel) {
    panel<2>(rows, inner, o, panel_at(column), init_at(column), o.c + column);
  }
  if (column < columns) panel<1>(rows, inner, o, panel_at(column), init_at(column), o.c + column);
}

void pack_panels(const float* source, int rows, int columns, std::ptrdiff_t leading,
                 float* packed) {
  for (int first = 0; first < columns; first += kPanel) {
    const int width = columns - first < kPanel ? columns - first : kPanel;
    for (int k = 0; k < rows; ++k, packed += kPanel) {
      const float* from = source + k * leading + first;
      if (width == kPanel) {
        _mm256_storeu_ps(packed, _mm256_loadu_ps(from));
        _mm256_storeu_ps(packed + 8, _mm256_loadu_ps(from + 8));
        continue;
      }
      for (int j = 0; j < kPanel; ++j) packed[j] = j < width ? from[j] : 0.0F;
    }
  }
}

namespace {

/// to[k * 16 + j] = from[j * leading + k] for j, k < 8.
void transpose_8x8(const float* from, std::ptrdiff_t leading, float* to) {
  __m256 row[8], pair[8], quad[8];
  for (int j = 0; j < 8; ++j) row[j] = _mm256_loadu_ps(from + j * leading);
  for (int j = 0; j < 8; j += 2) {
    pair[j] = _mm256_unpacklo_ps(row[j], row[j + 1]);
    pair[j + 1] = _mm256_unpackhi_ps(row[j], row[j + 1]);
  }
  for (int j = 0; j < 8; j += 4) {
    quad[j] = _mm256_shuffle_ps(pair[j], pair[j + 2], 0x44);
    quad[j + 1] = _mm256_shuffle_ps(pair[j], pair[j + 2], 0xEE);
    quad[j + 2] = _mm256_shuffle_ps(pair[j + 1], pair[j + 3], 0x44);
    quad[j + 3] = _mm256_shuffle_ps(pair[j + 1], pair[j + 3], 0xEE);
  }
  for (int k = 0; k < 4; ++k) {
    _mm256_storeu_ps(to + k * kPanel, _mm256_permute2f128_ps(quad[k], quad[k + 4], 0x20));
    _mm256_storeu_ps(to + (k + 4) * kPanel, _mm256_permute2f128_ps(quad[k], quad[k + 4], 0x31));
  }
}

}  // namespace

void pack_panels_transposed(const float* source, int rows, int columns, std::ptrdiff_t leading,
                            float* packed) {
  for (int first = 0; first < rows; first += kPanel) {
    int k = 0;
    for (; rows - first >= kPanel && k + 8 <= columns; k += 8, packed += 8 * kPanel) {
      transpose_8x8(source + first * leading + k, leading, packed);
      transpose_8x8(source + (first + 8) * leading + k, leading, packed + 8);
    }
    for (; k < columns; ++k, packed += kPanel) {
      for (int j = 0; j < kPanel; ++j) {
        packed[j] = first + j < rows ? source[(first + j) * leading + k] : 0.0F;
      }
    }
  }
}

}  // namespace omentum
