// The lane kernel of the elastic solid: included by solid_kernel.cpp after lanes.h, one translation
// unit per width. Everything except the exported table is in an unnamed namespace (lanes.h says
// why).
//
// Per substep, with d = x - x_n and the potential of the implicit step
//   U(d) = |d - d_inertial|^2 M / (2 h^2) - M g d + Psi(x_n + d) + jaw springs + contact:
//   residual  b = dU/dd,   Newton: H step = b by preconditioned conjugate gradients,   d -= step
//   finish    v = keep d / h,   x = x_n + d

#include "sim_worker/lanes/exponential.inl"
#include "sim_worker/lanes/implicit_step.inl"
#include "sim_worker/lanes/node_effects.inl"
#include "sim_worker/lanes/rigid_contact.inl"

namespace {

using Args = omentum::SolidArgs<Real>;

/// Free nodes start as if nothing acted on them, without gravity (docs/tissue.md 7: rest is then
/// a fixed point); held ones go where the jaw takes them.
void start_substep(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    const int at = 3 * kLanes * i;
    const Lane3 held = load3(args.hold_target + at) - load3(args.x + at);
    store3(args.d + at, select(to_mask(args.free_mask[i]), inertial_displacement(args, i), held));
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Elastic forces. The four integration points lie at L_q = (5 + 3 sqrt 5) / 20, the other volume
// coordinates (5 - sqrt 5) / 20 [Zienkiewicz00, table of tetrahedral rules, degree 2]: exact for
// straight quadratic elements of linear material. With u_ab on the middle of the edge ab the
// deformation gradient is F = sum_a c_a (x) grad L_a,
//   c_a = (4 L_a - 1) u_a + 4 sum_b L_b u_ab.

constexpr auto kNear = static_cast<Real>(0.58541019662496845446);
constexpr auto kFar = static_cast<Real>(0.13819660112501051518);
constexpr Real kCorner = 4 * kFar - 1;      // of u_a, at any point that is not a's
constexpr Real kMiddle = 4 * kFar;          // of u_ab, likewise
constexpr Real kPeak = 4 * (kNear - kFar);  // on top, at the point's own corner
constexpr int kEdge[4][4] = {{-1, 4, 6, 7}, {4, -1, 5, 8}, {6, 5, -1, 9}, {7, 8, 9, -1}};

struct Matrix {
  Lane3 column[3];
};

/// The part of c_a that the four points share.
inline Lane3 common(const Lane3 u[10], int a) {
  Lane3 sum = zero3();
  for (int b = 0; b < 4; ++b) {
    if (b != a) sum = sum + u[kEdge[a][b]];
  }
  return fma(splat(kCorner), u[a], splat(kMiddle) * sum);
}

inline Matrix gradient_at(const Lane3 u[10], const Lane3 shared[4], const Real* g, int q) {
  Matrix f{{zero3(), zero3(), zero3()}};
  for (int a = 0; a < 4; ++a) {
    const Lane3 c = fma(splat(kPeak), a == q ? u[a] : u[kEdge[a][q]], shared[a]);
    for (int k = 0; k < 3; ++k) f.column[k] = fma(splat(g[3 * a + k]), c, f.column[k]);
  }
  return f;
}

/// Adds the nodal forces w P grad N of one point: those of the peak to `force`, the shared part of
/// every corner to `corner`, to be spread once.
inline void add_stress(const Matrix& p, Lane w, const Real* g, int q, Lane3 force[10],
                       Lane3 corner[4]) {
  for (int a = 0; a < 4; ++a) {
    Lane3 t = splat(g[3 * a]) * p.column[0];
    t = fma(splat(g[3 * a + 1]), p.column[1], t);
    t = w * fma(splat(g[3 * a + 2]), p.column[2], t);
    corner[a] = corner[a] + t;
    Lane3& peak = force[a == q ? a : kEdge[a][q]];
    peak = fma(splat(kPeak), t, peak);
  }
}

inline void spread(const Lane3 corner[4], Lane3 force[10]) {
  for (int a = 0; a < 4; ++a) {
    force[a] = fma(splat(kCorner), corner[a], force[a]);
    for (int b = a + 1; b < 4; ++b) {
      force[kEdge[a][b]] = fma(splat(kMiddle), corner[a] + corner[b], force[kEdge[a][b]]);
    }
  }
}

/// Stable neo-Hooke [Smith18, eq. 14]: Psi = mu/2 (I - 3) + lambda/2 (J - alpha)^2 - mu/2 log(I +
/// 1), I = F : F. No polar decomposition, finite through inversion. The part of lambda beyond that
/// of nu = 0.3 acts on the mean of J over the element instead [Nagtegaal74]: quadratic tetrahedra
/// with four points are stiff near incompressibility without.
struct Law {
  Lane mu, lambda, alpha, bulk;
};

inline Law load_law(const Args& args) {
  const auto& fx = args.effects;
  return {load(fx.mu), load(fx.lambda), load(fx.alpha), load(fx.bulk)};
}

struct Point {
  Matrix cofactor;
  Lane jacobian;
  Lane stretch;   ///< factor of F in P: mu (1 - 1 / (I + 1))
  Lane pressure;  ///< factor of the cofactor: lambda (J - alpha)
  Lane tangent;   ///< 2 mu / (I + 1)^2
};

inline Point evaluate(const Law& law, const Matrix& f) {
  const Lane3* const c = f.column;
  Point point;
  point.cofactor = {{cross(c[1], c[2]), cross(c[2], c[0]), cross(c[0], c[1])}};
  const Lane one = splat(Real{1});
  const Lane i = dot(c[0], c[0]) + dot(c[1], c[1]) + dot(c[2], c[2]);
  const Lane inverse = one / (i + one);
  point.stretch = fnma(law.mu, inverse, law.mu);
  point.tangent = splat(Real{2}) * law.mu * inverse * inverse;
  point.jacobian = dot(c[0], point.cofactor.column[0]);
  point.pressure = law.lambda * (point.jacobian - law.alpha);
  return point;
}

/// Deformation gradients and what follows from them at the four points of one element.
struct Element {
  Matrix f[4];
  Point point[4];
  Lane weight[4];  ///< stiffness of the points over that of the lane
  Lane mean;       ///< 1 / sum of the weights
};

inline void load_weights(const Args& args, int t, Element& element) {
  for (Lane& w : element.weight) w = splat(Real{1});
  element.mean = splat(Real{0.25});
  const Real* const map = args.effects.map;
  if (map == nullptr) return;
  for (int q = 0; q < 4; ++q) element.weight[q] = load(map + kLanes * (4 * t + q));
  const Lane* const w = element.weight;
  element.mean = splat(Real{1}) / (w[0] + w[1] + w[2] + w[3]);
}

inline void evaluate(const Law& law, const Lane3 u[10], const Real* g, Element& element) {
  Lane3 shared[4];
  for (int a = 0; a < 4; ++a) shared[a] = common(u, a);
  Lane sum = splat(Real{0});
  for (int q = 0; q < 4; ++q) {
    element.f[q] = gradient_at(u, shared, g, q);
    element.point[q] = evaluate(law, element.f[q]);
    sum = fma(element.weight[q], element.point[q].jacobian, sum);
  }
  const Lane mean = law.bulk * fma(element.mean, sum, splat(Real{-1}));
  for (Point& point : element.point) point.pressure = point.pressure + mean;
}

inline Matrix stress(const Matrix& f, const Point& point) {
  Matrix p;
  for (int k = 0; k < 3; ++k) {
    p.column[k] = fma(point.stretch, f.column[k], point.pressure * point.cofactor.column[k]);
  }
  return p;
}

inline Lane along_cofactor(const Point& point, const Matrix& df) {
  const Lane3* const n = point.cofactor.column;
  return dot(n[0], df.column[0]) + dot(n[1], df.column[1]) + dot(n[2], df.column[2]);
}

/// Change of the stress with F; `bulk` is the change of the mean's pressure.
inline Matrix stress_change(const Law& law, const Matrix& f, const Matrix& df, const Point& point,
                            Lane bulk) {
  const Lane3* const c = f.column;
  const Lane3* const d = df.column;
  const Matrix cofactor_change{{cross(d[1], c[2]) + cross(c[1], d[2]),
                                cross(d[2], c[0]) + cross(c[2], d[0]),
                                cross(d[0], c[1]) + cross(c[0], d[1])}};
  const Lane along = point.tangent * (dot(c[0], d[0]) + dot(c[1], d[1]) + dot(c[2], d[2]));
  const Lane volume = fma(law.lambda, along_cofactor(point, df), bulk);
  Matrix p;
  for (int k = 0; k < 3; ++k) {
    Lane3 sum = point.stretch * d[k];
    sum = fma(along, c[k], sum);
    sum = fma(volume, point.cofactor.column[k], sum);
    p.column[k] = fma(point.pressure, cofactor_change.column[k], sum);
  }
  return p;
}

}  // namespace

#include "sim_worker/solid/solid_effects.inl"

namespace {

inline void scatter(const std::int32_t* node, const Lane3 force[10], Real* to) {
  for (int k = 0; k < 10; ++k) {
    Real* const memory = to + 3 * kLanes * node[k];
    store3(memory, load3(memory) + force[k]);
  }
}

void add_elastic_forces(const Args& args, Real* to) {
  const Lane stiffness = load(args.stiffness);
  const Law law = load_law(args);
  Element element;
  for (int t = 0; t < args.tetrahedra; ++t) {
    const std::int32_t* const node = args.tetrahedron + 10 * t;
    const Real* const g = args.gradient + 12 * t;
    const Lane w = splat(args.volume[t]) * stiffness;
    Lane3 u[10];
    for (int k = 0; k < 10; ++k) u[k] = load3(args.moved + 3 * kLanes * node[k]);
    load_weights(args, t, element);
    evaluate(law, u, g, element);
    Lane3 force[10];
    for (Lane3& f : force) f = zero3();
    Lane3 corner[4];
    for (Lane3& f : corner) f = zero3();
    Matrix p[4];
    for (int q = 0; q < 4; ++q) p[q] = stress(element.f[q], element.point[q]);
    if (args.effects.material != 0) add_effects(args, law, element, t, p);
    for (int q = 0; q < 4; ++q) add_stress(p[q], element.weight[q] * w, g, q, force, corner);
    spread(corner, force);
    scatter(node, force, to);
  }
}

void add_elastic_change(const Args& args) {
  const Lane stiffness = load(args.stiffness);
  const Law law = load_law(args);
  Element element;
  for (int t = 0; t < args.tetrahedra; ++t) {
    const std::int32_t* const node = args.tetrahedron + 10 * t;
    const Real* const g = args.gradient + 12 * t;
    const Lane w = splat(args.volume[t]) * stiffness;
    Lane3 u[10];
    Lane3 du[10];
    for (int k = 0; k < 10; ++k) {
      u[k] = load3(args.moved + 3 * kLanes * node[k]);
      du[k] = load3(args.p + 3 * kLanes * node[k]);
    }
    load_weights(args, t, element);
    evaluate(law, u, g, element);
    Lane3 shared[4];
    for (int a = 0; a < 4; ++a) shared[a] = common(du, a);
    Matrix df[4];
    Lane sum = splat(Real{0});
    for (int q = 0; q < 4; ++q) {
      df[q] = gradient_at(du, shared, g, q);
      sum = fma(element.weight[q], along_cofactor(element.point[q], df[q]), sum);
    }
    const Lane bulk = law.bulk * element.mean * sum;
    Lane3 force[10];
    for (Lane3& f : force) f = zero3();
    Lane3 corner[4];
    for (Lane3& f : corner) f = zero3();
    Matrix dp[4];
    for (int q = 0; q < 4; ++q) {
      dp[q] = stress_change(law, element.f[q], df[q], element.point[q], bulk);
    }
    if (args.effects.material != 0) add_effect_changes(args, law, element, t, df, dp);
    for (int q = 0; q < 4; ++q) add_stress(dp[q], element.weight[q] * w, g, q, force, corner);
    spread(corner, force);
    scatter(node, force, args.hp);
  }
}

/// Memory of the effects at the end of a substep.
void remember_effects(const Args& args) {
  const auto& fx = args.effects;
  for (int i = 0; i < args.nodes; ++i) {
    const int at = 3 * kLanes * i;
    store3(args.moved + at, load3(args.x + at) + load3(args.d + at));
  }
  if (fx.bonds != 0) remember_bonds(args);
  fade_push(fx);
  if ((fx.prony | fx.slider | fx.softening) == 0) return;
  const Law law = load_law(args);
  Element element;
  for (int t = 0; t < args.tetrahedra; ++t) {
    Lane3 u[10];
    for (int k = 0; k < 10; ++k)
      u[k] = load3(args.moved + 3 * kLanes * args.tetrahedron[10 * t + k]);
    load_weights(args, t, element);
    evaluate(law, u, args.gradient + 12 * t, element);
    remember_element(args, law, element, t);
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Contact by the method of multipliers. With the force f of the substep's start and the gain k, the
// force now is
//   normal      f_n + k (radius - distance), if positive
//   tangential  f_t - k slip, cut to Coulomb's bound of f_n
// At rest f no longer changes; then nothing is inside a shape, whatever k. The bound takes the
// normal force of the substep's start: so the step has a potential, and Newton's method converges.

struct Contact {
  Lane3 force;
  Lane3 normal;
  Lane slide;  ///< change of the tangential force with slip [N/m]
  Bits touches;
};

inline Contact evaluate_contact(const Args& args, int i) {
  const int at = 3 * kLanes * i;
  const Lane zero = splat(Real{0});
  const Lane gain = splat(args.contact_gain[i]);
  const Lane3 p = load3(args.moved + at);
  const Lane3 d = load3(args.d + at);
  const Lane3 before = load3(args.contact_force + at);
  Contact contact{zero3(), zero3(), zero, 0};
  for (int k = 0; k < args.shapes; ++k) {
    if ((args.candidate_any[i] >> k & 1U) == 0) continue;
    const KernelShape<Real>& shape = args.shape[k];
    const Surface surface = distance_to(shape, args.capsule, p);
    const Lane3 n = surface.normal;
    const Lane along = dot(before, n);
    const Lane pressed = max(along, zero);
    const Lane force = fma(gain, load(args.particle_radius) - surface.phi, pressed);
    const Mask touches = both(zero < force, to_mask(args.candidates[i * omentum::kMaxShapes + k]));
    if (to_bits(touches) == 0) continue;
    const Lane3 slip = shape.kind == ShapeKind::kCapsule ? d - load3(args.capsule_motion) : d;
    Lane3 friction = before - gain * slip;
    friction = fma(zero - dot(friction, n), n, friction);
    const Lane size = sqrt(dot(friction, friction));
    const Mask sticks = size < load(args.static_friction) * pressed;
    const Lane slides = min(load(args.dynamic_friction) * pressed / size, splat(Real{1}));
    // Without normal force no friction: 0 / 0 must not reach the force.
    const Lane fraction = select(zero < size, select(sticks, splat(Real{1}), slides), zero);
    contact.force =
        select(touches, contact.force + fma(force, n, fraction * friction), contact.force);
    contact.normal = select(touches, n, contact.normal);
    contact.slide = select(touches, fraction * gain, contact.slide);
    contact.touches |= to_bits(touches);
  }
  return contact;
}

void find_contact(const Args& args) {
  for (int k = 0; k < args.contacts; ++k) {
    const int i = args.contact_node[k];
    const Contact contact = evaluate_contact(args, i);
    store3(args.contact_next + 3 * kLanes * i, contact.force);
    store3(args.contact_normal + 3 * kLanes * i, contact.normal);
    store(args.contact_slide + kLanes * i, contact.slide);
    args.touches[i] = contact.touches;
  }
}

/// m / (effective step)^2 of a node [N/m].
inline Lane inertia_of(const Args& args, Lane density, int i) {
  const Lane body = density * splat(args.mass_over_step2[i]);
  if (args.effects.added_mass == nullptr) return body;
  return body + splat(args.effects.added_mass[i] * args.inverse_step * args.inverse_step);
}

/// Inertia, gravity, jaw and contact; the mesh's forces come on top.
void load_node_forces(const Args& args, Real* to) {
  const Lane3 gravity = load3(args.gravity);
  const Lane density = load(args.effects.density);
  for (int i = 0; i < args.nodes; ++i) {
    const int at = 3 * kLanes * i;
    const Lane3 d = load3(args.d + at);
    const Lane inertia = inertia_of(args, density, i);
    Lane3 force = inertia * (d - inertial_displacement(args, i));
    Lane mass = density * splat(args.mass[i]);
    if (args.effects.added_mass != nullptr) mass = mass + splat(args.effects.added_mass[i]);
    force = force - mass * gravity;
    const Lane3 off = load3(args.moved + at) - load3(args.hold_target + at);
    force = fma(load(args.hold_stiffness + kLanes * i), off, force);
    if (args.load != nullptr) force = force - load3(args.load + at);
    store3(to + at, force);
  }
  for (int n = 0; n < args.contacts; ++n) {
    const int at = 3 * kLanes * args.contact_node[n];
    store3(to + at, load3(to + at) - load3(args.contact_next + at));
  }
  add_node_effects(args, to);
}

void keep_free(const Args& args, Real* vector) {
  for (int i = 0; i < args.nodes; ++i) {
    Real* const memory = vector + 3 * kLanes * i;
    store3(memory, select(to_mask(args.free_mask[i]), load3(memory), zero3()));
  }
}

void evaluate_forces(const Args& args, Real* to) {
  for (int i = 0; i < args.nodes; ++i) {
    const int at = 3 * kLanes * i;
    store3(args.moved + at, load3(args.x + at) + load3(args.d + at));
  }
  find_contact(args);
  load_node_forces(args, to);
  add_elastic_forces(args, to);
}

void find_residual(const Args& args) { evaluate_forces(args, args.b); }

/// At a held node b is what the holder adds; the tissue pulls back with the opposite. At a partly
/// covered node the jaw's spring does it.
void find_reaction(const Args& args, Real* out) {
  evaluate_forces(args, out);
  for (int i = 0; i < args.nodes; ++i) {
    const int at = 3 * kLanes * i;
    const Lane3 off = load3(args.moved + at) - load3(args.hold_target + at);
    const Lane3 spring = load(args.hold_stiffness + kLanes * i) * off;
    store3(out + at, select(to_mask(args.free_mask[i]), spring, zero3() - load3(out + at)));
  }
}

void multiply_hessian(const Args& args) {
  const Lane density = load(args.effects.density);
  for (int i = 0; i < args.nodes; ++i) {
    const int at = 3 * kLanes * i;
    const Lane inertia = inertia_of(args, density, i);
    const Lane own = inertia + load(args.hold_stiffness + kLanes * i);
    store3(args.hp + at, own * load3(args.p + at));
  }
  for (int n = 0; n < args.contacts; ++n) {
    const int i = args.contact_node[n];
    if (args.touches[i] == 0) continue;
    const int at = 3 * kLanes * i;
    const Lane3 p = load3(args.p + at);
    const Lane3 normal = load3(args.contact_normal + at);
    const Lane3 across = dot(normal, p) * normal;
    const Lane3 force = fma(load(args.contact_slide + kLanes * i), p - across,
                            splat(args.contact_gain[i]) * across);
    const Lane3 before = load3(args.hp + at);
    store3(args.hp + at, select(to_mask(args.touches[i]), before + force, before));
  }
  add_node_products(args);
  add_elastic_change(args);
}

// ---------------------------------------------------------------------------------------------------------------------
// Vectors of the conjugate gradients.

void dot_product(const Args& args, const Real* a, const Real* b, Real* result) {
  Lane3 sum = zero3();
  for (int i = 0; i < args.nodes; ++i) {
    const Lane3 u = load3(a + 3 * kLanes * i);
    const Lane3 w = load3(b + 3 * kLanes * i);
    sum = {fma(u.x, w.x, sum.x), fma(u.y, w.y, sum.y), fma(u.z, w.z, sum.z)};
  }
  store(result, sum.x + sum.y + sum.z);
}

void add_scaled(const Args& args, Real* a, const Real* c, const Real* factor, std::uint32_t lanes) {
  const Lane scale = load(factor);
  const Mask mask = to_mask(lanes);
  for (int i = 0; i < args.nodes; ++i) {
    Real* const memory = a + 3 * kLanes * i;
    const Lane3 before = load3(memory);
    store3(memory, select(mask, fma(scale, load3(c + 3 * kLanes * i), before), before));
  }
}

void advance_direction(const Args& args, const Real* factor) {
  const Lane scale = load(factor);
  for (int i = 0; i < args.nodes; ++i) {
    const int at = 3 * kLanes * i;
    store3(args.p + at, fma(scale, load3(args.p + at), load3(args.z + at)));
  }
}

/// The contact forces at the solution are what the next substep starts from.
void finish_substep(const Args& args) {
  for (int n = 0; n < args.contacts; ++n) {
    const int at = 3 * kLanes * args.contact_node[n];
    store3(args.moved + at, load3(args.x + at) + load3(args.d + at));
  }
  find_contact(args);
  for (int n = 0; n < args.contacts; ++n) {
    const int at = 3 * kLanes * args.contact_node[n];
    store3(args.contact_force + at, load3(args.contact_next + at));
  }
  take_displacements(args);
}

}  // namespace
