// Contact of the elastic shell in lanes: included by shell_kernel.cpp after shell_kernel.inl.
//
// Each touching node has a force f with friction, kept from substep to substep and part of the
// residual: at rest it balances the sheet exactly, whatever the step (docs/decisions/0012). After
// the free solve has given d, forces f + df and a further displacement e are wanted with
//   A e = df,   no node behind the plane of a shape at x + d,   f + df within the friction cone.
// Projected Gauss-Seidel on the sparse A finds df; an exact solve then gives e = A^-1 df, so that
// momentum is conserved whatever residual the sweeps leave.
//
// Friction acts on the face of the sheet, half its thickness from the nodes: it depends on the slip
// of the face, and its moment about the mid-surface (add_bending) acts from the next substep on.
//
// A deformable surface is one more shape, rigid during the sweeps; the exact response is then that
// of both bodies, and the step length along it is smaller (docs/decisions/0020).

namespace {

/// Whether a node may touch the deformable surface in some lane.
inline bool may_touch_surface(const Args& args, int i) {
  return args.surface.active && (args.candidate_any[i] >> args.shapes & 1U) != 0;
}

/// Beyond this distance from a shape [m] the rotation of the face is left out: it does not rub yet.
constexpr double kNearContact = 2e-4;

/// Change of the normal at a node from x to x + d; `normal` is that at x + d.
inline Lane3 find_tilt(const Args& args, int node, Lane3& normal) {
  const auto& stencil = args.stencil[node];
  const Lane3 x = load3(args.x + 3 * kLanes * stencil.base);
  const Lane3 d = load3(args.d + 3 * kLanes * stencil.base);
  Lane3 x_before = zero3();
  Lane3 y_before = zero3();
  Lane3 x_change = zero3();
  Lane3 y_change = zero3();
  for (int k = stencil.entry_begin; k < stencil.entry_end; ++k) {
    const auto& entry = args.bend_entry[k];
    const Lane3 to = load3(args.x + 3 * kLanes * entry.node) - x;
    const Lane3 change = load3(args.d + 3 * kLanes * entry.node) - d;
    x_before = fma(splat(entry.weight[3]), to, x_before);
    y_before = fma(splat(entry.weight[4]), to, y_before);
    x_change = fma(splat(entry.weight[3]), change, x_change);
    y_change = fma(splat(entry.weight[4]), change, y_change);
  }
  const Lane3 before = cross(x_before, y_before);
  const Lane3 after = cross(x_before + x_change, y_before + y_change);
  normal = inverse_length(after) * after;
  return normal - inverse_length(before) * before;
}

/// Planes of the shapes at the present place x + d of each node that may touch in the lanes
/// args.lanes; e = 0.
void place_contacts(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    const int k = 3 * kLanes * i;
    store3(args.contact_motion + k, zero3());
    store3(args.contact_before + k, load3(args.contact_force + k));
    const int end = args.plane_begin[i + 1];
    if (args.plane_begin[i] == end) continue;
    if (may_touch_surface(args, i))
      store3(args.surface.force_before + k, load3(args.surface.force + k));
    if ((args.contact_lanes[i] & args.lanes) == 0) continue;
    const Lane3 d = load3(args.d + k);
    const Lane3 p = load3(args.x + k) + d;
    Lane deepest = splat(static_cast<Real>(-1e30));
    Lane3 displacement = zero3();
    Lane3 facing = zero3();
    for (int n = args.plane_begin[i]; n < end; ++n) {
      const int shape = args.plane_shape[n];
      const Real* const found = args.surface.plane + 4 * kLanes * i;
      const Surface surface = shape == args.shapes
                                  ? Surface{load(found), load3(found + kLanes)}
                                  : distance_to(args.shape[shape], args.capsule, p);
      const Lane depth = load(args.particle_radius) - surface.phi;
      store(args.plane + 4 * kLanes * n, depth);
      store3(args.plane + 4 * kLanes * n + kLanes, surface.normal);
      Lane3 slip = d;
      if (shape == args.shapes) {
        slip = slip - load3(args.surface.motion + k);
      } else if (args.shape[shape].kind == ShapeKind::kCapsule) {
        slip = slip - load3(args.capsule_motion);
      }
      const Mask deeper =
          both(deepest < depth, to_mask(args.candidates[i * omentum::kMaxShapes + shape]));
      displacement =
          select(deeper, fma(depth + dot(slip, surface.normal), surface.normal, zero3() - slip),
                 displacement);
      facing = select(deeper, surface.normal, facing);
      deepest = select(deeper, depth, deepest);
    }
    const Mask near = splat(static_cast<Real>(-kNearContact)) < deepest;
    Lane3 face = zero3();
    if (to_bits(near) != 0) {
      Lane3 normal = zero3();
      const Lane3 tilt = find_tilt(args, i, normal);
      face = select(near, zero3() - face_height(args, normal, facing) * tilt, face);
    }
    store3(args.contact_displacement + k, displacement - fnma(dot(face, facing), facing, face));
    store3(args.contact_face + k, face);
  }
}

/// Displacement of a node under its contacts; `free` is the one without. `off_surface` is the part
/// that the deformable surface causes.
inline Lane3 constrain(const Args& args, int i, Lane3 free, Lane3& off_surface) {
  const Lane zero = splat(Real{0});
  // From where the face slips.
  const Lane3 from =
      zero3() - (load3(args.d + 3 * kLanes * i) + load3(args.contact_face + 3 * kLanes * i));
  Lane3 motion = free;
  for (int n = args.plane_begin[i]; n < args.plane_begin[i + 1]; ++n) {
    const Lane3 normal = load3(args.plane + 4 * kLanes * n + kLanes);
    const Lane depth = load(args.plane + 4 * kLanes * n) - dot(normal, motion);
    const int k = args.plane_shape[n];
    const Mask touches = both(zero < depth, to_mask(args.candidates[i * omentum::kMaxShapes + k]));
    if (to_bits(touches) == 0) continue;
    const bool deformable = k == args.shapes;
    const Lane3 start = deformable ? from + load3(args.surface.motion + 3 * kLanes * i) : from;
    const Lane3 before = motion;
    motion =
        select(touches, leave_shape(args, args.shape[k], depth, normal, motion, start), motion);
    if (deformable) off_surface = motion - before;
  }
  return motion;
}

/// Lanes in which a change of the force on node i is above the tolerance.
inline Bits matters(const Args& args, int i, Lane3 change) {
  const Real tolerance = args.contact_tolerance * args.mass[i];
  return to_bits(splat(tolerance * tolerance) < dot(change, change));
}

/// Lanes of args.lanes in which some contact is not in equilibrium with its force.
Bits unsettled_contacts(const Args& args) {
  Bits lanes = 0;
  for (int i = 0; i < args.nodes; ++i) {
    const Bits active = args.contact_lanes[i] & args.lanes & ~lanes;
    if (active == 0) continue;
    const Lane own = load(args.own_stiffness + kLanes * i);
    const Lane compliance = load(args.own_compliance + kLanes * i);
    const Lane3 free = (splat(Real{0}) - compliance) * load3(args.contact_before + 3 * kLanes * i);
    Lane3 unused = zero3();
    lanes |= matters(args, i, own * constrain(args, i, free, unused)) & active;
  }
  return lanes;
}

/// Springs of the effects at a node in direction of their stiffest [N/m]; zero in lanes without.
inline Lane ground_stiffness(const Args& args, int i) {
  Lane k = splat(Real{0});
  if (args.effects.bonds != 0) k = spring_stiffness(args, i, true);
  if (args.effects.lubrication != 0) k = k + load(args.effects.lubrication_now + kLanes * i);
  return k;
}

/// One sweep over all nodes in the lanes args.lanes, every other one backwards, from e = 0 in sweep
/// 0. Returns the lanes in which a contact force is still changing.
///
/// Half of a node's neighbours need no summing but in even sweeps after the first: in sweep 0 those
/// after it have not moved, and in a backward sweep those before it are where they were when the
/// sweep before came by.
Bits sweep_contacts(const Args& args, int sweep) {
  const bool backwards = sweep % 2 != 0;
  const Lane stiffness = splat(Real{0}) - load(args.key_stiffness);
  const Bits springs = args.effects.springs;
  Bits moving = 0;
  for (int n = 0; n < args.nodes; ++n) {
    const int i = backwards ? args.nodes - 1 - n : n;
    const Bits active = args.free_mask[i] & args.lanes;
    if (active == 0) continue;
    Lane3 sum = zero3();
    const auto add_neighbours = [&](int begin, int end) {
      for (int m = begin; m < end; ++m) {
        const Lane3 e = load3(args.contact_motion + 3 * kLanes * args.preconditioner_node[m]);
        sum = fma(splat(args.preconditioner[m]), e, sum);
      }
    };
    const int middle = args.preconditioner_middle[i];
    Real* const before_it = args.contact_before_sum + 3 * kLanes * i;
    if (backwards) {
      sum = load3(before_it);
    } else {
      add_neighbours(args.preconditioner_begin[i], middle);
      store3(before_it, sum);
    }
    if (sweep > 0) add_neighbours(middle, args.preconditioner_begin[i + 1]);
    Lane own = load(args.own_stiffness + kLanes * i);
    Lane compliance = load(args.own_compliance + kLanes * i);
    if (springs != 0) {
      own = own + ground_stiffness(args, i);
      compliance = select(to_mask(springs), splat(Real{1}) / own, compliance);
    }
    const Lane3 neighbours = stiffness * sum;  // force of the neighbours on the node
    Real* const memory = args.contact_motion + 3 * kLanes * i;
    const Lane3 before = load3(memory);
    if (args.plane_begin[i] == args.plane_begin[i + 1]) {
      store3(memory, select(to_mask(active), compliance * neighbours, before));
      continue;
    }
    const Lane3 free = compliance * (neighbours - load3(args.contact_before + 3 * kLanes * i));
    Lane3 off_surface = zero3();
    const Lane3 next = constrain(args, i, free, off_surface);
    store3(memory, select(to_mask(active), next, before));
    Real* const force = args.contact_force + 3 * kLanes * i;
    store3(force, select(to_mask(active), own * (next - free), load3(force)));
    if (may_touch_surface(args, i)) {
      Real* const part = args.surface.force + 3 * kLanes * i;
      store3(part, select(to_mask(active), own * off_surface, load3(part)));
    }
    moving |= matters(args, i, own * (next - before)) & active & args.contact_lanes[i];
  }
  return moving;
}

/// Right-hand side for the exact response to the change of the forces, negative.
void load_contact_change(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    const int k = 3 * kLanes * i;
    store3(args.b + k, load3(args.contact_before + k) - load3(args.contact_force + k));
  }
}

/// Line search along the change df of the forces. The sweeps reach a few nodes only, so that they
/// overrate the stiffness of contacts, and the whole df would throw the sheet off. With A^-1 times
/// the (negative) change in b, the step length is  s = df . u / df . A^-1 df,  the minimum of the
/// quadratic whose gradient is the wanted displacement u (contact_displacement), for contacts that
/// stick; within [0, 1] the forces stay inside their cones.
void take_contact_change(const Args& args) {
  Lane wanted = splat(Real{0});
  Lane reached = splat(static_cast<Real>(1e-30));
  for (int i = 0; i < args.nodes; ++i) {
    if (args.plane_begin[i] == args.plane_begin[i + 1]) continue;
    const int k = 3 * kLanes * i;
    const Lane3 change = load3(args.contact_force + k) - load3(args.contact_before + k);
    wanted = wanted + dot(change, load3(args.contact_displacement + k));
    reached = reached - dot(change, load3(args.b + k));
  }
  const Lane zero = splat(Real{0});
  const Lane step = max(min(wanted / reached, splat(Real{1})), zero);
  const Mask lanes = to_mask(args.lanes);
  for (int i = 0; i < args.nodes; ++i) {
    const int k = 3 * kLanes * i;
    if (args.plane_begin[i] != args.plane_begin[i + 1]) {
      const Lane3 before = load3(args.contact_before + k);
      const Lane3 force = load3(args.contact_force + k);
      store3(args.contact_force + k, select(lanes, fma(step, force - before, before), force));
    }
    if (args.fixed[i] != 0) continue;
    const Lane3 d = load3(args.d + k);
    store3(args.d + k, select(lanes, fnma(step, load3(args.b + k), d), d));
  }
}

/// The same on a deformable surface, with its response. The sweeps take it for rigid: where sheet
/// and surface yield together, df is many times too large, and part of it oscillates from pass to
/// pass. So the changes of the passes are made conjugate in the compliance of both [Hestenes52], as
/// far as contacts do not open or close in between; `beta` is the coefficient of the last
/// direction. A force may leave its cone by this; the sweeps of the next pass bring it back.
void take_surface_change(const Args& args) {
  const omentum::SurfaceArgs<Real>& s = args.surface;
  Lane wanted = splat(Real{0});
  Lane wanted_before = splat(Real{0});
  Lane reached = splat(static_cast<Real>(1e-30)) + load(s.work);
  Lane cross = load(s.cross);
  for (int i = 0; i < args.nodes; ++i) {
    if (args.plane_begin[i] == args.plane_begin[i + 1]) continue;
    const int k = 3 * kLanes * i;
    const Lane3 change = load3(args.contact_force + k) - load3(args.contact_before + k);
    const Lane3 displacement = load3(args.contact_displacement + k);
    wanted = wanted + dot(change, displacement);
    reached = reached - dot(change, load3(args.b + k));
    if (!s.follows) continue;
    wanted_before = wanted_before + dot(load3(s.direction + k), displacement);
    cross = cross - dot(change, load3(s.direction_displacement + k));
  }
  const Lane zero = splat(Real{0});
  const Lane one = splat(Real{1});
  const Mask lanes = to_mask(args.lanes);
  Lane beta = zero;
  if (s.follows) {
    const Lane before = load(s.direction_work);
    beta = max(min(zero - cross / before, one), zero - one);
    wanted = fma(beta, wanted_before, wanted);
    reached = fma(beta, fma(beta, before, cross + cross), reached);
  }
  const Lane step = max(min(wanted / reached, one), zero);
  store(s.direction_work, select(lanes, reached, load(s.direction_work)));
  store(s.beta, select(lanes, beta, load(s.beta)));
  store(s.step_length, select(lanes, step, load(s.step_length)));
  const auto advance = [&](Lane3 change, Real* direction) {
    const Lane3 before = load3(direction);
    const Lane3 next = s.follows ? fma(beta, before, change) : change;
    store3(direction, select(lanes, next, before));
    return next;
  };
  for (int i = 0; i < args.nodes; ++i) {
    const int k = 3 * kLanes * i;
    if (args.plane_begin[i] != args.plane_begin[i + 1]) {
      const Lane3 before = load3(args.contact_before + k);
      const Lane3 force = load3(args.contact_force + k);
      const Lane3 next = fma(step, advance(force - before, s.direction + k), before);
      store3(args.contact_force + k, select(lanes, next, force));
    }
    if (may_touch_surface(args, i)) {
      const Lane3 before = load3(s.force_before + k);
      const Lane3 force = load3(s.force + k);
      const Lane3 next = fma(step, advance(force - before, s.direction_part + k), before);
      store3(s.force + k, select(lanes, next, force));
    }
    if (args.fixed[i] != 0) continue;
    const Lane3 d = load3(args.d + k);
    const Lane3 response = advance(load3(args.b + k), s.direction_displacement + k);
    store3(args.d + k, select(lanes, fnma(step, response, d), d));
  }
}

/// Lanes in which each node may touch; forces of the others are dropped.
void drop_far_contacts(const Args& args) {
  for (int i = 0; i < args.nodes; ++i) {
    Bits near = 0;
    for (int k = 0; k < args.shapes; ++k) {
      if ((args.candidate_any[i] >> k & 1U) != 0)
        near |= args.candidates[i * omentum::kMaxShapes + k];
    }
    Real* const force = args.contact_force + 3 * kLanes * i;
    if (args.surface.active) {
      const Bits at_surface = args.candidates[i * omentum::kMaxShapes + args.shapes];
      near |= at_surface;
      Real* const part = args.surface.force + 3 * kLanes * i;
      const Mask stays = to_mask(at_surface);
      store3(force, select(stays, load3(force), load3(force) - load3(part)));
      store3(part, select(stays, load3(part), zero3()));
    }
    args.contact_lanes[i] = near;
    store3(force, select(to_mask(near), load3(force), zero3()));
  }
}

}  // namespace
