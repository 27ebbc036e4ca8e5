#pragma once

namespace omentum::trig {

/// sin, cos, atan2 and exp in double precision from basic operations only: the same bits on every
/// machine, which no library promises (glibc picks its versions by CPU at load time).
///
/// sin_cos: argument reduced by pi/2 in three parts (Cody-Waite), minimax-like Taylor kernels on
/// [-pi/4, pi/4]; absolute error < 2.3e-16 for |x| <= 100. atan2: reduction to [0, tan(pi/16)] by a
/// table of four angles and the odd series; error < 2.3e-16 of the quadrant, atan2(0, 0) = 0. Tests
/// compare both with libm. Precondition of sin_cos and tan: x is finite and |x| < 1e6, beyond which
/// the reduction loses its digits.
struct SinCos {
  double sin, cos;
};
SinCos sin_cos(double x);
double atan2(double y, double x);
/// tan from the two of sin_cos.
double tan(double x);
/// exp(-x) for x >= 0 by its series; relative error < 1e-14.
double decay(double x);

}  // namespace omentum::trig
