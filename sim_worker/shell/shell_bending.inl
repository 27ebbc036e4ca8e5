// Bending in the lane kernel of the elastic shell: included by shell_kernel.inl. Per stencil
// (plate_stencils.h), with D the second derivatives, t_x and t_y the tangents of the sheet:
//   c = t_x x t_y,   n = c / |c|,   k = n . D x,   m = stiffness k - rest moment, then its memory
//   dE = m . dk = n . (m D dx) + q . dn,   q = m D x
//   q . dn = p . (dt_x x t_y + t_x x dt_y) = dt_x . (t_y x p) + dt_y . (p x t_x),
//   p = (q - (n . q) n) / |c|
// The second part is small, of the order of moments times gradients of strain in the plane; it
// makes the forces those of an energy, without a couple on the sheet as a whole.

namespace {

struct Moments {
  Lane xx, yy, xy;
};
inline Moments load_moments(const Real* p) {
  return {load(p), load(p + kLanes), load(p + 2 * kLanes)};
}
inline void store_moments(Real* p, Moments m) {
  store(p, m.xx);
  store(p + kLanes, m.yy);
  store(p + 2 * kLanes, m.xy);
}
inline Moments select(Mask mask, Moments a, Moments b) {
  return {select(mask, a.xx, b.xx), select(mask, a.yy, b.yy), select(mask, a.xy, b.xy)};
}
inline Moments fma(Lane s, Moments a, Moments c) {
  return {fma(s, a.xx, c.xx), fma(s, a.yy, c.yy), fma(s, a.xy, c.xy)};
}
inline Moments operator+(Moments a, Moments b) { return {a.xx + b.xx, a.yy + b.yy, a.xy + b.xy}; }
inline Moments operator-(Moments a, Moments b) { return {a.xx - b.xx, a.yy - b.yy, a.xy - b.xy}; }
inline Moments operator*(Lane s, Moments a) { return {s * a.xx, s * a.yy, s * a.xy}; }

/// The sheet at a stencil.
struct Bend {
  Lane3 xx, yy, xy;        // D x
  Lane3 along_x, along_y;  // tangents
  Lane3 normal;
  Lane inverse;  // 1 / |c|
  Mask folded;   // |c| at its least
};

/// kAxes, kTwist: which of xx with yy and xy the stencil has.
template <bool kAxes, bool kTwist>
inline Bend find_bend(const Args& args, const omentum::BendStencil<Real>& stencil) {
  const Lane3 base = load3(args.moved + 3 * kLanes * stencil.base);
  Bend at{zero3(), zero3(), zero3(), zero3(), zero3(), zero3(), splat(Real{0}), to_mask(0)};
  for (int k = stencil.entry_begin; k < stencil.entry_end; ++k) {
    const auto& entry = args.bend_entry[k];
    const Lane3 to = load3(args.moved + 3 * kLanes * entry.node) - base;
    if (kAxes) {
      at.xx = fma(splat(entry.weight[0]), to, at.xx);
      at.yy = fma(splat(entry.weight[1]), to, at.yy);
    }
    if (kTwist) at.xy = fma(splat(entry.weight[2]), to, at.xy);
    at.along_x = fma(splat(entry.weight[3]), to, at.along_x);
    at.along_y = fma(splat(entry.weight[4]), to, at.along_y);
  }
  const Lane3 c = cross(at.along_x, at.along_y);
  const Lane size2 = dot(c, c);
  const Lane least2 = splat(static_cast<Real>(omentum::kLeastNormal * omentum::kLeastNormal));
  at.folded = size2 < least2;
  at.inverse = splat(Real{1}) / sqrt(max(size2, least2));
  at.normal = at.inverse * c;
  return at;
}

/// Without memory.
inline Moments elastic_moments(const Args& args, const Bend& at, int s) {
  const Real* const nominal = args.stencil[s].stiffness;
  const Real* const lanes = args.effects.plate;
  const auto term = [&](int k) {
    return lanes == nullptr ? splat(nominal[k]) : load(lanes + (4 * s + k) * kLanes);
  };
  const Lane xx = dot(at.normal, at.xx);
  const Lane yy = dot(at.normal, at.yy);
  const Lane xy = dot(at.normal, at.xy);
  const Moments m{fma(term(0), xx, term(2) * yy), fma(term(1), yy, term(2) * xx), term(3) * xy};
  const Moments scaled = load(args.stiffness) * m;
  if (args.effects.rest_moment == nullptr) return scaled;
  return scaled - load_moments(args.effects.rest_moment + 3 * kLanes * s);
}

/// With the Prony branches on each moment: scalars of the material, so they rotate with the sheet.
inline Moments relaxed_moments(const Args& args, Moments m, int s) {
  const Moments bias = load_moments(args.effects.moment_bias + 3 * kLanes * s);
  const Moments total = fma(load(args.effects.prony_gains), m, m) + bias;
  return select(to_mask(args.effects.prony), total, m);
}

/// The face that touches is at x - face_height n when the sheet is pushed this way: half of its
/// thickness [m], of the other sign on the other side and little where it is pushed at its rim.
inline Lane face_height(const Args& args, Lane3 normal, Lane3 force) {
  const Lane one = splat(Real{1});
  const Lane slope = splat(Real{4}) * inverse_length(force) * dot(normal, force);
  return load(args.particle_radius) * max(splat(Real{0}) - one, min(one, slope));
}

template <bool kAxes, bool kTwist>
void add_bending(const Args& args, int begin, int end) {
  const Lane zero = splat(Real{0});
  for (int s = begin; s < end; ++s) {
    const auto& stencil = args.stencil[s];
    const Bend at = find_bend<kAxes, kTwist>(args, stencil);
    Moments m = elastic_moments(args, at, s);
    if (args.effects.prony != 0) m = relaxed_moments(args, m, s);
    Lane3 q = zero3();
    if (kAxes) q = fma(m.yy, at.yy, m.xx * at.xx);
    if (kTwist) q = fma(m.xy, at.xy, q);
    if (args.has_contact && s < args.nodes && args.contact_lanes[s] != 0) {
      // A contact force works on the face: -force . d(x - height n).
      const Lane3 force = load3(args.contact_force + 3 * kLanes * s);
      q = fma(face_height(args, at.normal, force), force, q);
    }
    const Lane along = select(at.folded, zero, dot(at.normal, q));
    const Lane3 p = at.inverse * fnma(along, at.normal, q);
    const Lane3 on_x = cross(at.along_y, p);
    const Lane3 on_y = cross(p, at.along_x);
    // The node at the base gets minus the sum of the forces on the others: momentum is kept.
    Lane3 sum = zero3();
    for (int k = stencil.entry_begin; k < stencil.entry_end; ++k) {
      const auto& entry = args.bend_entry[k];
      Lane size = zero;
      if (kAxes) size = fma(splat(entry.weight[1]), m.yy, splat(entry.weight[0]) * m.xx);
      if (kTwist) size = fma(splat(entry.weight[2]), m.xy, size);
      const Lane3 force =
          fma(splat(entry.weight[4]), on_y, fma(splat(entry.weight[3]), on_x, size * at.normal));
      Real* const b = args.b + 3 * kLanes * entry.node;
      store3(b, load3(b) + force);
      sum = sum + force;
    }
    Real* const b = args.b + 3 * kLanes * stencil.base;
    store3(b, load3(b) - sum);
  }
}

/// A grid has its twist in cells, a mesh all three at nodes.
void add_bending(const Args& args) {
  if (args.mesh != nullptr) return add_bending<true, true>(args, 0, args.stencils);
  const int ny = args.count_y;
  for (int ix = 0; ix < args.count_x; ++ix) {  // row by row: the nodes stay in the cache
    add_bending<true, false>(args, ny * ix, ny * (ix + 1));
    if (ix + 1 == args.count_x) continue;
    const int cells = args.nodes + (ny - 1) * ix;
    add_bending<false, true>(args, cells, cells + ny - 1);
  }
}

/// End of a substep: the branches on the moments.
void remember_bending(const Args& args) {
  const auto& fx = args.effects;
  const Mask lanes = to_mask(fx.prony);
  for (int s = 0; s < args.stencils; ++s) {
    const int at = 3 * kLanes * s;
    const Moments now = elastic_moments(args, find_bend<true, true>(args, args.stencil[s]), s);
    const Moments old = load_moments(fx.moment + at);
    const Moments change = now - old;
    const Lane zero = splat(Real{0});
    Moments bias{zero, zero, zero};
    for (int k = 0; k < fx.branches; ++k) {
      Real* const memory = fx.moment_branch + 3LL * kLanes * args.stencils * k + at;
      const Lane keep = load(fx.prony_keep + k * kLanes);
      const Lane gain = load(fx.prony_gain + k * kLanes);
      const Moments before = load_moments(memory);
      const Moments branch = fma(gain, change, keep * before);
      store_moments(memory, select(lanes, branch, before));
      bias = fma(keep, branch, fma(zero - gain, now, bias));
    }
    store_moments(fx.moment + at, select(lanes, now, old));
    store_moments(fx.moment_bias + at, select(lanes, bias, load_moments(fx.moment_bias + at)));
  }
}

}  // namespace
