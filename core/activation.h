#pragma once

// exp, log, tanh, sigmoid and the normal quantile for eight samples at a time, in f32: our own
// polynomials with every fused multiply-add written out, no libm, so the bits are the same on every
// x86-64-v3 machine. Errors below are maxima over dense sweeps against libm in double
// (tests/core/activation_test.cpp). One lane never sees another. Polynomials were fitted for this
// file: exp and log by Chebyshev interpolation in 40 digits, tanh by iteratively reweighted least
// squares of the linearised rational error.

#include <immintrin.h>

namespace omentum::lanes {

using Lane = __m256;  ///< eight samples
inline constexpr int kWidth = 8;

inline Lane splat(float value) { return _mm256_set1_ps(value); }
inline Lane fma(Lane a, Lane b, Lane c) { return _mm256_fmadd_ps(a, b, c); }  ///< a b + c
inline Lane select(Lane mask, Lane a, Lane b) {
  return _mm256_blendv_ps(b, a, mask);
}  ///< mask ? a : b
inline Lane less(Lane a, Lane b) { return _mm256_cmp_ps(a, b, _CMP_LT_OQ); }
inline Lane smaller(Lane a, Lane b) { return _mm256_min_ps(a, b); }  ///< a < b ? a : b
inline Lane larger(Lane a, Lane b) { return _mm256_max_ps(a, b); }   ///< a > b ? a : b

/// e^x. Relative error < 1.2e-7 for x in [-87, 88]; 0 below -87.3 (no denormals), e^88 above 88.
/// NaN stays NaN.
inline Lane exp(Lane x) {
  const Lane bounded = larger(splat(-87.3F), smaller(splat(88.0F), x));
  const Lane n = _mm256_round_ps(_mm256_mul_ps(bounded, splat(1.44269504F)),
                                 _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
  // ln 2 in two parts: the first has 9 significant bits, so n times it is exact.
  Lane r = fma(n, splat(-0.693359375F), bounded);
  r = fma(n, splat(2.12194440e-4F), r);
  Lane p = splat(1.39261835877e-3F);
  p = fma(p, r, splat(8.36317905272e-3F));
  p = fma(p, r, splat(4.16665546172e-2F));
  p = fma(p, r, splat(1.66665769897e-1F));
  p = fma(p, r, splat(0.5F));
  p = fma(p, _mm256_mul_ps(r, r), r);
  p = _mm256_add_ps(p, splat(1.0F));
  const __m256i exponent = _mm256_slli_epi32(_mm256_cvtps_epi32(n), 23);
  const Lane scaled = _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(p), exponent));
  return select(less(x, splat(-87.3F)), _mm256_setzero_ps(), scaled);
}

/// Natural logarithm of positive normal numbers. Error < 1.2e-7 relative or 3e-8 absolute,
/// whichever is larger.
inline Lane log(Lane x) {
  const __m256i bits = _mm256_castps_si256(x);
  // Exponent such that the mantissa lies in [sqrt(1/2), sqrt(2)).
  const __m256i offset = _mm256_sub_epi32(bits, _mm256_set1_epi32(0x3F3504F3));
  const __m256i exponent = _mm256_srai_epi32(offset, 23);
  const Lane mantissa =
      _mm256_castsi256_ps(_mm256_sub_epi32(bits, _mm256_slli_epi32(exponent, 23)));
  const Lane n = _mm256_cvtepi32_ps(exponent);
  const Lane f = _mm256_sub_ps(mantissa, splat(1.0F));
  Lane p = splat(6.97161147145e-2F);
  p = fma(p, f, splat(-1.14797338466e-1F));
  p = fma(p, f, splat(1.16854199235e-1F));
  p = fma(p, f, splat(-1.24256873315e-1F));
  p = fma(p, f, splat(1.42490576457e-1F));
  p = fma(p, f, splat(-1.66678023195e-1F));
  p = fma(p, f, splat(2.00007157489e-1F));
  p = fma(p, f, splat(-2.49999969580e-1F));
  p = fma(p, f, splat(3.33333311800e-1F));
  const Lane square = _mm256_mul_ps(f, f);
  Lane tail = _mm256_mul_ps(p, _mm256_mul_ps(f, square));
  tail = fma(square, splat(-0.5F), tail);
  tail = fma(n, splat(-2.12194440e-4F), tail);
  return fma(n, splat(0.693359375F), _mm256_add_ps(tail, f));
}

/// Hyperbolic tangent, odd rational of degree 13/6. Absolute error < 3e-7 everywhere, exact 0 at 0;
/// |y| <= 1.
inline Lane tanh(Lane x) {
  const Lane c = larger(splat(-8.0F), smaller(splat(8.0F), x));
  const Lane s = _mm256_mul_ps(c, c);
  Lane p = splat(-1.1564408173e-13F);
  Lane q = splat(2.6129768169e-04F);
  p = fma(p, s, splat(6.3655705000e-11F));
  q = fma(q, s, splat(2.4675007402e-02F));
  p = fma(p, s, splat(-2.2314738184e-08F));
  q = fma(q, s, splat(4.6457682847e-01F));
  p = fma(p, s, splat(1.1642462177e-05F));
  q = fma(q, s, splat(1.0F));
  p = fma(p, s, splat(3.1493664794e-03F));
  p = fma(p, s, splat(1.3124351343e-01F));
  p = fma(p, s, splat(9.9999999823e-01F));
  return _mm256_div_ps(_mm256_mul_ps(p, c), q);
}

/// 1 / (1 + e^-x). Relative error < 3e-7.
inline Lane sigmoid(Lane x) {
  const Lane e = exp(_mm256_sub_ps(_mm256_setzero_ps(), x));
  return _mm256_div_ps(splat(1.0F), _mm256_add_ps(splat(1.0F), e));
}

/// Quantile of the standard normal distribution for p in [2^-25, 1 - 2^-25]: rational
/// approximations of [Wichura88] (AS 241, PPND7). Absolute error < 2e-6.
inline Lane normal_quantile(Lane p) {
  const Lane q = _mm256_sub_ps(p, splat(0.5F));
  const Lane r = fma(q, _mm256_sub_ps(_mm256_setzero_ps(), q), splat(0.180625F));
  Lane a = splat(5.9109374720e+01F);
  a = fma(a, r, splat(1.5929113202e+02F));
  a = fma(a, r, splat(5.0434271938e+01F));
  a = fma(a, r, splat(3.3871327179F));
  Lane b = splat(6.7187563600e+01F);
  b = fma(b, r, splat(7.8757757664e+01F));
  b = fma(b, r, splat(1.7895169469e+01F));
  b = fma(b, r, splat(1.0F));
  const Lane centre = _mm256_div_ps(_mm256_mul_ps(q, a), b);

  const Lane negative = less(q, _mm256_setzero_ps());
  const Lane tail = select(negative, p, _mm256_sub_ps(splat(1.0F), p));
  const Lane t =
      _mm256_sub_ps(_mm256_sqrt_ps(_mm256_sub_ps(_mm256_setzero_ps(), log(tail))), splat(1.6F));
  Lane c = splat(1.7023821103e-1F);
  c = fma(c, t, splat(1.3067284816F));
  c = fma(c, t, splat(2.7568153900F));
  c = fma(c, t, splat(1.4234372777F));
  Lane d = splat(1.2021132975e-1F);
  d = fma(d, t, splat(7.3700164250e-1F));
  d = fma(d, t, splat(1.0F));
  const Lane far = _mm256_div_ps(c, d);
  const Lane signed_far = select(negative, _mm256_sub_ps(_mm256_setzero_ps(), far), far);
  const Lane magnitude = _mm256_andnot_ps(splat(-0.0F), q);
  return select(less(splat(0.425F), magnitude), signed_far, centre);
}

/// The same functions for one number: lane 0 of eight, so the bits agree by construction.
inline float exp(float x) { return _mm256_cvtss_f32(exp(splat(x))); }
inline float log(float x) { return _mm256_cvtss_f32(log(splat(x))); }
inline float tanh(float x) { return _mm256_cvtss_f32(tanh(splat(x))); }
inline float normal_quantile(float p) { return _mm256_cvtss_f32(normal_quantile(splat(p))); }

}  // namespace omentum::lanes
