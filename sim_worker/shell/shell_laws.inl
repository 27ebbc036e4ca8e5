// Laws of elasticity of the shell's triangles in plane stress: included by shell_effects.inl. With
// C = F^T F = [p q; q r] and delta = det F; `shear` and `area` are 2 mu and lambda of plane stress,
// times t / 2.

namespace {

using omentum::ShellLaw;

struct Stress {
  Lane xx, xy, yy;  // force on the legs per length: second Piola-Kirchhoff stress x t / 2 [N/m]
};

/// delta^2. 1e-20: a triangle squeezed to a line stays finite.
inline Lane squared_area(Lane p, Lane q, Lane r) {
  return max(fnma(q, q, p * r), splat(static_cast<Real>(1e-20)));
}

/// With F = R U: tau = tr U, U^-1 = [r + delta, -q; -q, p + delta] / (delta tau),
/// dPsi/dF = 2 mu (F - R) + lambda (tau - 2) R = F (2 mu - k U^-1),  k = 2 mu - lambda (tau - 2)
inline Stress corotated_stress(Lane p, Lane q, Lane r, Lane shear, Lane area) {
  const Lane delta = sqrt(squared_area(p, q, r));
  const Lane two = splat(Real{2});
  const Lane tau = sqrt(fma(two, delta, p + r));
  const Lane k = fnma(area, tau - two, shear);
  const Lane s = k / (delta * tau);
  return {fnma(s, r + delta, shear), s * q, fnma(s, p + delta, shear)};
}

/// ln x of 0.02 ... 50 to 1e-7, beyond that less and less of it: 8 artanh((y - 1) / (y + 1)) of
/// y^4 = x by its series.
inline Lane logarithm(Lane x) {
  const Lane one = splat(Real{1});
  const Lane y = sqrt(sqrt(x));
  const Lane z = (y - one) / (y + one);
  const Lane z2 = z * z;
  Lane sum = splat(Real{1} / 17);
  for (int k = 15; k >= 1; k -= 2) sum = fma(z2, sum, splat(Real{1} / static_cast<Real>(k)));
  return splat(Real{8}) * z * sum;
}

/// e^x by the series of x / 8.
inline Lane power_of_e(Lane x) {
  const Lane y = splat(static_cast<Real>(0.125)) * x;
  Lane sum = splat(Real{1});
  for (int k = 10; k >= 1; --k)
    sum = fma(splat(Real{1} / static_cast<Real>(k)) * y, sum, splat(Real{1}));
  for (int squaring = 0; squaring < 3; ++squaring) sum = sum * sum;
  return sum;
}

/// Of neo-Hooke, mu / 2 (tr C - 3 - 2 ln J) + lambda / 2 (ln J)^2 in three dimensions. Plane stress
/// makes c = C_33 the root of c - 1 + L (ln delta + ln c / 2) = 0 with L = lambda / mu.
struct Thickness {
  Lane c;           ///< squared stretch through the thickness
  Lane log_volume;  ///< ln J
  Lane squared;  ///< delta^2, 0.04 at least: what is squeezed to less than a fifth stiffens no more
};
inline Thickness neo_hooke_thickness(const Args& args, Lane p, Lane q, Lane r) {
  const Lane one = splat(Real{1});
  const Lane two = splat(Real{2});
  const Lane n = load(args.effects.lateral);  // nu / (1 - nu), so L = 2 n / (1 - n)
  const Lane ratio = two * n / (one - n);
  const Lane squared = max(squared_area(p, q, r), splat(static_cast<Real>(0.04)));
  const Lane log = splat(static_cast<Real>(0.5)) * logarithm(squared);
  // Newton for w = ln c / 2, where the function is convex, from its root about w = 0.
  Lane w = splat(Real{0}) - ratio * log / (two + ratio);
  Lane c = power_of_e(two * w);
  for (int iteration = 0; iteration < 3; ++iteration) {
    w = w - fma(ratio, log + w, c - one) / fma(two, c, ratio);
    c = power_of_e(two * w);
  }
  return {c, log + w, squared};
}

/// S = mu (I - c C^-1): the root makes lambda ln J = mu (1 - c).
inline Stress neo_hooke_stress(const Args& args, Lane p, Lane q, Lane r, Lane shear) {
  const Thickness through = neo_hooke_thickness(args, p, q, r);
  const Lane mu = splat(static_cast<Real>(0.5)) * shear;
  const Lane s = mu * through.c / through.squared;
  return {fnma(s, r, mu), s * q, fnma(s, p, mu)};
}

/// S = 2 mu E + lambda tr E.
inline Stress st_venant_stress(Lane p, Lane q, Lane r, Lane shear, Lane area) {
  const Lane half = splat(static_cast<Real>(0.5));
  const Lane xx = fnma(half, splat(Real{1}), half * p);
  const Lane yy = fnma(half, splat(Real{1}), half * r);
  const Lane mean = area * (xx + yy);
  return {fma(shear, xx, mean), shear * (half * q), fma(shear, yy, mean)};
}

template <ShellLaw kLaw>
inline Stress law_stress(const Args& args, Lane p, Lane q, Lane r, Lane shear, Lane area) {
  if constexpr (kLaw == ShellLaw::kNeoHooke) return neo_hooke_stress(args, p, q, r, shear);
  if constexpr (kLaw == ShellLaw::kStVenant) return st_venant_stress(p, q, r, shear, area);
  return corotated_stress(p, q, r, shear, area);
}

/// Energy per volume / (2 mu) of the law.
inline Lane law_energy(const Args& args, Stress c) {
  const Lane one = splat(Real{1});
  const Lane half = splat(static_cast<Real>(0.5));
  const Lane n = load(args.effects.lateral);
  const auto squares = [](Stress e) {
    return fma(splat(Real{2}) * e.xy, e.xy, fma(e.yy, e.yy, e.xx * e.xx));
  };
  if (args.law == ShellLaw::kNeoHooke) {
    const Thickness through = neo_hooke_thickness(args, c.xx, c.xy, c.yy);
    const Lane ratio = splat(Real{2}) * n / (one - n);
    const Lane log = through.log_volume;
    const Lane quarter = splat(static_cast<Real>(0.25));
    const Lane sum = quarter * (c.xx + c.yy + through.c - splat(Real{3}));
    return fma(quarter * ratio * log, log, fnma(half, log, sum));
  }
  if (args.law == ShellLaw::kStVenant) {
    const Stress e{fnma(half, one, half * c.xx), half * c.xy, fnma(half, one, half * c.yy)};
    const Lane trace = e.xx + e.yy;
    return half * fma(n * trace, trace, squares(e));
  }
  // |U - I|^2 / 2 + lambda / (4 mu) tr(U - I)^2 with U = (C + delta I) / tau.
  const Lane delta = sqrt(squared_area(c.xx, c.xy, c.yy));
  const Lane tau = sqrt(fma(splat(Real{2}), delta, c.xx + c.yy));
  const Lane scale = one / tau;
  const Stress u{fma(scale, c.xx + delta, splat(Real{-1})), scale * c.xy,
                 fma(scale, c.yy + delta, splat(Real{-1}))};
  const Lane trace = u.xx + u.yy;
  return half * fma(n * trace, trace, squares(u));
}

/// Bound of its tangent over that at rest, for the factor: of neo-Hooke that of a bar shortened
/// like the shortest direction, (1 + 3 / l^4) / 4, of St. Venant-Kirchhoff that of one stretched
/// like the longest, (3 l^2 - 1) / 2.
inline Lane law_tangent(const Args& args, Stress c) {
  const Lane one = splat(Real{1});
  const Lane half = splat(static_cast<Real>(0.5));
  const Lane off = half * (c.xx - c.yy);
  const Lane spread = sqrt(fma(off, off, c.xy * c.xy));
  const Lane mean = half * (c.xx + c.yy);
  if (args.law == ShellLaw::kStVenant)
    return max(one, half * fma(splat(Real{3}), mean + spread, splat(Real{-1})));
  const Lane least = max(mean - spread, splat(static_cast<Real>(0.2)));
  const Lane quarter = splat(static_cast<Real>(0.25));
  return max(one, quarter * fma(splat(Real{3}), one / (least * least), one));
}

}  // namespace
