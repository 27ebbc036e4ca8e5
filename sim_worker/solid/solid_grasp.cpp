// The grasp of the elastic solid: which nodes the jaws hold, how they creep out of them, and the
// spring between jaws and patch.
#include <Eigen/Geometry>
#include <algorithm>

#include "sim_worker/solid/solid_tissue.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// A node that the jaw's spring holds this many times stiffer than the step does moves with the jaw.
constexpr double kRigidHold = 100;
constexpr double kLeastCover = 1e-3;

}  // namespace

template <typename Real>
void SolidTissue<Real>::hold(int lane, const Vector3d& tip, double radius, bool collapse) {
  release(lane);
  Held& held = held_[lane];
  const EffectValues& effects = effects_.values(lane);
  const Vector3d beside(effects.grasp_x, effects.grasp_y, 0);
  const Vector3d centre = tip + model_->body.X_WB.linear() * beside;
  const bool rotates = effects.turns_jaw();
  const Eigen::Matrix3d R = jaw_rotation(effects, model_->surroundings.shaft_axis);
  for (int i = 0; i < particles(); ++i) {
    if (this->is_fixed(i)) continue;
    const Vector3d p = position(lane, i);
    const double covered =
        (radius + effects.grasp_radius - (p - centre).norm()) / model_->spacing + 0.5;
    if (!(covered > kLeastCover)) continue;
    Vector3d kept = p - tip;
    if (rotates) kept = R * kept;
    if (collapse) kept.setZero();
    held.nodes.push_back(i);
    held.offsets.push_back(
        {static_cast<Real>(kept.x()), static_cast<Real>(kept.y()), static_cast<Real>(kept.z())});
    held.weights.push_back(static_cast<Real>(std::min(1.0, covered)));
  }
  apply_hold(lane);
}

/// Masks and springs of a grasp. A node that the jaw covers by the part w hangs on a spring of E x
/// spacing x w / (1 - w): the grasp moves smoothly with the pinch point (docs/tissue.md 8). With
/// a spring between jaws and patch (grasp_compliance) the node that is covered best leads: it alone
/// hangs on that spring, the other nodes move with it.
template <typename Real>
void SolidTissue<Real>::apply_hold(int lane) {
  Held& held = held_[lane];
  const std::uint32_t bit = 1U << lane;
  const double compliance = effects_.values(lane).grasp_compliance;
  const bool compliant = compliance > 0 && !held.nodes.empty();
  compliant_ = compliant ? compliant_ | bit : compliant_ & ~bit;
  const auto best = std::max_element(held.weights.begin(), held.weights.end());
  held.leader = static_cast<std::size_t>(best - held.weights.begin());
  for (std::size_t k = 0; k < held.nodes.size(); ++k) {
    const auto i = static_cast<std::size_t>(held.nodes[k]);
    const auto w = static_cast<double>(held.weights[k]);
    const bool leads = compliant && k == held.leader;
    const double spring = model_->material.young_modulus_pa() * model_->spacing * w;
    const bool follows = spring >= kRigidHold * model_->diagonal[i] * (1 - w);
    Real& stiffness = hold_stiffness_(held.nodes[k], lane);
    contact_mask_[i] &= ~bit;
    free_mask_[i] |= bit;
    stiffness = Real{0};
    if (leads) {
      stiffness = static_cast<Real>(1 / compliance);
    } else if (follows) {
      free_mask_[i] &= ~bit;
    } else {
      stiffness = static_cast<Real>(spring / (1 - w));
    }
  }
}

template <typename Real>
void SolidTissue<Real>::release(int lane) {
  Held& held = held_[lane];
  const std::uint32_t bit = 1U << lane;
  for (const std::int32_t node : held.nodes) {
    free_mask_[node] |= bit;
    if (model_->on_surface[node] != 0) contact_mask_[node] |= bit;
    hold_stiffness_(node, lane) = Real{0};
    for (int axis = 0; axis < 3; ++axis) contact_force_(node, axis, lane) = Real{0};
  }
  this->forget_health();
  compliant_ &= ~bit;
  slipped_[lane] = 0;
  held = {};
}

template <typename Real>
void SolidTissue<Real>::shift_held(int lane, const Vector3d& by) {
  for (auto& offset : held_[lane].offsets) {
    for (int axis = 0; axis < 3; ++axis) {
      offset[axis] += static_cast<Real>(by[axis]);
    }
  }
}

/// Before a control step: the patches creep out of the jaws.
template <typename Real>
void SolidTissue<Real>::slip_grasps() {
  for (int lane = 0; lane < lanes(); ++lane) {
    const EffectValues& effects = effects_.values(lane);
    Held& held = held_[lane];
    if (held.nodes.empty() || !(effects.slip_speed > 0)) continue;
    // Near what a rigid disc of the patch's size feels on a half-space, 2 E a / (1 - nu^2).
    Eigen::AlignedBox3d box;
    for (const auto& o : held.offsets) {
      box.extend(Vector3d(static_cast<double>(o[0]), static_cast<double>(o[1]),
                          static_cast<double>(o[2])));
    }
    const double size = box.diagonal().norm() + 2 * model_->spacing;
    const double modulus =
        model_->material.young_modulus_pa() * static_cast<double>(stiffness_[lane]);
    const Vector3d slip = slip_of(effects, this->held_force(lane), modulus * size, slipped_[lane],
                                  model_->control_period);
    double& slipped = slipped_[lane];
    slipped += slip.norm();
    if (effects.slip_loss > 0 && slipped > effects.slip_loss) {
      release(lane);
    } else {
      shift_held(lane, slip);
    }
  }
}

/// Where the jaws take the nodes that they hold.
template <typename Real>
void SolidTissue<Real>::place_held() {
  for (int lane = 0; lane < lanes(); ++lane) {
    const Held& held = held_[lane];
    for (std::size_t k = 0; k < held.nodes.size(); ++k) {
      for (int axis = 0; axis < 3; ++axis) {
        hold_target_(held.nodes[k], axis, lane) = tip_(0, axis, lane) + held.offsets[k][axis];
      }
    }
  }
}

// ---- patches on a spring ------------------------------------------------------------------------
// The patch keeps its shape and moves by `deflection` from where rigid jaws would have it. The
// unknown of that is the place of its leader, a free node on the spring. Those that follow move as
// it does: their residual is its, and so is their row of the Hessian. Partly covered nodes hang on
// the patch.

/// Calls fn(lane, held, axis) for the patches on springs.
template <typename Real>
template <typename Function>
void SolidTissue<Real>::for_each_compliant(Function&& fn) {
  for (int lane = 0; lane < lanes(); ++lane) {
    if ((compliant_ >> lane & 1U) == 0) continue;
    for (int axis = 0; axis < 3; ++axis) fn(lane, held_[lane], axis);
  }
}

/// Patches begin a substep as far from the jaws as they ended the last.
template <typename Real>
void SolidTissue<Real>::begin_compliant_patches() {
  for_each_compliant([&](int lane, Held& held, int axis) {
    for (std::size_t k = 0; k < held.nodes.size(); ++k) {
      const std::int32_t i = held.nodes[k];
      const Real place = hold_target_(i, axis, lane) + held.deflection[axis];
      if (k != held.leader) hold_target_(i, axis, lane) = place;
      if (k == held.leader || !is_free(i, lane)) d_(i, axis, lane) = place - x_(i, axis, lane);
      if (k == held.leader) held.start[axis] = d_(i, axis, lane);
    }
  });
}

template <typename Real>
void SolidTissue<Real>::end_compliant_patches() {
  for_each_compliant([&](int lane, Held& held, int axis) {
    const std::int32_t i = held.nodes[held.leader];
    held.deflection[axis] = x_(i, axis, lane) + d_(i, axis, lane) - hold_target_(i, axis, lane);
  });
}

/// What the patch adds to the residual of its leader, and its motion to that of those that hang on
/// it.
template <typename Real>
void SolidTissue<Real>::gather_residual() {
  for_each_compliant([&](int lane, Held& held, int axis) {
    const std::int32_t leader = held.nodes[held.leader];
    const Real moved = d_(leader, axis, lane) - held.start[axis];
    for (const std::int32_t i : held.nodes) {
      if (i == leader) continue;
      if (!is_free(i, lane)) {
        b_(leader, axis, lane) += b_(i, axis, lane);
        continue;
      }
      const Real spring = hold_stiffness_(i, lane);
      b_(i, axis, lane) -= spring * moved;
      b_(leader, axis, lane) -=
          spring * (x_(i, axis, lane) + d_(i, axis, lane) - hold_target_(i, axis, lane) - moved);
    }
  });
}

/// Nodes that follow move as their leader in `vector`.
template <typename Real>
void SolidTissue<Real>::follow_leaders(LaneArray<Real>& vector) {
  for_each_compliant([&](int lane, Held& held, int axis) {
    const Real moved = vector(held.nodes[held.leader], axis, lane);
    for (const std::int32_t i : held.nodes) {
      if (!is_free(i, lane)) vector(i, axis, lane) = moved;
    }
  });
}

/// gather_residual() for the product hp of the Hessian with p.
template <typename Real>
void SolidTissue<Real>::gather_product() {
  for_each_compliant([&](int lane, Held& held, int axis) {
    const std::int32_t leader = held.nodes[held.leader];
    for (const std::int32_t i : held.nodes) {
      if (i == leader) continue;
      if (!is_free(i, lane)) {
        hp_(leader, axis, lane) += hp_(i, axis, lane);
        continue;
      }
      const Real spring = hold_stiffness_(i, lane);
      hp_(i, axis, lane) -= spring * p_(leader, axis, lane);
      hp_(leader, axis, lane) -= spring * (p_(i, axis, lane) - p_(leader, axis, lane));
    }
  });
}

/// Force on the tool, from the reactions in hp_.
template <typename Real>
void SolidTissue<Real>::find_held_force() {
  for (int lane = 0; lane < lanes(); ++lane) {
    const Held& held = held_[lane];
    const bool compliant = (compliant_ >> lane & 1U) != 0;
    for (int axis = 0; axis < 3; ++axis) {
      Real sum = 0;
      for (const std::int32_t i : held.nodes) {
        if (!compliant) sum += hp_(i, axis, lane);
      }
      if (compliant) sum = hp_(held.nodes[held.leader], axis, lane);
      held_force_(0, axis, lane) = sum;
    }
  }
}

#define OMENTUM_INSTANTIATE(Real)                                            \
  template void SolidTissue<Real>::hold(int, const Vector3d&, double, bool); \
  template void SolidTissue<Real>::apply_hold(int);                          \
  template void SolidTissue<Real>::release(int);                             \
  template void SolidTissue<Real>::shift_held(int, const Vector3d&);         \
  template void SolidTissue<Real>::slip_grasps();                            \
  template void SolidTissue<Real>::place_held();                             \
  template void SolidTissue<Real>::begin_compliant_patches();                \
  template void SolidTissue<Real>::end_compliant_patches();                  \
  template void SolidTissue<Real>::gather_residual();                        \
  template void SolidTissue<Real>::gather_product();                         \
  template void SolidTissue<Real>::follow_leaders(LaneArray<Real>&);         \
  template void SolidTissue<Real>::find_held_force()
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
