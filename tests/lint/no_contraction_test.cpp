// The compiler fuses nothing by itself: a product that feeds a sum is rounded unless it is written
// fused (docs/conventions.md). g++ 12 would fuse even intrinsics under -mfma without the flag.

#include <gtest/gtest.h>
#include <immintrin.h>

#include <cmath>

namespace omentum {
namespace {

// (1 + e)^2 = 1 + 2e + e^2 with e = 2^-12: e^2 is half a unit in the last place and is rounded
// away, so the unfused difference to 1 + 2e is 0 and the fused one is e^2.
constexpr float kE = 1.0F / 4096;
constexpr float kFused = kE * kE;

struct Terms {
  volatile float a = 1 + kE;  // volatile: known at run time only
  volatile float c = -(1 + 2 * kE);
};

TEST(Build, NoContractionOfOperators) {
  const Terms terms;
  const float a = terms.a;
  const float c = terms.c;
  EXPECT_EQ(a * a + c, 0.0F);
  EXPECT_EQ(std::fma(a, a, c), kFused);
}

TEST(Build, NoContractionOfDoubles) {
  volatile double e = 1.0 / (1 << 27);
  const double a = 1 + e;
  const double c = -(1 + 2 * e);
  EXPECT_EQ(a * a + c, 0.0);
  EXPECT_EQ(std::fma(a, a, c), e * e);
}

TEST(Build, NoContractionOfIntrinsics) {
  const Terms terms;
  const __m256 a = _mm256_set1_ps(terms.a);
  const __m256 c = _mm256_set1_ps(terms.c);
  EXPECT_EQ(_mm256_cvtss_f32(_mm256_add_ps(_mm256_mul_ps(a, a), c)), 0.0F);
  EXPECT_EQ(_mm256_cvtss_f32(_mm256_fmadd_ps(a, a, c)), kFused);
}

}  // namespace
}  // namespace omentum
