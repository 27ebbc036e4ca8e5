// No include guard on purpose: this file is included once per kernel translation unit, after
// OMENTUM_LANES (1, 8 or 16) and OMENTUM_REAL (float or double) are defined.
//
// The lane type: one environment per SIMD lane. Kernels read as scalar code; the same source at 1,
// 8 and 16 lanes gives the same bits, because only operations with one defined result are used: + -
// * / sqrt fma, comparison, select, bit operations. No rsqrt, no rcp, no libm, no horizontal
// operation (docs/conventions.md).
//
// Everything is in an unnamed namespace: a template or inline function shared between a baseline
// and an AVX-512 object would be one weak symbol, and the linker could run 512-bit code on a
// machine without it.

#include <immintrin.h>

#include <cmath>
#include <cstdint>

namespace {

using Real = OMENTUM_REAL;
constexpr int kLanes = OMENTUM_LANES;  // NOLINT(misc-definitions-in-headers): one per kernel
using Bits = std::uint32_t;            // bit k = lane k
[[maybe_unused]] constexpr const char* kLaneName =  // NOLINT(misc-definitions-in-headers)
    kLanes == 16        ? "f32x16"
    : kLanes == 8       ? "f32x8"
    : sizeof(Real) == 4 ? "f32x1"
                        : "f64x1";

#if OMENTUM_LANES == 16

using Mask = __mmask16;
struct Lane {
  __m512 v;
};
inline Lane load(const Real* p) { return {_mm512_loadu_ps(p)}; }
inline void store(Real* p, Lane a) { _mm512_storeu_ps(p, a.v); }
inline Lane splat(Real a) { return {_mm512_set1_ps(a)}; }
inline Lane operator+(Lane a, Lane b) { return {_mm512_add_ps(a.v, b.v)}; }
inline Lane operator-(Lane a, Lane b) { return {_mm512_sub_ps(a.v, b.v)}; }
inline Lane operator*(Lane a, Lane b) { return {_mm512_mul_ps(a.v, b.v)}; }
inline Lane operator/(Lane a, Lane b) { return {_mm512_div_ps(a.v, b.v)}; }
inline Lane fma(Lane a, Lane b, Lane c) { return {_mm512_fmadd_ps(a.v, b.v, c.v)}; }    // a b + c
inline Lane fnma(Lane a, Lane b, Lane c) { return {_mm512_fnmadd_ps(a.v, b.v, c.v)}; }  // c - a b
// The zero-masked form: g++ 12 warns of an uninitialised value inside its own plain _mm512_sqrt_ps.
inline Lane sqrt(Lane a) { return {_mm512_maskz_sqrt_ps(0xFFFF, a.v)}; }
inline Lane abs(Lane a) { return {_mm512_abs_ps(a.v)}; }
inline Mask operator<(Lane a, Lane b) { return _mm512_cmp_ps_mask(a.v, b.v, _CMP_LT_OQ); }
inline Lane select(Mask m, Lane a, Lane b) {
  return {_mm512_mask_blend_ps(m, b.v, a.v)};
}  // m ? a : b
inline Mask to_mask(Bits bits) { return static_cast<Mask>(bits); }
inline Bits to_bits(Mask m) { return m; }
inline Mask both(Mask a, Mask b) { return static_cast<Mask>(a & b); }

#elif OMENTUM_LANES == 8

struct Mask {
  __m256 v;
};
struct Lane {
  __m256 v;
};
inline Lane load(const Real* p) { return {_mm256_loadu_ps(p)}; }
inline void store(Real* p, Lane a) { _mm256_storeu_ps(p, a.v); }
inline Lane splat(Real a) { return {_mm256_set1_ps(a)}; }
inline Lane operator+(Lane a, Lane b) { return {_mm256_add_ps(a.v, b.v)}; }
inline Lane operator-(Lane a, Lane b) { return {_mm256_sub_ps(a.v, b.v)}; }
inline Lane operator*(Lane a, Lane b) { return {_mm256_mul_ps(a.v, b.v)}; }
inline Lane operator/(Lane a, Lane b) { return {_mm256_div_ps(a.v, b.v)}; }
inline Lane fma(Lane a, Lane b, Lane c) { return {_mm256_fmadd_ps(a.v, b.v, c.v)}; }
inline Lane fnma(Lane a, Lane b, Lane c) { return {_mm256_fnmadd_ps(a.v, b.v, c.v)}; }
inline Lane sqrt(Lane a) { return {_mm256_sqrt_ps(a.v)}; }
inline Lane abs(Lane a) { return {_mm256_andnot_ps(_mm256_set1_ps(-0.0F), a.v)}; }
inline Mask operator<(Lane a, Lane b) { return {_mm256_cmp_ps(a.v, b.v, _CMP_LT_OQ)}; }
inline Lane select(Mask m, Lane a, Lane b) { return {_mm256_blendv_ps(b.v, a.v, m.v)}; }
inline Mask to_mask(Bits bits) {
  const __m256i bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
  const __m256i word = _mm256_and_si256(_mm256_set1_epi32(static_cast<int>(bits)), bit);
  return {_mm256_castsi256_ps(_mm256_cmpeq_epi32(word, bit))};
}
inline Bits to_bits(Mask m) { return static_cast<Bits>(_mm256_movemask_ps(m.v)); }
inline Mask both(Mask a, Mask b) { return {_mm256_and_ps(a.v, b.v)}; }

#else

using Mask = bool;
struct Lane {
  Real v;
};
inline Lane load(const Real* p) { return {*p}; }
inline void store(Real* p, Lane a) { *p = a.v; }
inline Lane splat(Real a) { return {a}; }
inline Lane operator+(Lane a, Lane b) { return {a.v + b.v}; }
inline Lane operator-(Lane a, Lane b) { return {a.v - b.v}; }
inline Lane operator*(Lane a, Lane b) { return {a.v * b.v}; }
inline Lane operator/(Lane a, Lane b) { return {a.v / b.v}; }
inline Lane fma(Lane a, Lane b, Lane c) { return {std::fma(a.v, b.v, c.v)}; }
inline Lane fnma(Lane a, Lane b, Lane c) { return {std::fma(-a.v, b.v, c.v)}; }
inline Lane sqrt(Lane a) { return {std::sqrt(a.v)}; }
inline Lane abs(Lane a) { return {std::fabs(a.v)}; }
inline Mask operator<(Lane a, Lane b) { return a.v < b.v; }
inline Lane select(Mask m, Lane a, Lane b) { return m ? a : b; }
inline Mask to_mask(Bits bits) { return (bits & 1U) != 0; }
inline Bits to_bits(Mask m) { return m ? 1U : 0U; }
inline Mask both(Mask a, Mask b) { return a && b; }

#endif

// a < b ? a : b and b < a ? a : b, which is what the instructions do, with NaN too.
#if OMENTUM_LANES == 16
inline Lane min(Lane a, Lane b) { return {_mm512_maskz_min_ps(0xFFFF, a.v, b.v)}; }
inline Lane max(Lane a, Lane b) { return {_mm512_maskz_max_ps(0xFFFF, a.v, b.v)}; }
#elif OMENTUM_LANES == 8
inline Lane min(Lane a, Lane b) { return {_mm256_min_ps(a.v, b.v)}; }
inline Lane max(Lane a, Lane b) { return {_mm256_max_ps(a.v, b.v)}; }
#else
inline Lane min(Lane a, Lane b) { return select(a < b, a, b); }
inline Lane max(Lane a, Lane b) { return select(b < a, a, b); }
#endif

struct Lane3 {
  Lane x, y, z;
};
inline Lane3 load3(const Real* p) { return {load(p), load(p + kLanes), load(p + 2 * kLanes)}; }
inline void store3(Real* p, Lane3 a) {
  store(p, a.x);
  store(p + kLanes, a.y);
  store(p + 2 * kLanes, a.z);
}
inline Lane3 splat3(const Real* p) { return {splat(p[0]), splat(p[1]), splat(p[2])}; }
inline Lane3 zero3() {
  const Lane zero = splat(Real{0});
  return {zero, zero, zero};
}
inline Lane3 operator+(Lane3 a, Lane3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Lane3 operator-(Lane3 a, Lane3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Lane3 operator*(Lane s, Lane3 a) { return {s * a.x, s * a.y, s * a.z}; }
inline Lane3 fma(Lane s, Lane3 a, Lane3 c) {
  return {fma(s, a.x, c.x), fma(s, a.y, c.y), fma(s, a.z, c.z)};
}
inline Lane3 fnma(Lane s, Lane3 a, Lane3 c) {
  return {fnma(s, a.x, c.x), fnma(s, a.y, c.y), fnma(s, a.z, c.z)};
}
inline Lane dot(Lane3 a, Lane3 b) { return fma(a.z, b.z, fma(a.y, b.y, a.x * b.x)); }
inline Lane3 cross(Lane3 a, Lane3 b) {
  return {fnma(a.z, b.y, a.y * b.z), fnma(a.x, b.z, a.z * b.x), fnma(a.y, b.x, a.x * b.y)};
}
inline Lane3 select(Mask m, Lane3 a, Lane3 b) {
  return {select(m, a.x, b.x), select(m, a.y, b.y), select(m, a.z, b.z)};
}

}  // namespace
