// Effects in the lane kernel of the elastic shell: included by shell_kernel.inl. Every function
// changes only the lanes in which its effect is on; the others keep their bits, so that a lane does
// not depend on its neighbours.

#include "sim_worker/shell/shell_laws.inl"

namespace {

inline Stress load_stress(const Real* p) {
  return {load(p), load(p + kLanes), load(p + 2 * kLanes)};
}
inline void store_stress(Real* p, Stress s) {
  store(p, s.xx);
  store(p + kLanes, s.xy);
  store(p + 2 * kLanes, s.yy);
}
inline Stress select(Mask m, Stress a, Stress b) {
  return {select(m, a.xx, b.xx), select(m, a.xy, b.xy), select(m, a.yy, b.yy)};
}
inline Stress fma(Lane s, Stress a, Stress c) {
  return {fma(s, a.xx, c.xx), fma(s, a.xy, c.xy), fma(s, a.yy, c.yy)};
}

/// Green strain of a triangle from C = F^T F.
inline Stress green_strain(Stress c) {
  const Lane half = splat(static_cast<Real>(0.5));
  return {fnma(half, splat(Real{1}), half * c.xx), half * c.xy,
          fnma(half, splat(Real{1}), half * c.yy)};
}

inline Lane square(Stress e) {
  return fma(splat(Real{2}) * e.xy, e.xy, fma(e.yy, e.yy, e.xx * e.xx));
}

/// c2 I^2 with I = 2 E:E, thickness strain of plane stress included: S = 8 c2 I (E - n E33); of an
/// exponential law mu/(2b) (exp(b I) - 1 - b I), S = 2 mu (exp(b I) - 1) (E - n E33).
inline Stress add_stiffening(const Args& args, Stress e, Lane shear, Stress s, Lane& invariant) {
  const Lane n = load(args.effects.lateral);
  const Lane through = splat(Real{0}) - n * (e.xx + e.yy);
  invariant = splat(Real{2}) * fma(through, through, square(e));
  Lane scale = load(args.effects.stiffening_scale) * shear * invariant;
  if (args.effects.exponential != 0) {
    const Lane grown = exponential(load(args.effects.exponential_rate) * invariant).minus_one;
    const Lane more = fma(load(args.effects.exponential_scale) * shear, grown, scale);
    scale = select(to_mask(args.effects.exponential), more, scale);
  }
  return fma(scale, Stress{fnma(n, through, e.xx), e.xy, fnma(n, through, e.yy)}, s);
}

/// Energy per volume / (2 mu) of the law and of stiffening.
inline Lane matrix_energy(const Args& args, Stress c, Lane invariant) {
  const Lane law = law_energy(args, c);
  const Lane eighth = splat(static_cast<Real>(0.125)) * load(args.effects.stiffening_scale);
  const Lane yeoh = fma(eighth * invariant, invariant, law);
  if (args.effects.exponential == 0) return yeoh;
  const Lane b = load(args.effects.exponential_rate);
  const Lane tiny = splat(static_cast<Real>(1e-20));
  const Lane more = exponential(b * invariant).excess / (splat(Real{4}) * max(b, tiny));
  return select(to_mask(args.effects.exponential), yeoh + more, yeoh);
}

/// Share of the stress that is left at this energy: 1 - softening s (3 - s^2) / 2 with
/// s = v / sqrt(1 + v^2), v = (Wmax - W) / (m + Wmax). That is the law of [Ogden99] with m + Wmax
/// in the place of their m, so that unloading begins with a stiffness of at most 1 + 3 softening,
/// and with their erf(1.2 v) to within 0.033 by what needs only a root.
inline Lane softened_share(const Args& args, Lane energy, int triangle) {
  const auto& fx = args.effects;
  const Lane peak = load(fx.energy_peak + kLanes * triangle);
  const Lane below = max(peak - energy, splat(Real{0}));
  const Lane scale = load(fx.softening_energy) + peak;
  const Lane s = below / sqrt(fma(below, below, scale * scale));
  const Lane lost = splat(static_cast<Real>(0.5)) * s * fnma(s, s, splat(Real{3}));
  return fnma(load(fx.softening_share), lost, splat(Real{1}));
}

/// Tension of the fibres, with a smooth corner of 1e-3 strain: (E4 + sqrt(E4^2 + w^2) - w) / 2.
inline Stress add_fibres(const Args& args, Stress e, Lane shear, Stress s) {
  const Lane half = splat(static_cast<Real>(0.5));
  const Lane w = splat(static_cast<Real>(1e-3));
  const Real* const axes = args.effects.fibre_axes;
  const Stress a{load(axes), load(axes + 2 * kLanes), load(axes + kLanes)};
  const Lane along = fma(a.xx, e.xx, fma(splat(Real{2}) * a.xy, e.xy, a.yy * e.yy));
  const Lane taut = half * ((along + sqrt(fma(along, along, w * w))) - w);
  return fma(load(args.effects.fibre) * shear * taut, a, s);
}

/// Strain that the slider's spring carries: up to the yield strain.
inline Stress slider_strain(const Args& args, Stress e, int triangle) {
  const Stress plastic = load_stress(args.effects.plastic + 3 * kLanes * triangle);
  const Stress off{e.xx - plastic.xx, e.xy - plastic.xy, e.yy - plastic.yy};
  const Lane size = sqrt(max(square(off), splat(static_cast<Real>(1e-20))));
  const Lane part = min(splat(Real{1}), load(args.effects.slider_yield) / size);
  return {part * off.xx, part * off.xy, part * off.yy};
}

/// Elastic part of the effects, of which Prony branches remember the history.
inline Stress add_elastic_effects(const Args& args, Stress c, Stress e, Lane shear, Stress s,
                                  int triangle, Lane& invariant, Lane& energy) {
  const auto& fx = args.effects;
  invariant = energy = splat(Real{0});
  if (fx.stiffening != 0) {
    Lane found = invariant;
    const Stress stiffer = add_stiffening(args, e, shear, s, found);
    const Mask lanes = to_mask(fx.stiffening);
    s = select(lanes, stiffer, s);
    invariant = select(lanes, found, invariant);
  }
  if (fx.softening != 0) {
    energy = matrix_energy(args, c, invariant);
    const Lane share = softened_share(args, energy, triangle);
    s = select(to_mask(fx.softening), Stress{share * s.xx, share * s.xy, share * s.yy}, s);
  }
  if (fx.fibres != 0) s = select(to_mask(fx.fibres), add_fibres(args, e, shear, s), s);
  return s;
}

/// All that is added to the stress of a triangle, C = F^T F.
inline Stress add_effects(const Args& args, Stress c, Lane shear, Stress s, int triangle) {
  const auto& fx = args.effects;
  const Stress e = green_strain(c);
  Lane unused = splat(Real{0});
  s = add_elastic_effects(args, c, e, shear, s, triangle, unused, unused);
  if (fx.prony != 0) {
    const Stress bias = load_stress(fx.bias + 3 * kLanes * triangle);
    const Lane more = load(fx.prony_gains);
    const Stress total{fma(more, s.xx, s.xx) + bias.xx, fma(more, s.xy, s.xy) + bias.xy,
                       fma(more, s.yy, s.yy) + bias.yy};
    s = select(to_mask(fx.prony), total, s);
  }
  if (fx.slider != 0) {
    const Stress total = fma(load(fx.slider_scale) * shear, slider_strain(args, e, triangle), s);
    s = select(to_mask(fx.slider), total, s);
  }
  return s;
}

/// End of a substep: memories of a triangle. `s` = stress of the law there.
inline void remember_triangle(const Args& args, Stress c, Lane shear, Stress s, int triangle) {
  const auto& fx = args.effects;
  const Stress e = green_strain(c);
  Lane invariant = splat(Real{0});
  Lane energy = invariant;
  s = add_elastic_effects(args, c, e, shear, s, triangle, invariant, energy);
  // Tangent over nominal stiffness: 1 + 12 (c2 / mu) I along the strain, of an exponential law
  // exp(b I) (1 + 2 b I).
  Lane tangent = fma(splat(Real{3}) * load(fx.stiffening_scale), invariant, splat(Real{1}));
  if (fx.exponential != 0) {
    const Lane exponent = load(fx.exponential_rate) * invariant;
    const Exponential grown = exponential(exponent);
    const Lane more = tangent + fma(splat(Real{2}) * exponent, grown.slope, grown.minus_one);
    tangent = select(to_mask(fx.exponential), more, tangent);
  }
  if (args.law != ShellLaw::kCorotated) tangent = tangent + (law_tangent(args, c) - splat(Real{1}));
  store(fx.peak, max(load(fx.peak), tangent));
  if (fx.softening != 0) {
    Real* const memory = fx.energy_peak + kLanes * triangle;
    const Lane before = load(memory);
    store(memory, select(to_mask(fx.softening), max(before, energy), before));
  }
  const int at = 3 * kLanes * triangle;
  if (fx.prony != 0) {
    const Mask lanes = to_mask(fx.prony);
    const Stress old = load_stress(fx.stress + at);
    const Stress change{s.xx - old.xx, s.xy - old.xy, s.yy - old.yy};
    const Lane zero = splat(Real{0});
    Stress bias{zero, zero, zero};
    const std::int64_t stride = 3LL * kLanes * args.triangles;
    for (int k = 0; k < fx.branches; ++k) {
      Real* const memory = fx.branch + k * stride + at;
      const Lane keep = load(fx.prony_keep + k * kLanes);
      const Lane gain = load(fx.prony_gain + k * kLanes);
      const Stress before = load_stress(memory);
      const Stress now{fma(gain, change.xx, keep * before.xx),
                       fma(gain, change.xy, keep * before.xy),
                       fma(gain, change.yy, keep * before.yy)};
      store_stress(memory, select(lanes, now, before));
      bias = {fma(keep, now.xx, fnma(gain, s.xx, bias.xx)),
              fma(keep, now.xy, fnma(gain, s.xy, bias.xy)),
              fma(keep, now.yy, fnma(gain, s.yy, bias.yy))};
    }
    store_stress(fx.stress + at, select(lanes, s, old));
    store_stress(fx.bias + at, select(lanes, bias, load_stress(fx.bias + at)));
  }
  if (fx.slider != 0) {
    const Stress carried = slider_strain(args, e, triangle);
    const Stress plastic{e.xx - carried.xx, e.xy - carried.xy, e.yy - carried.yy};
    store_stress(fx.plastic + at,
                 select(to_mask(fx.slider), plastic, load_stress(fx.plastic + at)));
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Forces on nodes.

inline void add_force(const Args& args, int i, Bits lanes, Lane3 force) {
  if (args.fixed[i] != 0) return;
  Real* const b = args.b + 3 * kLanes * i;
  const Lane3 before = load3(b);
  store3(b, select(to_mask(lanes), before - force, before));
}

void add_drag_forces(const Args& args) {
  const Lane scale = load(args.effects.drag_scale);
  for (int i = 0; i < args.nodes; ++i) {
    const Lane3 v = load3(args.v + 3 * kLanes * i);
    const Lane speed = sqrt(dot(v, v));
    const Lane size = splat(args.effects.node_area[i]) * scale * speed;
    add_force(args, i, args.effects.drag, zero3() - size * v);
  }
}

/// Present stiffness of the spring of a node [N/m]. Those of anchors are part of the
/// preconditioner: `only_new` leaves them out.
inline Lane spring_stiffness(const Args& args, int i, bool only_new) {
  const auto& fx = args.effects;
  const bool anchor = fx.is_anchor[i] != 0;
  if (only_new && anchor) return splat(Real{0});
  Lane fresh =
      anchor ? load(fx.anchor + kLanes * i) : splat(fx.node_area[i]) * load(fx.adhesion_scale);
  if (!anchor && fx.adhesion_part != nullptr) fresh = load(fx.adhesion_part + kLanes * i) * fresh;
  return bond_stiffness(fx, i, fresh);
}

/// Of the bed under a clamp against a turn of its strip: worn as the weaker one of two nodes is.
void add_anchor_turn_forces(const Args& args) {
  const auto& fx = args.effects;
  const Lane one = splat(Real{1});
  const auto off = [&args](int i) {
    return load3(args.moved + 3 * kLanes * i) - load3(args.effects.bond_place + 3 * kLanes * i);
  };
  for (int i = 0; i + 1 < args.nodes; ++i) {
    if (fx.is_anchor[i] == 0 || fx.is_anchor[i + 1] == 0) continue;
    const Lane left = min(bond_stiffness(fx, i, one), bond_stiffness(fx, i + 1, one));
    const Lane3 force = left * load(fx.anchor_turn + kLanes * i) * (off(i + 1) - off(i));
    add_force(args, i, fx.bonds, force);
    add_force(args, i + 1, fx.bonds, zero3() - force);
  }
}

void add_bond_forces(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    if (args.fixed[i] != 0) continue;
    const Lane3 off =
        load3(args.moved + 3 * kLanes * i) - load3(args.effects.bond_place + 3 * kLanes * i);
    add_force(args, i, args.effects.bonds, zero3() - spring_stiffness(args, i, false) * off);
  }
  if (args.effects.anchor_turn != nullptr) add_anchor_turn_forces(args);
}

void add_lubrication_forces(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    const Lane3 d = load3(args.d + 3 * kLanes * i);
    add_force(args, i, args.effects.lubrication, zero3() - lubrication_force(args.effects, i, d));
  }
}

void add_pull_forces(const Args& args) {
  const auto& fx = args.effects;
  for (int k = 0; k < fx.pull_nodes; ++k) {
    const int at = 3 * kLanes * fx.pull_node[k];
    const Lane3 force = pull_force(fx, k, load3(args.moved + at), load3(args.d + at));
    add_force(args, fx.pull_node[k], fx.pull, force);
  }
}

void add_node_effects(const Args& args) {
  if (args.effects.pull != 0) add_pull_forces(args);
  if (args.effects.drag != 0) add_drag_forces(args);
  if (args.effects.bonds != 0) add_bond_forces(args);
  if (args.effects.lubrication != 0) add_lubrication_forces(args);
}

/// The air film at the places where the substep begins.
void start_effects(const Args& args) {
  const auto& fx = args.effects;
  for (int i = 0; i < args.nodes && fx.lubrication != 0; ++i) {
    const Surface surface = nearest_surface(args, load3(args.x + 3 * kLanes * i));
    start_lubrication_of(args, i, surface, splat(fx.node_area[i]) * load(fx.lubrication_scale));
  }
}

/// Stretch of the springs, and new ones where tissue touches.
void remember_bonds(const Args& args) {
  const auto& fx = args.effects;
  for (int i = 0; i < args.nodes; ++i) {
    if (args.fixed[i] != 0) continue;
    const Lane3 x = load3(args.moved + 3 * kLanes * i);
    const Lane stretched = stretch_bond(fx, i, x);
    if (fx.is_anchor[i] != 0 || fx.adhesion == 0) continue;
    start_bond(fx, i, touches_anew(args, stretched, nearest_surface(args, x)), stretched, x);
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Springs to ground that may be stiffer than the sheet's own preconditioner A: conjugate gradients
// on (A + D) s = b with A as preconditioner. Each round needs one solve with A, done by the caller;
// lanes without springs take the first.

/// D p of node i.
inline Lane3 spring_product(const Args& args, int i, Lane3 p) {
  Lane3 q = zero3();
  if (args.effects.bonds != 0) q = spring_stiffness(args, i, true) * p;
  if (args.effects.pull != 0 && args.effects.pull_index[i] >= 0) {
    const Lane3 x = load3(args.moved + 3 * kLanes * i);
    const Lane3 more = pull_product(args.effects, args.effects.pull_index[i], x, p);
    q = select(to_mask(args.effects.pull), q + more, q);
  }
  if (args.effects.lubrication != 0) {
    const Lane3 n = load3(args.effects.lubrication_normal + 3 * kLanes * i);
    q = fma(load(args.effects.lubrication_now + kLanes * i) * dot(n, p), n, q);
  }
  return q;
}

void start_springs(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    store3(args.effects.rest + 3 * kLanes * i, load3(args.b + 3 * kLanes * i));
    store3(args.effects.solution + 3 * kLanes * i, zero3());
  }
}

/// response <- b in the lanes of args.lanes: A^-1 rest of one factor key.
void take_response(const Args& args) {
  const Mask lanes = to_mask(args.lanes);
  for (int i = 0; i < args.nodes; ++i) {
    Real* const response = args.effects.response + 3 * kLanes * i;
    store3(response, select(lanes, load3(args.b + 3 * kLanes * i), load3(response)));
  }
}

void advance_springs(const Args& args, bool first) {
  const auto& fx = args.effects;
  const Mask springs = to_mask(fx.springs);
  const Lane zero = splat(Real{0});
  Lane product = zero;
  for (int i = 0; i < args.nodes; ++i) {
    if (args.fixed[i] != 0) continue;
    const int k = 3 * kLanes * i;
    product = product + dot(load3(fx.rest + k), load3(fx.response + k));
  }
  const Lane tiny = splat(static_cast<Real>(1e-30));
  const Lane beta = first ? zero : product / max(load(fx.last_product), tiny);
  store(fx.last_product, product);
  Lane curvature = zero;
  for (int i = 0; i < args.nodes; ++i) {
    if (args.fixed[i] != 0) continue;
    const int k = 3 * kLanes * i;
    Lane3 p = load3(fx.response + k);
    Lane3 preconditioner = load3(fx.rest + k);
    if (!first) {
      p = fma(beta, load3(fx.direction + k), p);
      preconditioner = fma(beta, load3(fx.preconditioner_direction + k), preconditioner);
    }
    store3(fx.direction + k, p);
    store3(fx.preconditioner_direction + k, preconditioner);
    curvature = curvature + dot(p, preconditioner + spring_product(args, i, p));
  }
  const Lane step = select(tiny < curvature, product / max(curvature, tiny), zero);
  // A lane without springs has its solution in the first round.
  const Lane alpha = select(springs, step, splat(first ? Real{1} : Real{0}));
  for (int i = 0; i < args.nodes; ++i) {
    if (args.fixed[i] != 0) continue;
    const int k = 3 * kLanes * i;
    const Lane3 p = load3(fx.direction + k);
    const Lane3 before = load3(fx.solution + k);
    const Lane3 whole = first ? p : before;
    store3(fx.solution + k, select(springs, fma(alpha, p, before), whole));
    const Lane3 q = load3(fx.preconditioner_direction + k) + spring_product(args, i, p);
    store3(fx.rest + k, fnma(alpha, q, load3(fx.rest + k)));
  }
}

void load_solution(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    store3(args.b + 3 * kLanes * i, load3(args.effects.solution + 3 * kLanes * i));
  }
}

}  // namespace
