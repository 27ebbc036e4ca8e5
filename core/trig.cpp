#include "core/trig.h"

#include <cmath>

namespace omentum::trig {
namespace {

// pi/2 in three parts: the first two have 33 trailing zero bits, so k * part is exact for |k| <
// 2^20.
constexpr double kHalfPi1 = 1.57079632673412561417e+00;
constexpr double kHalfPi2 = 6.07710050630396597660e-11;
constexpr double kHalfPi3 = 2.02226624879595063154e-21;
constexpr double kTwoOverPi = 6.36619772367581382433e-01;
constexpr double kPi = 3.14159265358979311600e+00;
constexpr double kPiLow = 1.22464679914735320717e-16;

// Taylor to x^17 / x^18: the first term left out is below 1e-18 at pi/4.
double sin_kernel(double x) {
  const double z = x * x;
  double s = std::fma(z, 2.8114572543455206e-15, -7.6471637318198164e-13);
  s = std::fma(z, s, 1.6059043836821613e-10);
  s = std::fma(z, s, -2.5052108385441720e-08);
  s = std::fma(z, s, 2.7557319223985893e-06);
  s = std::fma(z, s, -1.9841269841269841e-04);
  s = std::fma(z, s, 8.3333333333333332e-03);
  s = std::fma(z, s, -1.6666666666666666e-01);
  return std::fma(x * z, s, x);
}

double cos_kernel(double x) {
  const double z = x * x;
  double c = std::fma(z, -1.5619206968586225e-16, 4.7794773323873853e-14);
  c = std::fma(z, c, -1.1470745597729725e-11);
  c = std::fma(z, c, 2.0876756987868099e-09);
  c = std::fma(z, c, -2.7557319223985888e-07);
  c = std::fma(z, c, 2.4801587301587302e-05);
  c = std::fma(z, c, -1.3888888888888889e-03);
  c = std::fma(z, c, 4.1666666666666664e-02);
  const double half = 0.5 * z;
  const double w = 1.0 - half;
  return w + (((1.0 - w) - half) + z * z * c);
}

// atan on [0, tan(pi/16)]: odd series to t^23; the next term is below 1e-18.
double atan_kernel(double t) {
  const double z = t * t;
  double s = -1.0 / 23.0;
  s = std::fma(z, s, 1.0 / 21.0);
  s = std::fma(z, s, -1.0 / 19.0);
  s = std::fma(z, s, 1.0 / 17.0);
  s = std::fma(z, s, -1.0 / 15.0);
  s = std::fma(z, s, 1.0 / 13.0);
  s = std::fma(z, s, -1.0 / 11.0);
  s = std::fma(z, s, 1.0 / 9.0);
  s = std::fma(z, s, -1.0 / 7.0);
  s = std::fma(z, s, 1.0 / 5.0);
  s = std::fma(z, s, -1.0 / 3.0);
  return std::fma(t * z, s, t);
}

// tan and value of k pi/8 for k = 0, 1, 2.
constexpr double kTan1 = 4.14213562373095034468e-01;
constexpr double kAngle1 = 3.92699081698724139500e-01;
constexpr double kAngle1Low = 1.53080849893419158600e-17;
constexpr double kAngle2 = 7.85398163397448279e-01;
constexpr double kAngle2Low = 3.06161699786838301793e-17;

}  // namespace

SinCos sin_cos(double x) {
  const double k = std::nearbyint(x * kTwoOverPi);
  const double r = std::fma(-k, kHalfPi3, std::fma(-k, kHalfPi2, std::fma(-k, kHalfPi1, x)));
  const double s = sin_kernel(r);
  const double c = cos_kernel(r);
  switch (static_cast<long>(k) & 3) {
    case 0:
      return {s, c};
    case 1:
      return {c, -s};
    case 2:
      return {-s, -c};
    default:
      return {-c, s};
  }
}

double atan2(double y, double x) {
  const double ay = std::fabs(y);
  const double ax = std::fabs(x);
  const bool swapped = ay > ax;
  const double big = swapped ? ay : ax;
  const double small = swapped ? ax : ay;
  if (big == 0) return 0;
  // Angle in [0, pi/4] = base + atan(t) with |t| <= tan(pi/16).
  double base = 0;
  double base_low = 0;
  double t = small / big;
  if (t > 6.68178637919298878e-01) {  // tan(3 pi/16)
    t = (small - big) / (small + big);
    base = kAngle2;
    base_low = kAngle2Low;
  } else if (t > 1.98912367379658006e-01) {  // tan(pi/16)
    t = std::fma(-kTan1, big, small) / std::fma(kTan1, small, big);
    base = kAngle1;
    base_low = kAngle1Low;
  }
  const double sign_t = t < 0 ? -1.0 : 1.0;
  double angle = base + (sign_t * atan_kernel(std::fabs(t)) + base_low);
  if (swapped) angle = kPi / 2 - (angle - kPiLow / 2);
  if (x < 0) angle = kPi - (angle - kPiLow);
  return y < 0 ? -angle : angle;
}

double tan(double x) {
  const SinCos a = sin_cos(x);
  return a.sin / a.cos;
}

double decay(double x) {
  if (x > 64) return 0;
  // exp(-x) = (exp(-x/64))^64; 20 terms leave 1e-20 for x <= 64.
  const double y = x / 64;
  double value = 1;
  for (int k = 20; k >= 1; --k) value = 1 - y / k * value;
  for (int k = 0; k < 6; ++k) value *= value;
  return value;
}

}  // namespace omentum::trig
