// Contact of points with rigid shapes, one environment per lane: included by the kernels after
// lanes.h.

#pragma once

namespace {

using omentum::KernelShape;
using omentum::ShapeKind;

/// Where a point lies relative to a shape.
struct Surface {
  Lane phi;      ///< distance, negative inside [m]
  Lane3 normal;  ///< out of the shape, in W
};

inline Lane3 to_shape_frame(const KernelShape<Real>& s, Lane3 d) {
  return {
      fma(splat(s.rotation[2]), d.z, fma(splat(s.rotation[1]), d.y, splat(s.rotation[0]) * d.x)),
      fma(splat(s.rotation[5]), d.z, fma(splat(s.rotation[4]), d.y, splat(s.rotation[3]) * d.x)),
      fma(splat(s.rotation[8]), d.z, fma(splat(s.rotation[7]), d.y, splat(s.rotation[6]) * d.x))};
}

inline Lane3 to_world_frame(const KernelShape<Real>& s, Lane3 d) {
  return {
      fma(splat(s.rotation[6]), d.z, fma(splat(s.rotation[3]), d.y, splat(s.rotation[0]) * d.x)),
      fma(splat(s.rotation[7]), d.z, fma(splat(s.rotation[4]), d.y, splat(s.rotation[1]) * d.x)),
      fma(splat(s.rotation[8]), d.z, fma(splat(s.rotation[5]), d.y, splat(s.rotation[2]) * d.x))};
}

inline Lane inverse_length(Lane3 d) {
  // 1e-30 m^2 keeps the centre of a sphere finite; there the normal is zero and nothing moves.
  return splat(Real{1}) / sqrt(max(dot(d, d), splat(static_cast<Real>(1e-30))));
}

/// From the nearest point of the axis of a capsule to x. `capsule`: foot and direction of that
/// axis.
inline Lane3 radial_of_capsule(const KernelShape<Real>& s, const Real* capsule, Lane3 x) {
  const Lane zero = splat(Real{0});
  const Lane3 axis = load3(capsule + 3 * kLanes);
  const Lane3 d = x - load3(capsule);
  const Lane t = min(max(dot(d, axis), zero), splat(s.length));
  return fma(zero - t, axis, d);
}

inline Lane3 normal_of_half_space(const KernelShape<Real>& s) { return splat3(s.rotation + 6); }

/// Trilinear distance and its slope in one lane; outside the grid 1 m.
inline void sdf_lane(const KernelShape<Real>& s, const Real p[3], Real out[4]) {
  out[0] = Real{1};
  out[1] = out[2] = out[3] = Real{0};
  std::int32_t cell[3];
  Real f[3];
  for (int k = 0; k < 3; ++k) {
    const Real u = (p[k] - s.sdf_origin[k]) / s.sdf_pitch;
    if (!(u >= Real{0}) || !(u < static_cast<Real>(s.sdf_count[k] - 1))) return;
    cell[k] = static_cast<std::int32_t>(u);
    f[k] = u - static_cast<Real>(cell[k]);
  }
  Real corner[2][2][2];
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) {
      for (int k = 0; k < 2; ++k) {
        const std::int32_t index =
            cell[0] + i + s.sdf_count[0] * (cell[1] + j + s.sdf_count[1] * (cell[2] + k));
        corner[i][j][k] = static_cast<Real>(s.sdf[index]);
      }
    }
  }
  const auto mix = [](Real a, Real b, Real t) { return a + t * (b - a); };
  const auto plane = [&](int i) {
    return mix(mix(corner[i][0][0], corner[i][0][1], f[2]),
               mix(corner[i][1][0], corner[i][1][1], f[2]), f[1]);
  };
  const auto row = [&](int j) {
    return mix(mix(corner[0][j][0], corner[0][j][1], f[2]),
               mix(corner[1][j][0], corner[1][j][1], f[2]), f[0]);
  };
  const auto layer = [&](int k) {
    return mix(mix(corner[0][0][k], corner[0][1][k], f[1]),
               mix(corner[1][0][k], corner[1][1][k], f[1]), f[0]);
  };
  out[0] = mix(plane(0), plane(1), f[0]);
  out[1] = plane(1) - plane(0);
  out[2] = row(1) - row(0);
  out[3] = layer(1) - layer(0);
}

/// kSdf: a table look-up lane by lane. Out of line, so that distance_to stays small enough to be
/// inlined.
[[gnu::noinline]] Surface distance_to_grid(const KernelShape<Real>& s, Lane3 local) {
  Real p[3 * kLanes];
  Real found[4 * kLanes];
  store3(p, local);
  for (int lane = 0; lane < kLanes; ++lane) {
    const Real point[3] = {p[lane], p[lane + kLanes], p[lane + 2 * kLanes]};
    Real out[4];
    sdf_lane(s, point, out);
    for (int k = 0; k < 4; ++k) found[lane + k * kLanes] = out[k];
  }
  const Lane3 gradient{load(found + kLanes), load(found + 2 * kLanes), load(found + 3 * kLanes)};
  return {load(found), to_world_frame(s, inverse_length(gradient) * gradient)};
}

[[gnu::always_inline]] inline Surface distance_to(const KernelShape<Real>& s, const Real* capsule,
                                                  Lane3 x) {
  const Lane zero = splat(Real{0});
  const Lane one = splat(Real{1});
  if (s.kind == ShapeKind::kCapsule) {
    const Lane3 radial = radial_of_capsule(s, capsule, x);
    const Lane inverse = inverse_length(radial);
    return {fma(dot(radial, radial), inverse, zero - splat(s.size[0])), inverse * radial};
  }
  const Lane3 d = x - splat3(s.origin);
  if (s.kind == ShapeKind::kSphere) {
    const Lane inverse = inverse_length(d);
    return {fma(dot(d, d), inverse, zero - splat(s.size[0])), inverse * d};
  }
  if (s.kind == ShapeKind::kHalfSpace) {
    return {dot(d, normal_of_half_space(s)), normal_of_half_space(s)};
  }
  const Lane3 local = to_shape_frame(s, d);
  if (s.kind == ShapeKind::kEllipsoid) {
    // First-order distance f / |grad f| of f = |p/a| - 1 scaled: phi = k0 (k0 - 1) / k1, k0 =
    // |p/a|, k1 = |p/a^2|.
    const Lane3 u{local.x / splat(s.size[0]), local.y / splat(s.size[1]),
                  local.z / splat(s.size[2])};
    const Lane3 w{u.x / splat(s.size[0]), u.y / splat(s.size[1]), u.z / splat(s.size[2])};
    const Lane k0 = sqrt(dot(u, u));
    const Lane inverse_k1 = inverse_length(w);
    return {k0 * (k0 - one) * inverse_k1, to_world_frame(s, inverse_k1 * w)};
  }
  if (s.kind == ShapeKind::kBox) {
    const Lane3 half = splat3(s.size);
    const Lane3 q{abs(local.x) - half.x, abs(local.y) - half.y, abs(local.z) - half.z};
    const Lane3 outside{max(q.x, zero), max(q.y, zero), max(q.z, zero)};
    const Lane inside = min(max(q.x, max(q.y, q.z)), zero);
    const Mask is_inside = inside < zero;
    const Mask x_face = both(q.y < q.x, q.z < q.x);
    const Mask y_face = q.z < q.y;
    const Lane3 face{select(x_face, one, zero), select(x_face, zero, select(y_face, one, zero)),
                     select(x_face, zero, select(y_face, zero, one))};
    const Lane inverse = inverse_length(outside);
    Lane3 n = select(is_inside, face, inverse * outside);
    n = {select(local.x < zero, zero - n.x, n.x), select(local.y < zero, zero - n.y, n.y),
         select(local.z < zero, zero - n.z, n.z)};
    return {fma(dot(outside, outside), inverse, inside), to_world_frame(s, n)};
  }
  return distance_to_grid(s, local);
}

/// Nearest rigid body of each lane, the tool apart; none is 1 m away.
template <typename Args>
inline Surface nearest_surface(const Args& args, Lane3 x) {
  const Lane zero = splat(Real{0});
  Surface nearest{splat(Real{1}), {zero, zero, zero}};
  for (int k = 0; k < args.shapes; ++k) {
    if (args.shape[k].kind == ShapeKind::kCapsule) continue;
    const Surface surface = distance_to(args.shape[k], args.capsule, x);
    const Mask nearer = surface.phi < nearest.phi;
    nearest = {select(nearer, surface.phi, nearest.phi),
               select(nearer, surface.normal, nearest.normal)};
  }
  return nearest;
}

/// Projection of a point p that is `depth` > 0 deep in a shape onto its surface along the normal,
/// then Coulomb friction on the slip since it was at `from`.
template <typename Args>
inline Lane3 leave_shape(const Args& args, const KernelShape<Real>& shape, Lane depth, Lane3 normal,
                         Lane3 p, Lane3 from) {
  const Lane zero = splat(Real{0});
  const Lane3 outside = fma(depth, normal, p);
  Lane3 slip = outside - from;
  if (shape.kind == ShapeKind::kCapsule) slip = slip - load3(args.capsule_motion);
  const Lane along = dot(slip, normal);
  const Lane3 tangent = fma(zero - along, normal, slip);
  const Lane t2 = dot(tangent, tangent);
  const Lane stick = load(args.static_friction) * depth;
  const Lane slide = load(args.dynamic_friction) * depth;
  const Lane part =
      select(t2 < stick * stick, splat(Real{1}), min(slide / sqrt(t2), splat(Real{1})));
  return fma(zero - part, tangent, outside);
}

/// Lanes in which p is certainly farther than `radius` from the shape, without root or division:
/// distance_to() would find so too, whatever the rounding, hence nothing would happen. Lanes that
/// are not clear may or may not touch. `inverse_size`: 1 / size.
[[gnu::always_inline]] inline Mask is_clear(const KernelShape<Real>& s, const Lane3& inverse_size,
                                            const Real* capsule, Lane3 p, Lane radius) {
  // Squared distances within 1e-5 of the limit are left to distance_to().
  const Lane limit = splat(s.size[0]) + radius;
  const Lane limit2 = limit * limit * splat(static_cast<Real>(1.00001));
  if (s.kind == ShapeKind::kCapsule) {
    const Lane3 radial = radial_of_capsule(s, capsule, p);
    return limit2 < dot(radial, radial);
  }
  const Lane3 d = p - splat3(s.origin);
  if (s.kind == ShapeKind::kSphere) return limit2 < dot(d, d);
  if (s.kind == ShapeKind::kHalfSpace) return radius < dot(d, normal_of_half_space(s));
  if (s.kind == ShapeKind::kEllipsoid) {
    // phi = k0 (k0 - 1) / k1 of distance_to() is at least (k0^2 - 1) / (2 k1) outside. 1e-4 of k0^2
    // are far above the rounding of both.
    const Lane3 local = to_shape_frame(s, d);
    const Lane3 u{inverse_size.x * local.x, inverse_size.y * local.y, inverse_size.z * local.z};
    const Lane3 w{inverse_size.x * u.x, inverse_size.y * u.y, inverse_size.z * u.z};
    const Lane above = fma(splat(static_cast<Real>(0.9999)), dot(u, u), splat(Real{-1}));
    const Lane needed2 = splat(Real{4.001F}) * radius * radius * dot(w, w);
    return both(splat(Real{0}) < above, needed2 < above * above);
  }
  return to_mask(0);
}

/// Non-penetration of the particles that may reach shape k, of this kind, at the particle radius.
/// Those that may touch are found first: the long chains of roots and divisions of one then overlap
/// with those of the next.
template <ShapeKind kKind, typename Args>
void resolve_contacts_as(const Args& args, int k) {
  constexpr int kBlock = 64;
  KernelShape<Real> shape = args.shape[k];  // a copy: no store can change it
  shape.kind = kKind;
  const Lane zero = splat(Real{0});
  const Lane radius = load(args.particle_radius);
  const Lane3 inverse_size{splat(Real{1} / shape.size[0]), splat(Real{1} / shape.size[1]),
                           splat(Real{1} / shape.size[2])};
  const std::int32_t* near = args.near + args.particles * k;
  const std::uint32_t* const candidates = args.candidates + k;
  for (int left = args.near_count[k]; left > 0; left -= kBlock, near += kBlock) {
    std::int32_t found[kBlock];
    int count = 0;
    for (int j = 0; j < (left < kBlock ? left : kBlock); ++j) {
      const std::int32_t i = near[j];
      const Lane3 p = load3(args.xs + 3 * kLanes * i);
      const Mask clear = is_clear(shape, inverse_size, args.capsule, p, radius);
      found[count] = i;
      count += (candidates[i * omentum::kMaxShapes] & ~to_bits(clear)) != 0 ? 1 : 0;
    }
    for (int j = 0; j < count; ++j) {
      const std::int32_t i = found[j];
      Real* const memory = args.xs + 3 * kLanes * i;
      const Lane3 p = load3(memory);
      const Surface surface = distance_to(shape, args.capsule, p);
      const Lane depth = radius - surface.phi;
      const Mask touches = both(zero < depth, to_mask(candidates[i * omentum::kMaxShapes]));
      if (to_bits(touches) == 0) continue;
      const Lane3 x = load3(args.x + 3 * kLanes * i);
      store3(memory, select(touches, leave_shape(args, shape, depth, surface.normal, p, x), p));
    }
  }
}

template <typename Args>
void resolve_contacts(const Args& args, int k) {
  switch (args.shape[k].kind) {
    case ShapeKind::kSphere:
      return resolve_contacts_as<ShapeKind::kSphere>(args, k);
    case ShapeKind::kEllipsoid:
      return resolve_contacts_as<ShapeKind::kEllipsoid>(args, k);
    case ShapeKind::kBox:
      return resolve_contacts_as<ShapeKind::kBox>(args, k);
    case ShapeKind::kHalfSpace:
      return resolve_contacts_as<ShapeKind::kHalfSpace>(args, k);
    case ShapeKind::kSdf:
      return resolve_contacts_as<ShapeKind::kSdf>(args, k);
    case ShapeKind::kCapsule:
      return resolve_contacts_as<ShapeKind::kCapsule>(args, k);
  }
}

}  // namespace
