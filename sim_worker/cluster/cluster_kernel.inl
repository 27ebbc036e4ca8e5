// The lane kernel of the cluster model: included by cluster_kernel.cpp after lanes.h, one
// translation unit per width. Everything except the exported table is in an unnamed namespace
// (lanes.h says why).
//
// Per substep (docs/tissue.md 4):
//   predict      v <- (v + g h)(1 - damping h),   x* = x + v h
//   match        c = mean x*,  A = sum (x* - c) r0^T,  one warm rotation step [Mueller16] -> R
//   apply        x*_i += s (mean over clusters of (c + R r0_i) - x*_i),  then contact and friction
//   finish       v = (x* - x) / h,   x = x*
// A cluster adds its goals c + R r0_i to the sums of its particles right after its match, while the
// particles are in the cache; clusters go in order, so the sums are the same at every width.

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

template <bool kPlanar, bool kPlastic>
void match_clusters_as(const Args& args) {
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

    const Lane3 goal_centre = weight * centre;
    const Rotation goal_rotation{
        {weight * r.column[0], weight * r.column[1], weight * r.column[2]}};
    Real* const goal = args.goal + 13 * kLanes * c;
    store3(goal, goal_centre);
    for (int k = 0; k < 3; ++k) store3(goal + (3 + 3 * k) * kLanes, goal_rotation.column[k]);
    store(goal + 12 * kLanes, weight);

    for (int m = begin; m < end; ++m) {
      Real* const goal_sum = args.goal_sum + 4 * kLanes * args.cluster_member[m];
      const Lane3 r0 =
          kPlastic ? load3(args.plastic_rest + 3 * kLanes * m) : splat3(args.rest + 3 * m);
      const bool first = args.first_of_particle[m] != 0;
      Lane3 sum_now = goal_centre + (first ? Lane3{zero, zero, zero} : load3(goal_sum));
      sum_now = fma(r0.x, goal_rotation.column[0], sum_now);
      sum_now = fma(r0.y, goal_rotation.column[1], sum_now);
      if constexpr (!kPlanar) sum_now = fma(r0.z, goal_rotation.column[2], sum_now);
      store3(goal_sum, sum_now);
      if constexpr (kPlastic) {
        store(goal_sum + 3 * kLanes, weight + (first ? zero : load(goal_sum + 3 * kLanes)));
      }
    }
  }
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
  const Lane h = splat(args.h);
  const Lane keep = load(args.keep);
  const Lane3 gh = h * load3(args.gravity);
  const Lane limit = splat(args.max_speed);
  const Lane limit2 = limit * limit;
  for (int i = 0; i < args.particles; ++i) {
    const Lane3 x = load3(args.x + 3 * kLanes * i);
    if (args.free_mask[i] == 0) {
      store3(args.xs + 3 * kLanes * i, x);
      continue;
    }
    Lane3 v = keep * (load3(args.v + 3 * kLanes * i) + gh);
    const Lane speed2 = dot(v, v);
    const Mask fast = limit2 < speed2;
    if (to_bits(fast) != 0) v = select(fast, limit / sqrt(speed2) * v, v);
    store3(args.xs + 3 * kLanes * i, select(to_mask(args.free_mask[i]), fma(h, v, x), x));
  }
}

template <bool kPlastic, bool kPairs>
void apply_as(const Args& args) {
  const Lane s = load(args.stiffness);
  const Lane zero = splat(Real{0});
  const bool wants_force = args.held_force != nullptr;
  for (int i = 0; i < args.particles; ++i) {
    const Bits free = args.free_mask[i];
    const Bits held = wants_force ? args.held_mask[i] : 0U;
    if ((free | held) == 0) continue;
    const Lane3 xs = load3(args.xs + 3 * kLanes * i);
    const Real* const goal_sum = args.goal_sum + 4 * kLanes * i;
    const Lane weight = kPlastic ? load(goal_sum + 3 * kLanes) : splat(args.particle_weight[i]);
    Lane3 correction = s * fma(zero - weight, xs, load3(goal_sum));
    if constexpr (kPairs) {
      const Real* const pair_sum = args.pair_sum + 4 * kLanes * i;
      const Lane count = load(pair_sum + 3 * kLanes) + splat(args.particle_memberships[i]);
      correction = correction + load3(pair_sum);
      correction = splat(Real{1}) / max(count, splat(Real{1})) * correction;
    } else {
      correction = splat(args.particle_scale[i]) * correction;
    }
    if (held != 0) {
      const Mask is_held = to_mask(held);
      const Lane3 force = load3(args.held_force);
      store3(args.held_force, select(is_held, force + correction, force));
    }
    Lane3 moved = xs + correction;
    if (args.candidate_any[i] != 0) moved = resolve_contacts(args, i, moved);
    store3(args.xs + 3 * kLanes * i, select(to_mask(free), moved, xs));
  }
}

void apply_corrections(const Args& args) {
  if (args.plastic_rest != nullptr) {
    args.pair_sum != nullptr ? apply_as<true, true>(args) : apply_as<true, false>(args);
  } else {
    args.pair_sum != nullptr ? apply_as<false, true>(args) : apply_as<false, false>(args);
  }
}

void finish_substep(const Args& args) {
  const Lane inverse_h = splat(Real{1} / args.h);
  for (int i = 0; i < 3 * args.particles; ++i) {
    const Lane x = load(args.x + kLanes * i);
    const Lane xs = load(args.xs + kLanes * i);
    store(args.v + kLanes * i, (xs - x) * inverse_h);
    store(args.x + kLanes * i, xs);
  }
}

}  // namespace
