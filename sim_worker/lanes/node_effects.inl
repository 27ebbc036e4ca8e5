// Effects on nodes that models share: cohesive springs to ground (adhesion, anchors) and
// lubrication by the air between a node and a rigid body. `fx` are LaneEffectArgs.

#include "sim_worker/lanes/rigid_contact.inl"

namespace {

/// Fraction of the stiffness that a cohesive spring has left, as in effect_laws.h.
inline Lane cohesive_fraction(Lane longest, Lane limit) {
  const Lane half = splat(static_cast<Real>(0.5)) * limit;
  const Lane worn = max(splat(Real{0}), (limit - longest) / max(longest, half));
  return select(half < longest, worn, splat(Real{1}));
}

/// Stiffness of the spring of a node, undamaged `fresh` [N/m]; zero in lanes without one.
template <typename Effects>
inline Lane bond_stiffness(const Effects& fx, int i, Lane fresh) {
  const Lane zero = splat(Real{0});
  const Lane longest = load(fx.bond_longest + kLanes * i);
  const Lane limit = load(fx.is_anchor[i] != 0 ? fx.anchor_limit : fx.adhesion_limit);
  const Lane k = select(longest < zero, zero, cohesive_fraction(longest, limit) * fresh);
  return select(to_mask(fx.bonds), k, zero);
}

/// Updates and returns the longest stretch of the spring of a node at x; -1 without one.
template <typename Effects>
inline Lane stretch_bond(const Effects& fx, int i, Lane3 x) {
  Real* const longest = fx.bond_longest + kLanes * i;
  const Lane before = load(longest);
  const Lane3 off = x - load3(fx.bond_place + 3 * kLanes * i);
  const Mask bonded = both(to_mask(fx.bonds), splat(static_cast<Real>(-0.5)) < before);
  const Lane stretched = select(bonded, max(before, sqrt(dot(off, off))), before);
  store(longest, stretched);
  return stretched;
}

/// Lanes in which a node without a spring touches a body, so that it bonds.
template <typename Args>
inline Mask touches_anew(const Args& args, Lane stretched, const Surface& surface) {
  const Lane touch =
      load(args.particle_radius) + splat(static_cast<Real>(1e-5));  // [m] beyond rounding
  const Mask alone = both(to_mask(args.effects.adhesion), stretched < splat(Real{0}));
  return both(alone, surface.phi < touch);
}

/// A new spring of a node at x in the given lanes.
template <typename Effects>
inline void start_bond(const Effects& fx, int i, Mask lanes, Lane stretched, Lane3 x) {
  Real* const place = fx.bond_place + 3 * kLanes * i;
  store(fx.bond_longest + kLanes * i, select(lanes, splat(Real{0}), stretched));
  store3(place, select(lanes, x, load3(place)));
}

/// Lubrication of a node for a substep: damping scale (reach / (reach + gap))^3 along the normal of
/// the nearest body, `scale` in Pa s/m times its area over the substep.
template <typename Args>
inline void start_lubrication_of(const Args& args, int i, const Surface& surface, Lane scale) {
  const auto& fx = args.effects;
  const Lane reach = load(fx.lubrication_reach);
  const Lane gap = max(surface.phi - load(args.particle_radius), splat(Real{0}));
  const Lane part = reach / (reach + gap);
  const Lane now = scale * part * part * part;
  store(fx.lubrication_now + kLanes * i, select(to_mask(fx.lubrication), now, splat(Real{0})));
  store3(fx.lubrication_normal + 3 * kLanes * i, surface.normal);
}

/// How a string of length `size` beyond none pulls: its tension and the derivative of that.
struct Tension {
  Lane force, slope;
};

/// Linear beyond the slack, with a smooth corner of 10 um.
template <typename Effects>
inline Tension string_tension(const Effects& fx, Lane size) {
  const Lane half = splat(static_cast<Real>(0.5));
  const Lane w = splat(static_cast<Real>(1e-5));
  const Lane over = size - load(fx.pull_slack);
  const Lane smooth = sqrt(fma(over, over, w * w));
  const Lane k = half * load(fx.pull_stiffness);
  // Without slack the string is a spring.
  const Mask slack = splat(Real{0}) < load(fx.pull_slack);
  return {select(slack, k * (over + smooth), (k + k) * size),
          select(slack, k * (splat(Real{1}) + over / smooth), k + k)};
}

/// Force of the strings, the damper and the push on entry k of pull_node: a node at x, moved by d
/// in the substep.
template <typename Effects>
inline Lane3 pull_force(const Effects& fx, int k, Lane3 x, Lane3 d) {
  const Lane3 off = x - load3(fx.pull_place + 3 * kLanes * k);
  const Lane size = sqrt(max(dot(off, off), splat(static_cast<Real>(1e-20))));
  const Lane tension = string_tension(fx, size).force / size;
  const Lane left = load(fx.push_left) * load(fx.push_keep);
  const Lane3 force = fnma(load(fx.pull_damper), d, fnma(tension, off, left * load3(fx.push)));
  return load(fx.pull_share + kLanes * k) * force;
}

/// Minus its change with a change p of the node.
template <typename Effects>
inline Lane3 pull_product(const Effects& fx, int k, Lane3 x, Lane3 p) {
  const Lane3 off = x - load3(fx.pull_place + 3 * kLanes * k);
  const Lane size = sqrt(max(dot(off, off), splat(static_cast<Real>(1e-20))));
  const Tension tension = string_tension(fx, size);
  const Lane across = tension.force / size;
  const Lane along = (tension.slope - across) * (dot(off, p) / (size * size));
  const Lane3 change = fma(along, off, (across + load(fx.pull_damper)) * p);
  return load(fx.pull_share + kLanes * k) * change;
}

/// End of a substep: what is left of the push.
template <typename Effects>
inline void fade_push(const Effects& fx) {
  if (fx.pull == 0) return;
  const Lane left = load(fx.push_left);
  store(fx.push_left, select(to_mask(fx.pull), left * load(fx.push_keep), left));
}

/// Lubrication force on a node of displacement d in the substep, to be subtracted.
template <typename Effects>
inline Lane3 lubrication_force(const Effects& fx, int i, Lane3 d) {
  const Lane3 n = load3(fx.lubrication_normal + 3 * kLanes * i);
  return (load(fx.lubrication_now + kLanes * i) * dot(n, d)) * n;
}

}  // namespace
