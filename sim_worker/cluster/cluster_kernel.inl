// The lane kernel of the cluster model: included by cluster_kernel.cpp after lanes.h, one
// translation unit per width. Everything except the exported table is in an unnamed namespace
// (lanes.h says why).
//
// Per substep (docs/tissue.md 4):
//   predict      v <- (v + g h)(1 - damping h),   x* = x + v h,   then adhesion
//   match        c = mean x*,  A = sum (x* - c) r0^T,  one warm rotation step [Mueller16] -> R
//   apply        x*_i += s (mean over clusters of (c + R r0_i) - x*_i),  then contact and friction
//   finish       v = (x* - x) / h,   x = x*
// A cluster adds its goals c + R r0_i to the sums of its particles right after its match, while the
// particles are in the cache; clusters go in order, so the sums are the same at every width. No
// later cluster reads a particle whose last cluster has matched: the particle is settled there and
// then - corrected and, in the last iteration of a substep, finished and predicted for the next one
// - instead of in passes of its own. Only particles near shapes wait for their contacts, shape by
// shape.

#include "sim_worker/lanes/node_effects.inl"
#include "sim_worker/lanes/rigid_contact.inl"

namespace {

using Args = omentum::ClusterArgs<Real>;

struct Rotation {
  Lane3 column[3];
};

/// Rotation matrix of a unit quaternion (x, y, z, w).
inline Rotation to_rotation(const Lane q[4]) {
  const Lane one = splat(Real{1});
  const Lane x2 = q[0] + q[0];
  const Lane y2 = q[1] + q[1];
  const Lane z2 = q[2] + q[2];
  const Lane xx = q[0] * x2;
  const Lane yy = q[1] * y2;
  const Lane zz = q[2] * z2;
  const Lane xy = q[0] * y2;
  const Lane xz = q[0] * z2;
  const Lane yz = q[1] * z2;
  const Lane wx = q[3] * x2;
  const Lane wy = q[3] * y2;
  const Lane wz = q[3] * z2;
  return {{{one - (yy + zz), xy + wz, xz - wy},
           {xy - wz, one - (xx + zz), yz + wx},
           {xz + wy, yz - wx, one - (xx + yy)}}};
}

/// One step of the rotation extraction of [Mueller16]: omega = sum R_k x A_k / (|sum R_k . A_k| +
/// eps). The update rotates by 2 atan(|omega|/2) instead of |omega|: the same fixed point without
/// trigonometry, never by more than pi.
inline void rotate_towards(Lane q[4], const Rotation& r, const Lane3 a[3], bool planar) {
  Lane3 omega = cross(r.column[0], a[0]) + cross(r.column[1], a[1]);
  Lane scale = dot(r.column[0], a[0]) + dot(r.column[1], a[1]);
  if (!planar) {
    omega = omega + cross(r.column[2], a[2]);
    scale = scale + dot(r.column[2], a[2]);
  }
  // eps 1e-12 m^2: far below the second moment of any cluster that has an extent (1e-6 m^2 and up).
  const Lane half = splat(Real{0.5}) / (abs(scale) + splat(static_cast<Real>(1e-12)));
  const Lane3 w = half * omega;
  // q <- normalise((w, 1) q)
  const Lane nx = fma(w.y, q[2], fnma(w.z, q[1], fma(w.x, q[3], q[0])));
  const Lane ny = fma(w.z, q[0], fnma(w.x, q[2], fma(w.y, q[3], q[1])));
  const Lane nz = fma(w.x, q[1], fnma(w.y, q[0], fma(w.z, q[3], q[2])));
  const Lane nw = fnma(w.z, q[2], fnma(w.y, q[1], fnma(w.x, q[0], q[3])));
  const Lane norm2 = fma(nw, nw, fma(nz, nz, fma(ny, ny, nx * nx)));
  const Lane inverse = splat(Real{1}) / sqrt(norm2);
  q[0] = nx * inverse;
  q[1] = ny * inverse;
  q[2] = nz * inverse;
  q[3] = nw * inverse;
}

inline Lane3 rotate(const Rotation& r, Lane3 v, bool planar) {
  Lane3 result = fma(v.x, r.column[0], v.y * r.column[1]);
  if (!planar) result = fma(v.z, r.column[2], result);
  return result;
}

/// What every particle takes in a call.
struct Step {
  Lane stiffness, keep, h, inverse_h, limit, limit2;
  Lane3 gh;

  explicit Step(const Args& args)
      : stiffness(load(args.stiffness)),
        keep(load(args.keep)),
        h(splat(args.h)),
        inverse_h(splat(Real{1} / args.h)),
        limit(splat(args.max_speed)),
        limit2(limit * limit),
        gh(h * load3(args.gravity)) {}
};

/// Where inertia and gravity take a particle that moves in the lanes of `free`, at most at the
/// largest speed.
inline Lane3 predicted(const Step& step, Lane3 x, Lane3 v_before, Bits free) {
  Lane3 v = step.keep * (v_before + step.gh);
  const Lane speed2 = dot(v, v);
  const Mask fast = step.limit2 < speed2;
  if (to_bits(fast) != 0) v = select(fast, step.limit / sqrt(speed2) * v, v);
  return select(to_mask(free), fma(step.h, v, x), x);
}

/// Correction of particle i at xs towards the mean of its goals, before contact.
inline Lane3 correction_of(const Args& args, const Step& step, int i, Lane3 xs, Lane3 goals,
                           Lane weight) {
  const Lane3 correction = step.stiffness * fma(splat(Real{0}) - weight, xs, goals);
  if (args.pair_sum == nullptr) return splat(args.particle_scale[i]) * correction;
  const Real* const pair_sum = args.pair_sum + 4 * kLanes * i;
  const Lane count = load(pair_sum + 3 * kLanes) + splat(args.particle_memberships[i]);
  return splat(Real{1}) / max(count, splat(Real{1})) * (correction + load3(pair_sum));
}

/// End of an iteration for particle i at xs; where it ends the substep: velocity, place, and the
/// place predicted for the next substep.
inline void finish(const Args& args, const Step& step, int i, Bits free, Lane3 xs) {
  if (args.after != omentum::AfterMatch::kIterate) {
    Real* const x = args.x + 3 * kLanes * i;
    const Lane3 v = step.inverse_h * (xs - load3(x));
    store3(x, xs);
    if (args.after == omentum::AfterMatch::kFinish) {
      store3(args.v + 3 * kLanes * i, v);
    } else if (free != 0) {
      xs = predicted(step, xs, v, free);
    }
  }
  store3(args.xs + 3 * kLanes * i, xs);
}

/// Particle i has all its goals: correction and, unless a shape may be in reach, the end of its
/// iteration.
inline void settle(const Args& args, const Step& step, int i, Lane3 goals, Lane weight) {
  const Bits free = args.free_mask[i];
  Lane3 xs = load3(args.xs + 3 * kLanes * i);
  if (free != 0)
    xs = select(to_mask(free), xs + correction_of(args, step, i, xs, goals, weight), xs);
  if (args.candidate_any[i] != 0) {
    store3(args.xs + 3 * kLanes * i, xs);
  } else {
    finish(args, step, i, free, xs);
  }
}

/// What a cluster wants of its members: the goal of one at rest offset r0 is centre + rotation r0,
/// times the weight.
struct Goal {
  Lane3 centre;
  Rotation rotation;
  Lane weight;
};

/// Adds the goal to the sums of members in memberships [begin, end) of args.turn, for which it is
/// the first one, the last one, both or neither. The last one settles the particle.
template <bool kFirst, bool kLast, bool kPlanar, bool kPlastic>
inline void add_goals(const Args& args, const Step& step, const Goal& goal, int begin, int end) {
  for (int k = begin; k < end; ++k) {
    const int m = args.turn[k];
    const int i = args.cluster_member[m];
    Real* const memory = args.goal_sum + 4 * kLanes * i;
    const Lane3 r0 =
        kPlastic ? load3(args.plastic_rest + 3 * kLanes * m) : splat3(args.rest + 3 * m);
    Lane3 sum = goal.centre + (kFirst ? zero3() : load3(memory));
    sum = fma(r0.x, goal.rotation.column[0], sum);
    sum = fma(r0.y, goal.rotation.column[1], sum);
    if constexpr (!kPlanar) sum = fma(r0.z, goal.rotation.column[2], sum);
    Lane weight = splat(args.particle_weight[i]);
    if constexpr (kPlastic) {
      weight = goal.weight + (kFirst ? splat(Real{0}) : load(memory + 3 * kLanes));
    }
    if (!kLast || (args.held_force != nullptr && args.held_mask[i] != 0)) {
      store3(memory, sum);
      if constexpr (kPlastic) store(memory + 3 * kLanes, weight);
    }
    if constexpr (kLast) settle(args, step, i, sum, weight);
  }
}

/// Adds the corrections that held particles do not make, in the order of the particles. Where it is
/// held, a particle is still where it was matched.
template <bool kPlastic>
void add_held_force(const Args& args, const Step& step) {
  for (int i = 0; i < args.particles; ++i) {
    if (args.held_mask[i] == 0) continue;
    const Real* const goal_sum = args.goal_sum + 4 * kLanes * i;
    const Lane weight = kPlastic ? load(goal_sum + 3 * kLanes) : splat(args.particle_weight[i]);
    const Lane3 correction =
        correction_of(args, step, i, load3(args.xs + 3 * kLanes * i), load3(goal_sum), weight);
    const Lane3 force = load3(args.held_force);
    store3(args.held_force, select(to_mask(args.held_mask[i]), force + correction, force));
  }
}

template <bool kPlanar, bool kPlastic>
void match_clusters_as(const Args args) {  // by value: no store can change it
  const Step step(args);
  for (int c = 0; c < args.clusters; ++c) {
    const int begin = args.cluster_begin[c];
    const int end = args.cluster_begin[c + 1];
    const Lane zero = splat(Real{0});
    Lane3 sum{zero, zero, zero};
    Lane3 a[3] = {sum, sum, sum};
    Lane3 rest_sum = sum;
    for (int m = begin; m < end; ++m) {
      const Lane3 x = load3(args.xs + 3 * kLanes * args.cluster_member[m]);
      const Lane3 r0 =
          kPlastic ? load3(args.plastic_rest + 3 * kLanes * m) : splat3(args.rest + 3 * m);
      sum = sum + x;
      a[0] = fma(r0.x, x, a[0]);
      a[1] = fma(r0.y, x, a[1]);
      if constexpr (!kPlanar) a[2] = fma(r0.z, x, a[2]);
      if constexpr (kPlastic) rest_sum = rest_sum + r0;
    }
    if constexpr (!kPlastic) rest_sum = splat3(args.rest_sum + 3 * c);
    const Lane inverse_count = splat(Real{1} / static_cast<Real>(end - begin));
    const Lane3 centre = inverse_count * sum;
    // sum (x - c) r0^T = sum x r0^T - c (sum r0)^T; sum r0 is rounding, or plastic drift.
    a[0] = fma(zero - rest_sum.x, centre, a[0]);
    a[1] = fma(zero - rest_sum.y, centre, a[1]);
    if constexpr (!kPlanar) a[2] = fma(zero - rest_sum.z, centre, a[2]);

    Real* const q_memory = args.q + 4 * kLanes * c;
    Lane q[4] = {load(q_memory), load(q_memory + kLanes), load(q_memory + 2 * kLanes),
                 load(q_memory + 3 * kLanes)};
    Rotation r = to_rotation(q);
    for (int k = 0; k < args.rotation_iterations; ++k) {
      rotate_towards(q, r, a, kPlanar);
      r = to_rotation(q);
    }
    for (int k = 0; k < 4; ++k) store(q_memory + k * kLanes, q[k]);

    Lane weight = splat(args.cluster_weight[c]);
    if constexpr (kPlastic) {
      // Plastic flow in the lanes where the squared distance of some member to its goal exceeds the
      // threshold: r0 <- r0 + creep (R^T (x - c) - r0), and the goal's weight is (1 - creep) times.
      Lane worst = zero;
      for (int m = begin; m < end; ++m) {
        const Lane3 x = load3(args.xs + 3 * kLanes * args.cluster_member[m]);
        const Lane3 miss = centre + rotate(r, load3(args.plastic_rest + 3 * kLanes * m), false) - x;
        worst = max(worst, dot(miss, miss));
      }
      const Mask yields = splat(args.plastic_threshold) < worst;
      if (to_bits(yields) != 0) {
        const Lane creep = select(yields, splat(args.plastic_creep), zero);
        for (int m = begin; m < end; ++m) {
          const Lane3 d = load3(args.xs + 3 * kLanes * args.cluster_member[m]) - centre;
          Real* const memory = args.plastic_rest + 3 * kLanes * m;
          const Lane3 r0 = load3(memory);
          const Lane3 now{dot(r.column[0], d), dot(r.column[1], d), dot(r.column[2], d)};
          store3(memory, fma(creep, now - r0, r0));
        }
        weight = weight * (splat(Real{1}) - creep);
      }
    }

    const Goal goal{weight * centre,
                    {{weight * r.column[0], weight * r.column[1], weight * r.column[2]}},
                    weight};
    if (args.goal != nullptr) {
      Real* const memory = args.goal + 13 * kLanes * c;
      store3(memory, goal.centre);
      for (int k = 0; k < 3; ++k) store3(memory + (3 + 3 * k) * kLanes, goal.rotation.column[k]);
      store(memory + 12 * kLanes, weight);
    }
    const std::int32_t* const turn = args.turn_begin + 4 * c;
    add_goals<true, true, kPlanar, kPlastic>(args, step, goal, turn[0], turn[1]);
    add_goals<true, false, kPlanar, kPlastic>(args, step, goal, turn[1], turn[2]);
    add_goals<false, false, kPlanar, kPlastic>(args, step, goal, turn[2], turn[3]);
    add_goals<false, true, kPlanar, kPlastic>(args, step, goal, turn[3], turn[4]);
  }
  for (int k = 0; k < args.loose; ++k) {
    const int i = args.loose_particle[k];
    settle(args, step, i, zero3(), splat(args.particle_weight[i]));
  }
  for (int k = 0; k < args.shapes; ++k) resolve_contacts(args, k);
  if (args.after != omentum::AfterMatch::kIterate) {
    const std::int32_t* const near = args.near + args.particles * args.shapes;
    for (int j = 0; j < args.near_count[args.shapes]; ++j) {
      finish(args, step, near[j], args.free_mask[near[j]], load3(args.xs + 3 * kLanes * near[j]));
    }
  }
  if (args.held_force != nullptr) add_held_force<kPlastic>(args, step);
}

void match_clusters(const Args& args) {
  if (args.plastic_rest != nullptr) {
    match_clusters_as<false, true>(args);
  } else if (args.planar) {
    match_clusters_as<true, false>(args);
  } else {
    match_clusters_as<false, false>(args);
  }
}

void predict(const Args& args) {
  const Step step(args);
  for (int i = 0; i < args.particles; ++i) {
    const Lane3 x = load3(args.x + 3 * kLanes * i);
    const Bits free = args.free_mask[i];
    store3(args.xs + 3 * kLanes * i,
           free == 0 ? x : predicted(step, x, load3(args.v + 3 * kLanes * i), free));
  }
}

/// Nearest of the rigid bodies that particle i at x may reach in each lane, the tool apart; none is
/// 1 m away.
inline Surface nearest_in_reach(const Args& args, int i, Lane3 x) {
  Surface nearest{splat(Real{1}), zero3()};
  for (int k = 0; k < args.shapes; ++k) {
    if ((args.candidate_any[i] >> k & 1U) == 0 || args.shape[k].kind == ShapeKind::kCapsule)
      continue;
    const Surface surface = distance_to(args.shape[k], args.capsule, x);
    const Mask nearer =
        both(surface.phi < nearest.phi, to_mask(args.candidates[i * omentum::kMaxShapes + k]));
    nearest = {select(nearer, surface.phi, nearest.phi),
               select(nearer, surface.normal, nearest.normal)};
  }
  return nearest;
}

/// Adhesion of particle i to a place p: with the way u = bond_gain * stiffness that its spring
/// pulls in a substep per metre of stretch, implicitly x* <- x* + u / (1 + u) (p - x*); a held
/// particle passes u (p - x*) on to the tool.
void pull_bonds(const Args& args) {
  const auto& fx = args.effects;
  const Lane fresh = load(args.bond_gain) * load(fx.adhesion_scale);
  for (int i = 0; i < args.particles; ++i) {
    const Lane3 x = load3(args.x + 3 * kLanes * i);
    const Lane stretched = stretch_bond(fx, i, x);
    if (args.candidate_any[i] != 0)
      start_bond(fx, i, touches_anew(args, stretched, nearest_in_reach(args, i, x)), stretched, x);
    const Lane own =
        fx.adhesion_part == nullptr ? fresh : load(fx.adhesion_part + kLanes * i) * fresh;
    const Lane u = bond_stiffness(fx, i, own);
    if (to_bits(splat(Real{0}) < u) == 0) continue;
    Real* const memory = args.xs + 3 * kLanes * i;
    const Lane3 xs = load3(memory);
    const Lane3 off = load3(fx.bond_place + 3 * kLanes * i) - xs;
    const Lane3 pulled = fma(u / (splat(Real{1}) + u), off, xs);
    store3(memory, select(to_mask(args.free_mask[i] & fx.bonds), pulled, xs));
    if (args.held_force == nullptr || args.held_mask[i] == 0) continue;
    const Lane3 force = load3(args.held_force);
    store3(args.held_force,
           select(to_mask(args.held_mask[i] & fx.bonds), fma(u, off, force), force));
  }
}

}  // namespace
