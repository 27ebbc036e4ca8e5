// e^x of the lanes without loss of digits near 0, for the exponential stiffening of shell and
// solid. Include guards are those of its includers.

namespace {

/// Beyond this the exponential goes on as its tangent: there a strain is resisted 1,600 times as
/// much, as far as the factors of the shell follow.
constexpr Real kLargestExponent = 5;

struct Exponential {
  Lane minus_one;  ///< e^x - 1
  Lane excess;     ///< e^x - 1 - x
  Lane slope;      ///< e^x, 0 beyond kLargestExponent
};

/// Of x >= 0. With y = x / 64 by the series, then six times e^2y - 1 = (e^y - 1)(e^y + 1) and
/// e^2y - 1 - 2y = (e^y - 1)^2 + 2 (e^y - 1 - y): sums of positive terms.
inline Exponential exponential(Lane x) {
  const Lane one = splat(Real{1});
  const Lane two = splat(Real{2});
  const Lane most = splat(kLargestExponent);
  const Lane inside = min(x, most);
  const Lane y = splat(Real{1} / 64) * inside;
  Lane sum = one;
  for (int k = 13; k >= 3; --k) sum = fma(splat(Real{1} / static_cast<Real>(k)) * y, sum, one);
  Lane excess = splat(static_cast<Real>(0.5)) * y * y * sum;
  Lane minus_one = y + excess;
  for (int doubling = 0; doubling < 6; ++doubling) {
    excess = fma(minus_one, minus_one, two * excess);
    minus_one = minus_one * (two + minus_one);
  }
  const Lane over = x - inside;
  return {minus_one, fma(minus_one, over, excess),
          select(most < x, splat(Real{0}), one + minus_one)};
}

}  // namespace
