// The lane kernel of the elastic shell: included by shell_kernel.cpp after lanes.h, one translation
// unit per width; shell_contact.inl has the contact. Everything except the exported table is in an
// unnamed namespace (lanes.h says why).
//
// Per substep (docs/tissue.md 7), with d = x - x_n:
//   start      d = h v, without gravity (the start rule)
//   residual   b = M/h^2 (d - h v) - M g - f_contact + grad Psi(x_n + d)
//   solve      d -= A^-1 b, then the grasp by low rank and the contact forces
//   finish     v = keep d / h,   x = x_n + d

namespace {

using omentum::kPatchRows;
using Args = omentum::ShellArgs<Real>;

}  // namespace

#include "sim_worker/lanes/exponential.inl"
#include "sim_worker/lanes/implicit_step.inl"
#include "sim_worker/lanes/node_effects.inl"
#include "sim_worker/lanes/rigid_contact.inl"
#include "sim_worker/shell/shell_bending.inl"
#include "sim_worker/shell/shell_effects.inl"
namespace {

void start_substep(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    const Lane3 d = args.fixed[i] != 0 ? zero3() : inertial_displacement(args, i);
    store3(args.d + 3 * kLanes * i, d);
  }
  start_effects(args);
}

// ---------------------------------------------------------------------------------------------------------------------
// Residual.

/// Inertia, gravity and contact of each node.
void load_node_forces(const Args& args) {
  const Lane3 gravity = load3(args.gravity);
  const Lane density = load(args.effects.density);
  const Lane inverse_step2 = splat(args.inverse_step * args.inverse_step);
  for (int i = 0; i < args.nodes; ++i) {
    if (args.fixed[i] != 0) {
      store3(args.b + 3 * kLanes * i, zero3());
      continue;
    }
    Lane mass = density * (args.effects.mass == nullptr ? splat(args.mass[i])
                                                        : load(args.effects.mass + kLanes * i));
    if (args.effects.added_mass != nullptr) mass = mass + splat(args.effects.added_mass[i]);
    Lane3 force = zero3() - mass * gravity;
    if (args.has_contact) force = force - load3(args.contact_force + 3 * kLanes * i);
    if (!args.at_start) {
      const Lane3 d = load3(args.d + 3 * kLanes * i);
      force = fma(mass * inverse_step2, d - inertial_displacement(args, i), force);
    }
    store3(args.b + 3 * kLanes * i, force);
  }
}

struct EdgeForces {
  Lane3 x, y;
};

/// Forces along the two legs of a right triangle, from the legs themselves.
template <bool kEffects, ShellLaw kLaw>
inline EdgeForces membrane(const Args& args, Lane3 ex, Lane3 ey, Lane shear, Lane area,
                           int triangle) {
  const Lane scale = load(args.effects.inverse_pitch2);
  const Lane p = scale * dot(ex, ex);
  const Lane q = scale * dot(ex, ey);
  const Lane r = scale * dot(ey, ey);
  Stress s = law_stress<kLaw>(args, p, q, r, shear, area);
  if (kEffects) s = add_effects(args, {p, q, r}, shear, s, triangle);
  return {fma(s.xx, ex, s.xy * ey), fma(s.xy, ex, s.yy * ey)};
}

/// Two triangles per cell, their diagonals alternating; every triangle has one leg along each axis.
///   e --xe-- c
///   ya      yb      even cells: (xa, yb) and (xe, ya);   odd cells: (xa, ya) and (xe, yb)
///   a --xa-- b
template <bool kEffects, ShellLaw kLaw>
void add_membrane_forces(const Args& args) {
  Lane shear = load(args.effects.shear);
  Lane area = load(args.effects.area);
  constexpr int kNode = 3 * kLanes;
  for (int ix = 0; ix + 1 < args.count_x; ++ix) {
    const int begin = args.count_y * ix;
    const int next = begin + args.count_y;
    // Forces and positions of the lower pair of nodes stay in registers from cell to cell.
    Lane3 a = load3(args.moved + kNode * begin);
    Lane3 b = load3(args.moved + kNode * next);
    Lane3 force_a = load3(args.b + kNode * begin);
    Lane3 force_b = load3(args.b + kNode * next);
    for (int iy = 0; iy + 1 < args.count_y; ++iy) {
      const int cell = (args.count_y - 1) * ix + iy;
      if (kEffects && args.effects.cell != nullptr) {
        shear = load(args.effects.cell + 2 * kLanes * cell);
        area = load(args.effects.cell + 2 * kLanes * cell + kLanes);
      }
      const Lane3 e = load3(args.moved + kNode * (begin + iy + 1));
      const Lane3 c = load3(args.moved + kNode * (next + iy + 1));
      const Lane3 xa = b - a;
      const Lane3 xe = c - e;
      const Lane3 ya = e - a;
      const Lane3 yb = c - b;
      const bool even = (ix + iy) % 2 == 0;
      const EdgeForces low =
          membrane<kEffects, kLaw>(args, xa, even ? yb : ya, shear, area, 2 * cell);
      const EdgeForces high =
          membrane<kEffects, kLaw>(args, xe, even ? ya : yb, shear, area, 2 * cell + 1);
      const Lane3 left = even ? high.y : low.y;
      const Lane3 right = even ? low.y : high.y;
      store3(args.b + kNode * (begin + iy), force_a - low.x - left);
      store3(args.b + kNode * (next + iy), force_b + low.x - right);
      force_a = load3(args.b + kNode * (begin + iy + 1)) - high.x + left;
      force_b = load3(args.b + kNode * (next + iy + 1)) + high.x + right;
      a = e;
      b = c;
    }
    store3(args.b + kNode * (begin + args.count_y - 1), force_a);
    store3(args.b + kNode * (next + args.count_y - 1), force_b);
  }
}

/// Calls fn(leg x, leg y, triangle) for the triangles of a mesh, the legs turned into its frame.
template <typename Function>
inline void for_each_mesh_triangle(const Args& args, Function&& fn) {
  for (int t = 0; t < args.triangles; ++t) {
    const auto& triangle = args.mesh[t];
    const Lane3 origin = load3(args.moved + 3 * kLanes * triangle.node[0]);
    const Lane3 e1 = load3(args.moved + 3 * kLanes * triangle.node[1]) - origin;
    const Lane3 e2 = load3(args.moved + 3 * kLanes * triangle.node[2]) - origin;
    const Real* const b = triangle.inverse;
    fn(fma(splat(b[2]), e2, splat(b[0]) * e1), fma(splat(b[3]), e2, splat(b[1]) * e1), t);
  }
}

template <bool kEffects, ShellLaw kLaw>
void add_mesh_forces(const Args& args) {
  for_each_mesh_triangle(args, [&](Lane3 leg_x, Lane3 leg_y, int t) {
    const Lane shear = load(args.effects.cell + 2 * kLanes * t);
    const Lane area = load(args.effects.cell + 2 * kLanes * t + kLanes);
    const EdgeForces on = membrane<kEffects, kLaw>(args, leg_x, leg_y, shear, area, t);
    const Real* const b = args.mesh[t].inverse;
    const Lane3 one = fma(splat(b[1]), on.y, splat(b[0]) * on.x);
    const Lane3 two = fma(splat(b[3]), on.y, splat(b[2]) * on.x);
    const auto add = [&](int corner, Lane3 force) {
      Real* const to = args.b + 3 * kLanes * args.mesh[t].node[corner];
      store3(to, load3(to) + force);
    };
    add(0, zero3() - (one + two));
    add(1, one);
    add(2, two);
  });
}

template <ShellLaw kLaw>
void add_membrane_of(const Args& args) {
  if (args.mesh != nullptr) {
    args.effects.membrane ? add_mesh_forces<true, kLaw>(args) : add_mesh_forces<false, kLaw>(args);
  } else {
    args.effects.membrane ? add_membrane_forces<true, kLaw>(args)
                          : add_membrane_forces<false, kLaw>(args);
  }
}

void add_membrane(const Args& args) {
  switch (args.law) {
    case ShellLaw::kCorotated:
      return add_membrane_of<ShellLaw::kCorotated>(args);
    case ShellLaw::kNeoHooke:
      return add_membrane_of<ShellLaw::kNeoHooke>(args);
    case ShellLaw::kStVenant:
      return add_membrane_of<ShellLaw::kStVenant>(args);
  }
}

void find_residual(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    const Lane3 moved = load3(args.x + 3 * kLanes * i) + load3(args.d + 3 * kLanes * i);
    store3(args.moved + 3 * kLanes * i, moved);
  }
  load_node_forces(args);
  add_bending(args);
  add_membrane(args);
  add_node_effects(args);
}

/// End of a substep: what the triangles remember.
void remember_membrane(const Args& args) {
  const auto& fx = args.effects;
  Lane shear = load(fx.shear);
  Lane area = load(fx.area);
  const Lane scale = load(fx.inverse_pitch2);
  const auto remember = [&](Lane3 ex, Lane3 ey, int triangle) {
    const Lane p = scale * dot(ex, ex);
    const Lane q = scale * dot(ex, ey);
    const Lane r = scale * dot(ey, ey);
    Stress s = corotated_stress(p, q, r, shear, area);
    if (args.law == ShellLaw::kNeoHooke) s = neo_hooke_stress(args, p, q, r, shear);
    if (args.law == ShellLaw::kStVenant) s = st_venant_stress(p, q, r, shear, area);
    remember_triangle(args, {p, q, r}, shear, s, triangle);
  };
  if (args.mesh != nullptr) {
    for_each_mesh_triangle(args, [&](Lane3 leg_x, Lane3 leg_y, int t) {
      shear = load(fx.cell + 2 * kLanes * t);
      area = load(fx.cell + 2 * kLanes * t + kLanes);
      remember(leg_x, leg_y, t);
    });
    return;
  }
  for (int ix = 0; ix + 1 < args.count_x; ++ix) {
    for (int iy = 0; iy + 1 < args.count_y; ++iy) {
      const int cell = (args.count_y - 1) * ix + iy;
      if (fx.cell != nullptr) {
        shear = load(fx.cell + 2 * kLanes * cell);
        area = load(fx.cell + 2 * kLanes * cell + kLanes);
      }
      const int at = args.count_y * ix + iy;
      const Lane3 a = load3(args.moved + 3 * kLanes * at);
      const Lane3 e = load3(args.moved + 3 * kLanes * (at + 1));
      const Lane3 b = load3(args.moved + 3 * kLanes * (at + args.count_y));
      const Lane3 c = load3(args.moved + 3 * kLanes * (at + args.count_y + 1));
      const bool even = (ix + iy) % 2 == 0;
      remember(b - a, even ? c - b : e - a, 2 * cell);
      remember(c - e, even ? e - a : c - b, 2 * cell + 1);
    }
  }
}

/// End of a substep, before finish_substep: what the effects remember.
void remember_effects(const Args& args) {
  const auto& fx = args.effects;
  for (int i = 0; i < args.nodes; ++i) {
    const Lane3 moved = load3(args.x + 3 * kLanes * i) + load3(args.d + 3 * kLanes * i);
    store3(args.moved + 3 * kLanes * i, moved);
  }
  if (fx.bonds != 0) remember_bonds(args);
  fade_push(fx);
  const bool law = args.law != ShellLaw::kCorotated;
  if (!law && (fx.prony | fx.slider | fx.stiffening | fx.softening) == 0) return;
  remember_membrane(args);
  if (fx.prony != 0) remember_bending(args);
}

void subtract_solution(const Args& args) {
  const Mask lanes = to_mask(args.lanes);
  for (int i = 0; i < args.nodes; ++i) {
    if (args.fixed[i] != 0) continue;
    Real* const memory = args.d + 3 * kLanes * i;
    const Lane3 d = load3(memory);
    store3(memory, select(lanes, d - load3(args.b + 3 * kLanes * i), d));
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Grasp, with C the rows of the patch (docs/tissue.md 8):
//   lambda += (C A^-1 C^T + c)^-1 (C x - target - c lambda),   d -= A^-1 C^T change of lambda

/// C x - target of all rows. Places count from the tip on: that costs no bits.
inline void find_patch_miss(const Args& args, Real* miss) {
  for (int k = 0; k < 3 * kPatchRows * kLanes; ++k) miss[k] = Real{0} - args.patch_offset[k];
  for (int k = 0; k < args.patch_size; ++k) {
    for (int lane = 0; lane < kLanes; ++lane) {
      const int node = args.patch_node[k * kLanes + lane];
      for (int axis = 0; axis < 3; ++axis) {
        const int at = (3 * node + axis) * kLanes + lane;
        const Real p = (args.x[at] - args.patch_tip[axis * kLanes + lane]) + args.d[at];
        for (int row = 0; row < kPatchRows; ++row) {
          const Real weight = args.patch_weight[(kPatchRows * k + row) * kLanes + lane];
          miss[(3 * row + axis) * kLanes + lane] += weight * p;
        }
      }
    }
  }
}

void hold_patch(const Args& args) {
  const Mask lanes = to_mask(args.lanes);
  Real memory[3 * kPatchRows * kLanes];
  find_patch_miss(args, memory);
  Lane3 miss[kPatchRows];
  for (int row = 0; row < kPatchRows; ++row) miss[row] = load3(memory + 3 * kLanes * row);
  miss[0] = fnma(load(args.patch_compliance), load3(args.patch_force), miss[0]);
  Lane3 change[kPatchRows];
  for (int row = 0; row < kPatchRows; ++row) {
    Lane3 sum = zero3();
    for (int k = 0; k < kPatchRows; ++k)
      sum = fma(load(args.patch_inverse + (kPatchRows * row + k) * kLanes), miss[k], sum);
    change[row] = select(lanes, sum, zero3());
    Real* const force = args.patch_force + 3 * kLanes * row;
    store3(force, load3(force) + change[row]);
  }
  for (int i = 0; i < args.nodes; ++i) {
    Real* const displacement = args.d + 3 * kLanes * i;
    const Lane3 before = load3(displacement);
    Lane3 d = before;
    for (int row = 0; row < kPatchRows; ++row)
      d = fnma(load(args.patch_response + (kPatchRows * i + row) * kLanes), change[row], d);
    store3(displacement, select(lanes, d, before));
  }
}

// ---------------------------------------------------------------------------------------------------------------------

void finish_substep(const Args& args) { take_displacements(args); }

}  // namespace
