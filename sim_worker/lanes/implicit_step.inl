// Start and end of an implicit substep of shell and solid in the displacement d = x - x_n: backward
// Euler, or BDF2 with two substeps of history.

namespace {

/// Displacement of a node free of forces: h v_n, or with BDF2 the same with extrapolated velocity.
template <typename Args>
inline Lane3 inertial_displacement(const Args& args, int i) {
  const Lane step = splat(args.effective_step);
  const Lane3 v = load3(args.v + 3 * kLanes * i);
  if (!args.second_order) return step * v;
  const Lane third = splat(args.third);
  const Lane3 v_old = load3(args.v_old + 3 * kLanes * i);
  const Lane3 d_old = load3(args.d_old + 3 * kLanes * i);
  const Lane3 extrapolated = third * (fma(splat(Real{3}), v, v) - v_old);
  return fma(step, extrapolated, third * d_old);
}

/// End of the substep: v = keep d / h (with BDF2 keep (d - d_old / 3) / h), x = x_n + d.
template <typename Args>
inline void take_displacements(const Args& args) {
  const Lane keep = load(args.keep) * splat(args.inverse_step);
  for (int i = 0; i < args.nodes; ++i) {
    const int at = 3 * kLanes * i;
    const Lane3 d = load3(args.d + at);
    Lane3 moved = d;
    if (args.second_order) {
      moved = d - splat(args.third) * load3(args.d_old + at);
      store3(args.v_old + at, load3(args.v + at));
      store3(args.d_old + at, d);
    }
    store3(args.v + at, keep * moved);
    store3(args.x + at, load3(args.x + at) + d);
  }
}

}  // namespace
