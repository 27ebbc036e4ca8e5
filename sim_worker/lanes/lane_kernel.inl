// The lane kernel that all tissue models share: included by lane_kernel.cpp after lanes.h, one
// translation unit per width. Everything except the exported table is in an unnamed namespace
// (lanes.h says why).

#include "sim_worker/lanes/panel_solve.inl"
#include "sim_worker/lanes/rigid_contact.inl"

namespace {

using omentum::CandidateArgs;
using omentum::NearestArgs;
using omentum::ProjectArgs;
using omentum::SkinArgs;

constexpr Bits kAllLanes = kLanes == 16 ? 0xFFFFU : (1U << kLanes) - 1U;

/// Lanes in which the particle may reach the shape within this control step; conservative. Decided
/// per lane, so that no lane depends on its neighbours.
inline Mask may_reach(const CandidateArgs<Real>& args, const KernelShape<Real>& s, Lane3 x,
                      Lane reach) {
  if (s.kind == ShapeKind::kHalfSpace)
    return dot(x - splat3(s.origin), normal_of_half_space(s)) < reach;
  if (s.kind == ShapeKind::kCapsule) {
    const Lane3 radial = radial_of_capsule(s, args.capsule, x);
    const Lane limit = reach + splat(s.size[0]) + load(args.capsule_sweep);
    return dot(radial, radial) < limit * limit;
  }
  const Lane3 d = x - splat3(s.origin);
  if (s.kind == ShapeKind::kEllipsoid) {
    // The ellipsoid grown by `reach` lies inside semi-axes a + reach.
    const Lane3 local = to_shape_frame(s, d);
    const Lane3 u{local.x / (splat(s.size[0]) + reach), local.y / (splat(s.size[1]) + reach),
                  local.z / (splat(s.size[2]) + reach)};
    return dot(u, u) < splat(Real{1.5});
  }
  const Lane limit = reach + splat(s.bound_radius);
  return dot(d, d) < limit * limit;
}

void find_candidates(const CandidateArgs<Real>& args) {
  const Lane3 g = load3(args.gravity);
  const Lane step = splat(args.step_s);
  const Lane fall = step * sqrt(dot(g, g));
  const Lane margin = splat(args.margin) + load(args.radius);
  for (int i = 0; i < args.points; ++i) {
    const Lane3 x = load3(args.x + 3 * kLanes * i);
    const Lane3 v = load3(args.v + 3 * kLanes * i);
    const Lane reach = fma(step, sqrt(dot(v, v)) + fall, margin);
    Bits any = 0;
    for (int k = 0; k < args.shapes; ++k) {
      const Bits bits = to_bits(may_reach(args, args.shape[k], x, reach)) & args.free_mask[i];
      args.candidates[i * omentum::kMaxShapes + k] = bits;
      any |= bits != 0 ? 1U << k : 0U;
    }
    args.candidate_any[i] = any;
  }
}

void nearest_particle(const NearestArgs<Real>& args) {
  const Lane3 point = load3(args.point);
  Lane best = splat(static_cast<Real>(1e30));
  Lane best_index = splat(Real{0});
  for (int i = 0; i < args.particles; ++i) {
    const Lane3 d = load3(args.x + 3 * kLanes * i) - point;
    const Lane d2 = dot(d, d);
    const Mask nearer = d2 < best;
    best = select(nearer, d2, best);
    best_index = select(nearer, splat(static_cast<Real>(i)), best_index);
  }
  store(args.distance2, best);
  store(args.index, best_index);
}

void skin_surface(const SkinArgs<Real>& args) {
  const Lane zero = splat(Real{0});
  for (int v = 0; v < args.vertices; ++v) {
    Lane3 position{zero, zero, zero};
    for (int k = 0; k < 4; ++k) {
      const int c = args.cluster[4 * v + k];
      const Real* const goal = args.goal + 13 * kLanes * c;
      const Lane weight = splat(args.weight[4 * v + k] / args.cluster_weight[c]);
      const Lane3 offset = splat3(args.offset + 3 * (4 * v + k));
      Lane3 p = load3(goal);
      p = fma(offset.x, load3(goal + 3 * kLanes), p);
      p = fma(offset.y, load3(goal + 6 * kLanes), p);
      p = fma(offset.z, load3(goal + 9 * kLanes), p);
      position = fma(weight, p, position);
    }
    store3(args.position + 3 * kLanes * v, position);
  }
}

void project_surface(const ProjectArgs<Real>& args) {
  const Lane3 origin = splat3(args.origin);
  const Real* const r = args.rotation;
  for (int v = 0; v < args.vertices; ++v) {
    const Lane3 d = load3(args.position + 3 * kLanes * v) - origin;
    const Lane depth = fma(splat(-r[8]), d.z, fma(splat(-r[7]), d.y, splat(-r[6]) * d.x));
    const Lane inverse = splat(Real{1}) / max(depth, splat(static_cast<Real>(1e-4)));
    const Lane u = fma(splat(r[2]), d.z, fma(splat(r[1]), d.y, splat(r[0]) * d.x));
    const Lane w = fma(splat(r[5]), d.z, fma(splat(r[4]), d.y, splat(r[3]) * d.x));
    store3(args.projected + 3 * kLanes * v, {u * inverse, w * inverse, depth});
  }
}

}  // namespace
