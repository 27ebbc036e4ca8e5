#pragma once

#include <immintrin.h>

#include <cmath>

namespace omentum {

/// Four doubles in a SIMD register: the reference model treats four finite elements at a time. The
/// functions below exist for double as well, so that one source serves both.
struct Pack {
  static constexpr int kLanes = 4;

  Pack() : v(_mm256_setzero_pd()) {}
  Pack(double s) : v(_mm256_set1_pd(s)) {}  // NOLINT(google-explicit-constructor)
  explicit Pack(__m256d values) : v(values) {}
  static Pack load(const double* in) { return Pack(_mm256_loadu_pd(in)); }

  double lane(int k) const {
    alignas(32) double values[kLanes];
    _mm256_store_pd(values, v);
    return values[k];
  }
  void set_lane(int k, double s) {
    alignas(32) double values[kLanes];
    _mm256_store_pd(values, v);
    values[k] = s;
    v = _mm256_load_pd(values);
  }
  void store(double* out) const { _mm256_storeu_pd(out, v); }

  friend Pack operator+(Pack a, Pack b) { return Pack(_mm256_add_pd(a.v, b.v)); }
  friend Pack operator-(Pack a, Pack b) { return Pack(_mm256_sub_pd(a.v, b.v)); }
  friend Pack operator*(Pack a, Pack b) { return Pack(_mm256_mul_pd(a.v, b.v)); }
  friend Pack operator/(Pack a, Pack b) { return Pack(_mm256_div_pd(a.v, b.v)); }
  friend Pack operator-(Pack a) { return Pack(0.0) - a; }

  __m256d v;
};

/// a b + c, rounded once.
inline Pack fma(Pack a, Pack b, Pack c) { return Pack(_mm256_fmadd_pd(a.v, b.v, c.v)); }
inline double fma(double a, double b, double c) { return std::fma(a, b, c); }

inline Pack root(Pack a) { return Pack(_mm256_sqrt_pd(a.v)); }
inline double root(double a) { return std::sqrt(a); }

/// a < b ? b : a; NaN where a is.
inline Pack at_least(Pack a, Pack b) {
  return Pack(_mm256_blendv_pd(a.v, b.v, _mm256_cmp_pd(a.v, b.v, _CMP_LT_OQ)));
}
inline double at_least(double a, double b) { return a < b ? b : a; }

/// |a|; NaN where a is.
inline Pack size(Pack a) { return at_least(a, -a); }

/// a < b ? 1 : 0.
inline Pack is_less(Pack a, Pack b) {
  return Pack(_mm256_and_pd(_mm256_cmp_pd(a.v, b.v, _CMP_LT_OQ), _mm256_set1_pd(1)));
}

inline Pack at_most(Pack a, double b) {
  return Pack(_mm256_min_pd(_mm256_set1_pd(b), a.v));  // NaN where a is
}

/// e^x - 1, e^x - 1 - x and e^x for x >= 0 without loss of digits near 0, from basic operations
/// only. Beyond 20 the tangent goes on, its slope 0 in `slope`: no tissue is so stiff.
struct Exponential {
  Pack minus_one, excess, slope;
};

/// With y = x / 64 by the series, then six times e^2y - 1 = (e^y - 1)(e^y + 1) and
/// e^2y - 1 - 2y = (e^y - 1)^2 + 2 (e^y - 1 - y): sums of positive terms.
inline Exponential exponential(Pack x) {
  constexpr double kLargest = 20;
  const Pack inside = at_most(x, kLargest);
  const Pack y = Pack(1.0 / 64) * inside;
  Pack sum(1.0);
  for (int k = 13; k >= 3; --k) sum = fma(Pack(1.0 / k) * y, sum, Pack(1.0));
  Pack excess = Pack(0.5) * y * y * sum;
  Pack minus_one = y + excess;
  for (int doubling = 0; doubling < 6; ++doubling) {
    excess = fma(minus_one, minus_one, Pack(2.0) * excess);
    minus_one = minus_one * (Pack(2.0) + minus_one);
  }
  const Pack slope = (Pack(1.0) - is_less(Pack(kLargest), x)) * (Pack(1.0) + minus_one);
  return {minus_one, fma(minus_one, x - inside, excess), slope};
}

/// Natural logarithm from basic operations only, so that its bits are the same on every machine
/// (decision 0005 does so for trigonometry); NaN where a <= 0. Error below 2 units in the last
/// place: a = 2^k m, sqrt(1/2) <= m < sqrt(2), ln m = 2 artanh((m - 1) / (m + 1)) by its odd
/// series, whose first term left out is below 1e-17 of the first.
inline double logarithm(double a) {
  if (!(a > 0)) return std::nan("");
  int exponent = 0;
  double m = std::frexp(a, &exponent);  // exact
  if (m < 0.70710678118654752) {
    m *= 2;
    --exponent;
  }
  const double s = (m - 1) / (m + 1);
  const double z = s * s;
  double sum = 1.0 / 21;
  for (int k = 19; k >= 3; k -= 2) sum = std::fma(z, sum, 1.0 / k);
  // ln 2 in two parts: the first has zeros enough that its product with an exponent is exact.
  constexpr double kLn2High = 6.93147180369123816490e-01;
  constexpr double kLn2Low = 1.90821492927058770002e-10;
  const double log_m = std::fma(2 * s * z, sum, 2 * s);
  return std::fma(exponent, kLn2High, std::fma(exponent, kLn2Low, log_m));
}
inline Pack logarithm(Pack a) {
  alignas(32) double values[Pack::kLanes];
  _mm256_store_pd(values, a.v);
  for (double& value : values) value = logarithm(value);
  return Pack(_mm256_load_pd(values));
}

}  // namespace omentum
