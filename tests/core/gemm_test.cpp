#include "core/gemm.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <vector>

#include "core/rng.h"

namespace omentum {
namespace {

std::vector<float> random_floats(std::size_t count, std::uint32_t stream) {
  std::vector<float> values(count);
  for (std::size_t i = 0; i < count; ++i) {
    values[i] =
        2 * uniform_24(philox({static_cast<std::uint32_t>(i), stream, 0, 0}, {1, 1})[0]) - 1;
  }
  return values;
}

struct Size {
  int rows, columns, inner;
};

const Size kSizes[] = {{1, 128, 14},  {1, 16, 128},  {1, 8, 128},    {2, 128, 128},
                       {3, 144, 5},   {7, 48, 33},   {8, 8, 128},    {12, 32, 3},
                       {13, 176, 64}, {24, 16, 128}, {64, 128, 128}, {63, 24, 11}};

/// The promise, as loops: one std::fma chain per output, k ascending, from the bias.
std::vector<float> expected(const Size& s, const std::vector<float>& a, const std::vector<float>& b,
                            int leading, const std::vector<float>& init) {
  std::vector<float> c(static_cast<std::size_t>(s.rows * s.columns));
  for (int i = 0; i < s.rows; ++i) {
    for (int j = 0; j < s.columns; ++j) {
      float sum = init.empty() ? 0.0F : init[static_cast<std::size_t>(j)];
      for (int k = 0; k < s.inner; ++k) {
        sum = std::fma(a[static_cast<std::size_t>(i * s.inner + k)],
                       b[static_cast<std::size_t>(k * leading + j)], sum);
      }
      c[static_cast<std::size_t>(i * s.columns + j)] = sum;
    }
  }
  return c;
}

using Kernel = void (*)(int, int, int, const GemmOperands&);

void expect_exact(Kernel kernel) {
  for (const Size& s : kSizes) {
    const int leading = padded_columns(s.columns);
    const std::vector<float> a = random_floats(static_cast<std::size_t>(s.rows * s.inner), 1);
    const std::vector<float> b = random_floats(static_cast<std::size_t>(s.inner * leading), 2);
    const std::vector<float> init = random_floats(static_cast<std::size_t>(leading), 3);
    std::vector<float> packed(b.size());
    pack_panels(b.data(), s.inner, leading, leading, packed.data());
    std::vector<float> at(a.size());  // the same matrix stored the other way round
    for (int i = 0; i < s.rows; ++i) {
      for (int k = 0; k < s.inner; ++k) {
        at[static_cast<std::size_t>(k * s.rows + i)] = a[static_cast<std::size_t>(i * s.inner + k)];
      }
    }
    std::vector<float> bt(b.size());  // and the transpose of the right one
    for (int k = 0; k < s.inner; ++k) {
      for (int j = 0; j < leading; ++j) {
        bt[static_cast<std::size_t>(j * s.inner + k)] =
            b[static_cast<std::size_t>(k * leading + j)];
      }
    }
    std::vector<float> packed_from_transpose(b.size());
    pack_panels_transposed(bt.data(), leading, s.inner, s.inner, packed_from_transpose.data());
    EXPECT_EQ(packed, packed_from_transpose);

    std::vector<float> c(static_cast<std::size_t>(s.rows * s.columns));
    const std::vector<float> with_bias = expected(s, a, b, leading, init);
    kernel(s.rows, s.columns, s.inner,
           {a.data(), s.inner, 1, packed.data(), kPanel,
            static_cast<std::ptrdiff_t>(s.inner) * kPanel, c.data(), s.columns, init.data()});
    EXPECT_EQ(std::memcmp(c.data(), with_bias.data(), c.size() * sizeof(float)), 0)
        << s.rows << " x " << s.columns << " x " << s.inner;
    kernel(s.rows, s.columns, s.inner,
           {at.data(), 1, s.rows, b.data(), leading, kPanel, c.data(), s.columns, nullptr});
    const std::vector<float> without = expected(s, a, b, leading, {});
    EXPECT_EQ(std::memcmp(c.data(), without.data(), c.size() * sizeof(float)), 0)
        << s.rows << " x " << s.columns << " x " << s.inner;
  }
}

TEST(Gemm, Avx2IsOneFusedChainPerOutput) { expect_exact(gemm_avx2); }

TEST(Gemm, Avx512GivesTheSameBits) {
  if (!gemm_has_avx512()) GTEST_SKIP() << "this CPU has no AVX-512";
  expect_exact(gemm_avx512);
}

TEST(Gemm, WritesNothingBesideItsOutputs) {
  for (const Kernel kernel : {Kernel{gemm_avx2}, Kernel{gemm}}) {
    const std::vector<float> a = random_floats(3 * 4, 1), b = random_floats(4 * 16, 2);
    std::vector<float> c(3 * 10, 7.0F);
    kernel(3, 8, 4, {a.data(), 4, 1, b.data(), 16, 64, c.data(), 10, nullptr});
    for (std::size_t i = 0; i < c.size(); ++i) EXPECT_EQ(c[i] == 7.0F, i % 10 >= 8) << i;
  }
}

}  // namespace
}  // namespace omentum
