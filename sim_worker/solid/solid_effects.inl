// Effects in the lane kernel of the elastic solid: included by solid_kernel.inl. Every function
// changes only the lanes in which its effect is on; the others keep their bits, so that a lane does
// not depend on its neighbours. Laws: HexEffects (hexahedron.h) has the same.

namespace {

/// Symmetric tensor in B: xx, yy, zz, yz, xz, xy.
struct Tensor {
  Lane v[6];
};

inline Tensor load_tensor(const Real* p) {
  Tensor t;
  for (int k = 0; k < 6; ++k) t.v[k] = load(p + kLanes * k);
  return t;
}
inline void store_tensor(Real* p, const Tensor& t) {
  for (int k = 0; k < 6; ++k) store(p + kLanes * k, t.v[k]);
}
inline Tensor zero_tensor() {
  Tensor t;
  for (Lane& v : t.v) v = splat(Real{0});
  return t;
}
inline Tensor operator*(Lane s, const Tensor& a) {
  Tensor t;
  for (int k = 0; k < 6; ++k) t.v[k] = s * a.v[k];
  return t;
}
inline Tensor fma(Lane s, const Tensor& a, const Tensor& c) {
  Tensor t;
  for (int k = 0; k < 6; ++k) t.v[k] = fma(s, a.v[k], c.v[k]);
  return t;
}
inline Tensor operator-(const Tensor& a, const Tensor& b) {
  Tensor t;
  for (int k = 0; k < 6; ++k) t.v[k] = a.v[k] - b.v[k];
  return t;
}
inline Tensor select(Mask m, const Tensor& a, const Tensor& b) {
  Tensor t;
  for (int k = 0; k < 6; ++k) t.v[k] = select(m, a.v[k], b.v[k]);
  return t;
}
inline Lane inner(const Tensor& a, const Tensor& b) {
  const Lane diagonal = fma(a.v[2], b.v[2], fma(a.v[1], b.v[1], a.v[0] * b.v[0]));
  const Lane beside = fma(a.v[5], b.v[5], fma(a.v[4], b.v[4], a.v[3] * b.v[3]));
  return fma(splat(Real{2}), beside, diagonal);
}

inline Matrix select(Mask m, const Matrix& a, const Matrix& b) {
  Matrix r;
  for (int k = 0; k < 3; ++k) r.column[k] = select(m, a.column[k], b.column[k]);
  return r;
}
inline Matrix fma(Lane s, const Matrix& a, const Matrix& c) {
  Matrix r;
  for (int k = 0; k < 3; ++k) r.column[k] = fma(s, a.column[k], c.column[k]);
  return r;
}
inline Lane inner(const Matrix& a, const Matrix& b) {
  return dot(a.column[0], b.column[0]) + dot(a.column[1], b.column[1]) +
         dot(a.column[2], b.column[2]);
}

/// F S.
inline Matrix times(const Matrix& f, const Tensor& s) {
  const Lane3* const c = f.column;
  const auto sum = [c](Lane x, Lane y, Lane z) { return fma(z, c[2], fma(y, c[1], x * c[0])); };
  return {{sum(s.v[0], s.v[5], s.v[4]), sum(s.v[5], s.v[1], s.v[3]), sum(s.v[4], s.v[3], s.v[2])}};
}

/// Symmetric part of A^T B.
inline Tensor symmetric_product(const Matrix& a, const Matrix& b) {
  const Lane half = splat(static_cast<Real>(0.5));
  const auto mixed = [&](int i, int k) {
    return half * (dot(a.column[i], b.column[k]) + dot(b.column[i], a.column[k]));
  };
  return {{dot(a.column[0], b.column[0]), dot(a.column[1], b.column[1]),
           dot(a.column[2], b.column[2]), mixed(1, 2), mixed(0, 2), mixed(0, 1)}};
}

/// E = (F^T F - I) / 2.
inline Tensor green_strain(const Matrix& f) {
  const Lane half = splat(static_cast<Real>(0.5));
  const Lane3* const c = f.column;
  const auto stretch = [half](Lane3 a) { return half * dot(a, a) - half; };
  return {{stretch(c[0]), stretch(c[1]), stretch(c[2]), half * dot(c[1], c[2]),
           half * dot(c[0], c[2]), half * dot(c[0], c[1])}};
}

// ---------------------------------------------------------------------------------------------------------------------
// Material. With all of them the stress at a point is
//   P = (1 + gains) left P_law + F S,   S = (1 + gains) (left S_stiffening + S_fibres) + bias +
//   S_slider.

/// S, the share of the law's own stress, and dS = identity dE + sum weight_k T_k (T_k : dE): of
/// stiffening, fibres and the slider.
struct Response {
  Tensor stress;
  Lane law;
  Lane identity;
  Lane weight[3];
  Tensor direction[3];
};

inline void scale_response(Lane s, Response& r) {
  r.stress = s * r.stress;
  r.law = s * r.law;
  r.identity = s * r.identity;
  r.weight[0] = s * r.weight[0];
  r.weight[1] = s * r.weight[1];
}

/// Of W(I), I = 2 E : E: the stress 4 W' E and its change 4 W' dE + 16 W'' E (E : dE).
struct Stiffening {
  Lane scale, weight;
};

/// Energy c2 I^2, and mu/(2b) (exp(b I) - 1 - b I) of an exponential law.
inline Stiffening stiffening_of(const Args& args, Lane square) {
  const auto& fx = args.effects;
  const Lane c2 = load(fx.stiffening_scale);
  Stiffening s{splat(Real{16}) * c2 * square, splat(Real{32}) * c2};
  if (fx.exponential == 0) return s;
  const Mask lanes = to_mask(fx.exponential);
  const Lane b = load(fx.exponential_rate);
  const Lane scale = load(fx.exponential_scale);
  const Exponential e = exponential(splat(Real{2}) * b * square);
  s.scale = select(lanes, fma(scale, e.minus_one, s.scale), s.scale);
  s.weight = select(lanes, fma(splat(Real{4}) * b * scale, e.slope, s.weight), s.weight);
  return s;
}

inline void add_stiffening(const Args& args, const Tensor& e, Response& r) {
  const Mask lanes = to_mask(args.effects.stiffening);
  const Stiffening s = stiffening_of(args, inner(e, e));
  r.stress = select(lanes, fma(s.scale, e, r.stress), r.stress);
  r.identity = select(lanes, r.identity + s.scale, r.identity);
  r.weight[0] = s.weight;
  r.direction[0] = e;
}

/// Tension of the fibres, with a smooth corner of w = 1e-3 strain: (E4 + sqrt(E4^2 + w^2) - w) / 2.
inline void add_fibres(const Args& args, const Tensor& e, Response& r) {
  const Lane half = splat(static_cast<Real>(0.5));
  const Lane w = splat(static_cast<Real>(1e-3));
  const Lane modulus = load(args.effects.fibre);
  Tensor a = zero_tensor();
  a.v[0] = load(args.effects.fibre_axes);
  a.v[1] = load(args.effects.fibre_axes + kLanes);
  a.v[5] = load(args.effects.fibre_axes + 2 * kLanes);
  const Lane along = inner(a, e);
  const Lane smooth = sqrt(fma(along, along, w * w));
  const Lane taut = half * modulus * ((along + smooth) - w);
  r.stress = select(to_mask(args.effects.fibres), fma(taut, a, r.stress), r.stress);
  r.weight[1] = half * modulus * (splat(Real{1}) + along / smooth);
  r.direction[1] = a;
}

/// Strain beyond the plastic strain, and the share of it that the spring carries: up to the yield.
struct Slide {
  Tensor off;
  Lane size, carried;
};

inline Slide slide_of(const Args& args, const Tensor& e, int point) {
  Slide s;
  s.off = e - load_tensor(args.effects.plastic + 6 * kLanes * point);
  s.size = sqrt(max(inner(s.off, s.off), splat(static_cast<Real>(1e-20))));
  s.carried = min(splat(Real{1}), load(args.effects.slider_yield) / s.size);
  return s;
}

inline void add_slider(const Args& args, const Tensor& e, int point, Response& r) {
  const Mask lanes = to_mask(args.effects.slider);
  const Slide s = slide_of(args, e, point);
  const Lane zero = splat(Real{0});
  const Lane held = load(args.effects.slider_scale) * s.carried;
  r.stress = select(lanes, fma(held, s.off, r.stress), r.stress);
  r.identity = select(lanes, r.identity + held, r.identity);
  const Mask slides = load(args.effects.slider_yield) < s.size;
  r.weight[2] = select(slides, zero - held / (s.size * s.size), zero);
  r.direction[2] = s.off;
}

/// Elastic part of the effects, of which Prony branches remember the history; `left` by softening.
inline Response respond_elastic(const Args& args, const Tensor& e, Lane left) {
  const auto& fx = args.effects;
  Response r;
  r.stress = zero_tensor();
  r.law = splat(Real{1});
  r.identity = r.weight[0] = r.weight[1] = r.weight[2] = splat(Real{0});
  if (fx.stiffening != 0) add_stiffening(args, e, r);
  if (fx.softening != 0) scale_response(left, r);
  if (fx.fibres != 0) add_fibres(args, e, r);
  return r;
}

inline Response respond(const Args& args, const Tensor& e, int point, Lane left) {
  const auto& fx = args.effects;
  Response r = respond_elastic(args, e, left);
  if (fx.prony != 0) {
    const Mask lanes = to_mask(fx.prony);
    const Lane one = splat(Real{1});
    scale_response(select(lanes, one + load(fx.prony_gains), one), r);
    const Tensor bias = load_tensor(fx.bias + 6 * kLanes * point);
    r.stress = select(lanes, fma(one, bias, r.stress), r.stress);
  }
  if (fx.slider != 0) add_slider(args, e, point, r);
  return r;
}

/// Adds F dS to a change of the stress.
inline Matrix add_strain_change(const Args& args, const Response& r, const Matrix& f,
                                const Matrix& df, const Matrix& dp) {
  const auto& fx = args.effects;
  const std::uint32_t masks[3] = {fx.stiffening, fx.fibres, fx.slider};
  const std::uint32_t any = masks[0] | masks[1] | masks[2];
  if (any == 0) return dp;
  const Tensor de = symmetric_product(f, df);
  Tensor ds = r.identity * de;
  for (int k = 0; k < 3; ++k) {
    if (masks[k] == 0) continue;
    const Tensor& to = r.direction[k];
    ds = select(to_mask(masks[k]), fma(r.weight[k] * inner(to, de), to, ds), ds);
  }
  return select(to_mask(any), fma(splat(Real{1}), times(f, ds), dp), dp);
}

/// log(1 + t / 2) = 2 atanh(t / (4 + t)), by the series of atanh: no libm in lanes. Its error is
/// below 1e-9 for stretches up to 1.5, far below what softening needs.
inline Lane log_of_half(Lane t) {
  const Lane z = t / (splat(Real{4}) + t);
  const Lane z2 = z * z;
  Lane sum = splat(Real{1} / 21);
  for (int k = 19; k >= 1; k -= 2) sum = fma(sum, z2, splat(Real{1} / static_cast<Real>(k)));
  return splat(Real{2}) * z * sum;
}

/// Energy per volume of an element, law and stiffening as if nothing were softened, at the nominal
/// stiffness: what the points' stresses are the derivative of.
inline Lane element_energy(const Args& args, const Law& law, const Element& element) {
  const auto& fx = args.effects;
  const Lane one = splat(Real{1});
  const Lane half = splat(static_cast<Real>(0.5));
  Lane sum = splat(Real{0});
  Lane volume = splat(Real{0});
  for (int q = 0; q < 4; ++q) {
    const Tensor e = green_strain(element.f[q]);
    const Lane trace = e.v[0] + e.v[1] + e.v[2];
    const Lane grown = element.point[q].jacobian - one;
    Lane w = law.mu * (trace - half * log_of_half(trace));
    w = fma(law.lambda * grown, fma(half, grown, one - law.alpha), w);
    if (fx.stiffening != 0) {
      const Lane square = inner(e, e);
      Lane stiff = fma(splat(Real{4}) * load(fx.stiffening_scale) * square, square, w);
      if (fx.exponential != 0) {
        const Lane b = load(fx.exponential_rate);
        const Lane tiny = splat(static_cast<Real>(1e-20));
        const Lane excess = exponential(splat(Real{2}) * b * square).excess;
        const Lane more = load(fx.exponential_scale) * excess / (splat(Real{4}) * max(b, tiny));
        stiff = select(to_mask(fx.exponential), stiff + more, stiff);
      }
      w = select(to_mask(fx.stiffening), stiff, w);
    }
    sum = fma(element.weight[q], w, sum);
    volume = fma(element.weight[q], grown, volume);
  }
  const Lane mean = element.mean * volume;
  return fma(half * law.bulk * mean, mean, element.mean * sum);
}

/// Share of an element's stress that is left, 1 - softening s (3 - s^2) / 2 as in softened_share()
/// of the shell, and how it grows with the energy.
struct Softened {
  Lane left, slope;
};

inline Softened soften(const Args& args, const Law& law, const Element& element, int t) {
  const auto& fx = args.effects;
  const Lane zero = splat(Real{0});
  const Lane one = splat(Real{1});
  if (fx.softening == 0) return {one, zero};
  const Mask lanes = to_mask(fx.softening);
  const Lane peak = load(fx.energy_peak + kLanes * t);
  const Lane below = max(peak - element_energy(args, law, element), zero);
  const Lane scale = one / (load(fx.softening_energy) + peak);
  const Lane v = below * scale;
  const Lane q = sqrt(fma(v, v, one));
  const Lane s = v / q;
  const Lane share = load(fx.softening_share);
  const Lane lost = splat(static_cast<Real>(0.5)) * s * fnma(s, s, splat(Real{3}));
  const Lane steep = splat(static_cast<Real>(1.5)) * share * scale / (q * q * q * q * q);
  return {select(lanes, fnma(share, lost, one), one), select(zero < below, steep, zero)};
}

/// Law and stiffening at a point before they are softened.
inline Matrix unsoftened(const Args& args, const Matrix& f, const Point& point) {
  const Matrix p = stress(f, point);
  if (args.effects.stiffening == 0) return p;
  const Tensor e = green_strain(f);
  const Lane scale = stiffening_of(args, inner(e, e)).scale;
  return select(to_mask(args.effects.stiffening), fma(scale, times(f, e), p), p);
}

/// Stress `p` of the law at the four points of an element, with effects.
[[gnu::noinline]] void add_effects(const Args& args, const Law& law, const Element& element, int t,
                                   Matrix p[4]) {
  const Mask lanes = to_mask(args.effects.material);
  const Softened softened = soften(args, law, element, t);
  for (int q = 0; q < 4; ++q) {
    const Matrix& f = element.f[q];
    const Response r = respond(args, green_strain(f), 4 * t + q, softened.left);
    p[q] = select(lanes, fma(r.law, p[q], times(f, r.stress)), p[q]);
  }
}

/// The same for the change of the stress with F.
[[gnu::noinline]] void add_effect_changes(const Args& args, const Law& law, const Element& element,
                                          int t, const Matrix df[4], Matrix dp[4]) {
  const auto& fx = args.effects;
  const Mask lanes = to_mask(fx.material);
  const Mask soft = to_mask(fx.softening);
  const Softened softened = soften(args, law, element, t);
  Lane change = splat(Real{0});  // of what is left
  for (int q = 0; q < 4 && fx.softening != 0; ++q) {
    const Lane work = inner(unsoftened(args, element.f[q], element.point[q]), df[q]);
    change = fma(softened.slope * element.mean * element.weight[q], work, change);
  }
  for (int q = 0; q < 4; ++q) {
    const Matrix& f = element.f[q];
    const Response r = respond(args, green_strain(f), 4 * t + q, softened.left);
    Matrix with = fma(r.law, dp[q], times(df[q], r.stress));
    with = add_strain_change(args, r, f, df[q], with);
    if (fx.softening != 0) {
      const Lane more = r.law / softened.left;  // 1 + gains
      const Matrix all = fma(more * change, unsoftened(args, f, element.point[q]), with);
      with = select(soft, all, with);
    }
    dp[q] = select(lanes, with, dp[q]);
  }
}

/// Second Piola-Kirchhoff stress F^-1 P of the law: with P = stretch F + pressure cof F and
/// F^-1 cof F = cof^T cof / J. Bounded where an element is nearly inverted.
inline Tensor pulled_back(const Point& point) {
  const Lane least = splat(static_cast<Real>(0.1));
  Tensor s = (point.pressure / max(point.jacobian, least)) *
             symmetric_product(point.cofactor, point.cofactor);
  for (int k = 0; k < 3; ++k) s.v[k] = s.v[k] + point.stretch;
  return s;
}

/// What the branches remember of the elastic stress s at the end of a substep.
inline void remember_branches(const Args& args, int point, const Tensor& s) {
  const auto& fx = args.effects;
  const Mask lanes = to_mask(fx.prony);
  const int at = 6 * kLanes * point;
  const std::int64_t stride = 24LL * kLanes * args.tetrahedra;
  const Tensor old = load_tensor(fx.stress + at);
  const Tensor change = s - old;
  Tensor bias = zero_tensor();
  for (int k = 0; k < fx.branches; ++k) {
    Real* const memory = fx.branch + k * stride + at;
    const Lane keep = load(fx.prony_keep + k * kLanes);
    const Lane gain = load(fx.prony_gain + k * kLanes);
    const Tensor before = load_tensor(memory);
    const Tensor now = fma(gain, change, keep * before);
    store_tensor(memory, select(lanes, now, before));
    bias = fma(keep, now, fma(splat(Real{0}) - gain, s, bias));
  }
  store_tensor(fx.stress + at, select(lanes, s, old));
  store_tensor(fx.bias + at, select(lanes, bias, load_tensor(fx.bias + at)));
}

inline void remember_element(const Args& args, const Law& law, const Element& element, int t) {
  const auto& fx = args.effects;
  const Softened softened = soften(args, law, element, t);
  for (int q = 0; q < 4; ++q) {
    const int point = 4 * t + q;
    const Tensor e = green_strain(element.f[q]);
    if (fx.prony != 0) {
      const Response r = respond_elastic(args, e, softened.left);
      remember_branches(args, point, fma(r.law, pulled_back(element.point[q]), r.stress));
    }
    if (fx.slider != 0) {
      const Slide s = slide_of(args, e, point);
      Real* const memory = fx.plastic + 6 * kLanes * point;
      const Tensor plastic = fma(splat(Real{0}) - s.carried, s.off, e);
      store_tensor(memory, select(to_mask(fx.slider), plastic, load_tensor(memory)));
    }
  }
  if (fx.softening == 0) return;
  Real* const memory = fx.energy_peak + kLanes * t;
  const Lane before = load(memory);
  const Lane now = max(before, element_energy(args, law, element));
  store(memory, select(to_mask(fx.softening), now, before));
}

// ---------------------------------------------------------------------------------------------------------------------
// Nodes: springs to ground that wear (anchors, adhesion), the air film, the drag of the air.

/// Area of the skin that belongs to each node, as a vector outwards.
inline void find_areas(const Args& args, const Real* x) {
  const auto& fx = args.effects;
  for (int i = 0; i < args.nodes; ++i) store3(fx.area + 3 * kLanes * i, zero3());
  const Lane sixth = splat(static_cast<Real>(1.0 / 6));
  for (int t = 0; t < fx.skin_triangles; ++t) {
    const std::int32_t* const node = fx.skin + 3 * t;
    const Lane3 a = load3(x + 3 * kLanes * node[0]);
    const Lane3 b = load3(x + 3 * kLanes * node[1]);
    const Lane3 c = load3(x + 3 * kLanes * node[2]);
    const Lane3 third = sixth * cross(b - a, c - a);
    for (int k = 0; k < 3; ++k) {
      Real* const area = fx.area + 3 * kLanes * node[k];
      store3(area, load3(area) + third);
    }
  }
}

/// Skin of node i that looks against `direction`.
inline Lane facing(const Args& args, int i, Lane3 direction) {
  const Lane zero = splat(Real{0});
  return max(zero, zero - dot(load3(args.effects.area + 3 * kLanes * i), direction));
}

inline void start_bonds(const Args& args) {
  const auto& fx = args.effects;
  for (int i = 0; i < args.nodes; ++i)
    store(fx.bond_now + kLanes * i, bond_stiffness(fx, i, load(fx.bond_fresh + kLanes * i)));
}

inline void start_lubrication(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    const Surface surface = nearest_surface(args, load3(args.x + 3 * kLanes * i));
    start_lubrication_of(args, i, surface,
                         load(args.effects.lubrication_scale) * facing(args, i, surface.normal));
  }
}

/// The air presses on what moves into it.
inline void start_drag(const Args& args) {
  const auto& fx = args.effects;
  for (int i = 0; i < args.nodes; ++i) {
    const int at = 3 * kLanes * i;
    const Lane3 v = load3(args.v + at);
    const Lane size = load(fx.drag_scale) * facing(args, i, zero3() - v);
    store3(fx.drag_now + at, zero3() - size * v);
  }
}

/// Springs, film and drag as the substep begins.
void start_effects(const Args& args) {
  const auto& fx = args.effects;
  if (fx.bonds != 0) start_bonds(args);
  if ((fx.lubrication | fx.drag) != 0) find_areas(args, args.x);
  if (fx.lubrication != 0) start_lubrication(args);
  if (fx.drag != 0) start_drag(args);
}

/// Adds to the gradient of the step's potential at a node.
inline void add_node_force(Real* to, int i, Bits lanes, Lane3 force) {
  Real* const memory = to + 3 * kLanes * i;
  const Lane3 before = load3(memory);
  store3(memory, select(to_mask(lanes), before + force, before));
}

void add_node_effects(const Args& args, Real* to) {
  const auto& fx = args.effects;
  for (int i = 0; i < args.nodes && fx.bonds != 0; ++i) {
    const int at = 3 * kLanes * i;
    const Lane3 off = load3(args.moved + at) - load3(fx.bond_place + at);
    add_node_force(to, i, fx.bonds, load(fx.bond_now + kLanes * i) * off);
  }
  for (int i = 0; i < args.nodes && fx.lubrication != 0; ++i) {
    add_node_force(to, i, fx.lubrication, lubrication_force(fx, i, load3(args.d + 3 * kLanes * i)));
  }
  for (int i = 0; i < args.nodes && fx.drag != 0; ++i) {
    add_node_force(to, i, fx.drag, zero3() - load3(fx.drag_now + 3 * kLanes * i));
  }
  for (int k = 0; k < fx.pull_nodes; ++k) {
    const int at = 3 * kLanes * fx.pull_node[k];
    const Lane3 force = pull_force(fx, k, load3(args.moved + at), load3(args.d + at));
    add_node_force(to, fx.pull_node[k], fx.pull, zero3() - force);
  }
}

void add_node_products(const Args& args) {
  const auto& fx = args.effects;
  for (int i = 0; i < args.nodes && fx.bonds != 0; ++i) {
    const Lane3 p = load3(args.p + 3 * kLanes * i);
    add_node_force(args.hp, i, fx.bonds, load(fx.bond_now + kLanes * i) * p);
  }
  for (int i = 0; i < args.nodes && fx.lubrication != 0; ++i) {
    add_node_force(args.hp, i, fx.lubrication,
                   lubrication_force(fx, i, load3(args.p + 3 * kLanes * i)));
  }
  for (int k = 0; k < fx.pull_nodes; ++k) {
    const int at = 3 * kLanes * fx.pull_node[k];
    const Lane3 change = pull_product(fx, k, load3(args.moved + at), load3(args.p + at));
    add_node_force(args.hp, fx.pull_node[k], fx.pull, change);
  }
}

/// Stretch of the springs, and new ones where the skin touches.
void remember_bonds(const Args& args) {
  const auto& fx = args.effects;
  if (fx.adhesion != 0) find_areas(args, args.moved);
  for (int i = 0; i < args.nodes; ++i) {
    const Lane3 x = load3(args.moved + 3 * kLanes * i);
    const Lane stretched = stretch_bond(fx, i, x);
    if (fx.is_anchor[i] != 0 || fx.adhesion == 0) continue;
    const Surface surface = nearest_surface(args, x);
    const Lane area = facing(args, i, surface.normal);
    const Mask bonds = both(touches_anew(args, stretched, surface), splat(Real{0}) < area);
    start_bond(fx, i, bonds, stretched, x);
    Real* const fresh = fx.bond_fresh + kLanes * i;
    Lane stiffness = load(fx.adhesion_scale) * area;
    if (fx.adhesion_part != nullptr) stiffness = load(fx.adhesion_part + kLanes * i) * stiffness;
    store(fresh, select(bonds, stiffness, load(fresh)));
  }
}

}  // namespace
