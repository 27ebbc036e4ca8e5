// The elastic shell in lanes: construction, parameters and the step. Contact, grasp and saved
// states are in shell_contact.cpp, shell_grasp.cpp and shell_state.cpp.
#include "sim_worker/shell/shell_tissue.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Rounds of conjugate gradients where tissue hangs on springs (effects adhesion and suction).
constexpr int kSpringRounds = 8;

template <typename Real>
AlignedVector<Real> convert(const std::vector<double>& values) {
  AlignedVector<Real> result;
  result.reserve(values.size());
  for (const double v : values) result.push_back(static_cast<Real>(v));
  return result;
}

}  // namespace

template <typename Real>
ShellTissue<Real>::ShellTissue(std::shared_ptr<const ShellTissueModel> model,
                               const LaneKernel<Real>& kernel)
    : model_(std::move(model)),
      kernel_(kernel),
      shell_(kernel_of<ShellKernel<Real>>(kernel.lanes)),
      effects_(model_, kernel.lanes) {
  OMENTUM_CHECK(shell_.lanes == kernel_.lanes);
  const auto W = static_cast<std::size_t>(kernel_.lanes);
  const auto n = static_cast<std::size_t>(model_->nodes());
  const double step = model_->effective_step();
  const bool second_order = model_->parameters.integrator() == pb::INTEGRATOR_BDF2;

  mass_ = convert<Real>(model_->structure.mass);

  for (auto* v : {&x_, &v_, &d_, &moved_, &b_, &keep_b_, &contact_force_}) {
    v->assign(3 * n * W, Real{0});
  }
  if (second_order) {
    v_old_.assign(3 * n * W, Real{0});
    d_old_.assign(3 * n * W, Real{0});
  }
  held_.resize(W);
  held_force_.assign(3 * W, Real{0});
  parameters_.resize(W);
  slipped_.assign(W, 0);
  patch_give_.assign(W, Real{0});
  key_.assign(W, 0);
  for (auto* v : {&stiffness_, &keep_, &static_friction_, &dynamic_friction_}) {
    v->assign(W, Real{0});
  }
  gravity_.assign(3 * W, Real{0});
  args_.count_x = model_->count_x;
  args_.count_y = model_->count_y;
  args_.nodes = model_->nodes();
  args_.triangles = model_->triangles();
  if (model_->is_mesh()) load_mesh();
  load_stencils();
  args_.fixed = model_->body.fixed.data();
  args_.mass = mass_.data();
  args_.second_order = second_order;
  args_.effective_step = static_cast<Real>(step);
  args_.inverse_step = static_cast<Real>(1 / step);
  args_.third = static_cast<Real>(1.0 / 3);
  args_.has_contact = model_->has_contact();
  args_.x = x_.data();
  args_.v = v_.data();
  args_.v_old = v_old_.data();
  args_.d_old = d_old_.data();
  args_.d = d_.data();
  args_.moved = moved_.data();
  args_.b = b_.data();
  args_.contact_force = contact_force_.data();
  args_.stiffness = stiffness_.data();
  args_.gravity = gravity_.data();
  args_.keep = keep_.data();
  args_.patch_give = patch_give_.data();
  patch_inverse_.assign(kPatchRows * kPatchRows * W, Real{0});
  patch_response_.assign(kPatchRows * n * W, Real{0});
  for (auto* v : {&patch_offset_, &patch_force_}) v->assign(3 * kPatchRows * W, Real{0});
  patch_tip_.assign(3 * W, Real{0});
  args_.patch_tip = patch_tip_.data();
  args_.patch_offset = patch_offset_.data();
  args_.patch_inverse = patch_inverse_.data();
  args_.patch_response = patch_response_.data();
  args_.patch_force = patch_force_.data();
  make_room(1);
  prepare_contacts();
  for (int lane = 0; lane < lanes(); ++lane) {
    set_parameters(lane, {});
    reset(lane, Vector3d::Zero());
  }
}

template <typename Real>
void ShellTissue<Real>::load_mesh() {
  for (const SheetTriangle& triangle : model_->mesh.triangles) {
    const Eigen::Matrix2d inverse = model_->pitch * triangle.inverse;
    const auto entry = [&](int i, int j) { return static_cast<Real>(inverse(i, j)); };
    mesh_.push_back({{triangle.node[0], triangle.node[1], triangle.node[2]},
                     {entry(0, 0), entry(0, 1), entry(1, 0), entry(1, 1)}});
  }
  args_.mesh = mesh_.data();
}

template <typename Real>
void ShellTissue<Real>::load_stencils() {
  const auto real = [](double v) { return static_cast<Real>(v); };
  for (std::size_t s = 0; s < model_->stencils.size(); ++s) {
    const CurvatureStencil& at = model_->stencils[s].at;
    const Eigen::Vector4d& k = model_->structure.plate[s];
    const auto begin = static_cast<std::int32_t>(bend_entry_.size());
    stencil_.push_back({at.base,
                        begin,
                        begin + static_cast<std::int32_t>(at.node.size()),
                        {real(k[0]), real(k[1]), real(k[2]), real(k[3])}});
    for (std::size_t e = 0; e < at.node.size(); ++e) {
      const CurvatureStencil::Weight& w = at.weight[e];
      bend_entry_.push_back(
          {at.node[e], {real(w[0]), real(w[1]), real(w[2]), real(w[3]), real(w[4])}});
    }
  }
  args_.stencil = stencil_.data();
  args_.stencils = static_cast<std::int32_t>(stencil_.size());
  args_.bend_entry = bend_entry_.data();
}

template <typename Real>
const typename ShellTissue<Real>::Factor& ShellTissue<Real>::factor_of(int key) {
  const auto found = factors_.find(key);
  if (found != factors_.end()) return found->second;
  Factor& factor = factors_[key];
  factor.shared = model_->factor(key);
  factor.lanes = LaneFactor<Real>(*factor.shared);
  return factor;
}

template <typename Real>
void ShellTissue<Real>::group_lanes() {
  groups_.clear();
  std::map<int, std::uint32_t> lanes_of;
  for (int lane = 0; lane < lanes(); ++lane) {
    lanes_of[key_[static_cast<std::size_t>(lane)]] |= 1U << lane;
  }
  for (const auto& [key, mask] : lanes_of) groups_.push_back({&factor_of(key), mask});
}

template <typename Real>
void ShellTissue<Real>::set_parameters(int lane, const LaneParameters& parameters) {
  OMENTUM_CHECK(usable(parameters), "stiffness {}, gravity {}, damping {}, friction {}",
                parameters.stiffness_scale, parameters.gravity_scale, parameters.damping_scale,
                parameters.friction_scale);
  const auto W = static_cast<std::size_t>(lanes());
  const auto l = static_cast<std::size_t>(lane);
  parameters_[l] = parameters;
  stiffness_[l] = static_cast<Real>(parameters.stiffness_scale);
  const double damping = model_->material.damping_per_s() * parameters.damping_scale;
  keep_[l] = static_cast<Real>(decay(damping * model_->effective_step()));
  const EffectValues& effects = parameters.effects ? *parameters.effects : model_->effects;
  const Vector3d gravity = tilted_gravity(effects, model_->surroundings.gravity);
  for (int axis = 0; axis < 3; ++axis) {
    gravity_[static_cast<std::size_t>(axis) * W + l] =
        static_cast<Real>(gravity[axis] * parameters.gravity_scale);
  }
  const double friction = parameters.friction_scale * (1 + effects.friction_change);
  static_friction_[l] = static_cast<Real>(model_->surroundings.static_friction * friction);
  dynamic_friction_[l] = static_cast<Real>(model_->surroundings.dynamic_friction * friction);
  patch_give_[l] = static_cast<Real>(effects.grasp_compliance);
  effects_.set(lane, effects, parameters.stiffness_scale);
  args_.effects = effects_.args();
  update_key(lane);
}

template <typename Real>
void ShellTissue<Real>::update_key(int lane) {
  const auto l = static_cast<std::size_t>(lane);
  key_[l] = effects_.factor_key(lane);
  if (args_.has_contact) set_contact_stiffness(lane);
  group_lanes();
  if (held_[l].radius > 0) make_patch(lane);
}

template <typename Real>
void ShellTissue<Real>::reset(int lane, const Vector3d& offset) {
  release(lane);
  for (int i = 0; i < particles(); ++i) {
    const auto p = static_cast<std::size_t>(i);
    set_position(lane, i, model_->body.X_WB * model_->body.particles[p] + offset);
    set_velocity(lane, i, Vector3d::Zero());
    if (model_->body.fixed[p] == 0) free_mask_[p] |= 1U << lane;
    for (int axis = 0; axis < 3; ++axis) contact_force_[index(i, axis, lane)] = Real{0};
  }
  for (int axis = 0; axis < 3; ++axis) held_force_[index(0, axis, lane)] = Real{0};
  effects_.reset(lane, offset);
  update_key(lane);
}

// One control step (tissue.md section 7). The tool moves on a straight line over the substeps.
template <typename Real>
void ShellTissue<Real>::step(std::span<const ToolMotion> motion) {
  OMENTUM_CHECK(static_cast<int>(motion.size()) == lanes());
  const auto substeps = static_cast<int>(model_->parameters.substeps());
  const auto iterations = static_cast<int>(model_->parameters.iterations());
  slip_grasps();
  if (args_.has_contact) find_contacts(motion);
  for (int substep = 0; substep < substeps; ++substep) {
    const std::uint32_t changed = effects_.begin_substep();
    args_.effects = effects_.args();
    for (int lane = 0; lane < lanes() && changed != 0; ++lane) {
      if ((changed >> lane & 1U) != 0) update_key(lane);
    }
    place_tool(motion, substep);
    shell_.start_substep(args_);
    if (surface_ != nullptr) surface_->start_substep(motion, substep, x_.data());
    for (int iteration = 0; iteration < iterations; ++iteration) {
      args_.at_start = iteration == 0;
      iterate();
    }
    if (surface_ != nullptr) surface_->finish_substep(substep + 1 == substeps);
    shell_.remember_effects(args_);
    shell_.finish_substep(args_);
  }
  for (int lane = 0; lane < lanes(); ++lane) {
    for (int axis = 0; axis < 3; ++axis) {
      held_force_[index(0, axis, lane)] = patch_force_[index(0, axis, lane)];
    }
  }
}

template <typename Real>
void ShellTissue<Real>::place_tool(std::span<const ToolMotion> motion, int substep) {
  const auto substeps = static_cast<int>(model_->parameters.substeps());
  const double share = (substep + 1.0) / substeps;
  for (int lane = 0; lane < lanes(); ++lane) {
    const ToolMotion& m = motion[static_cast<std::size_t>(lane)];
    const Vector3d tip = m.from + share * (m.to - m.from);
    const Vector3d base = model_->surroundings.capsule_at(tip);
    for (int axis = 0; axis < 3; ++axis) {
      capsule_[index(0, axis, lane)] = static_cast<Real>(base[axis]);
      capsule_motion_[index(0, axis, lane)] =
          static_cast<Real>((m.to[axis] - m.from[axis]) / substeps);
      patch_tip_[index(0, axis, lane)] = static_cast<Real>(tip[axis]);
    }
  }
}

// One iteration: residual, solve, grasp, contact.
template <typename Real>
void ShellTissue<Real>::iterate() {
  shell_.find_residual(args_);
  if (effects_.has_springs()) {
    solve_with_springs();
    args_.lanes = ~0U;
    shell_.subtract_solution(args_);
  } else {
    solve_for(~0U, shell_.subtract_solution);
  }
  if (held_lanes_ != 0) {
    std::fill(patch_force_.begin(), patch_force_.end(), Real{0});
    hold_for(held_lanes_);
  }
  if (args_.has_contact && !plane_shape_.empty()) resolve_contacts();
}

/// A^-1 b in the given lanes, one solve per distinct factor, and what is then done with it.
template <typename Real>
void ShellTissue<Real>::solve_for(std::uint32_t lanes, void (*take)(const ShellArgs<Real>&)) {
  const bool several = groups_.size() > 1;
  if (several) keep_b_ = b_;
  bool first = true;
  for (const KeyGroup& group : groups_) {
    args_.lanes = group.lanes & lanes;
    if (args_.lanes == 0) continue;
    if (!first) b_ = keep_b_;
    first = false;
    kernel_.solve_vectors(group.factor->lanes.args(), b_.data());
    take(args_);
  }
}

/// b <- (A + D)^-1 b with the springs D of the effects (shell_effects.inl).
template <typename Real>
void ShellTissue<Real>::solve_with_springs() {
  shell_.start_springs(args_);
  for (int round = 0; round < kSpringRounds; ++round) {
    for (const KeyGroup& group : groups_) {
      std::copy_n(args_.effects.rest, b_.size(), b_.begin());
      args_.lanes = group.lanes;
      kernel_.solve_vectors(group.factor->lanes.args(), b_.data());
      shell_.take_answer(args_);
    }
    shell_.advance_springs(args_, round == 0);
  }
  shell_.load_solution(args_);
}

template <typename Real>
void ShellTissue<Real>::hold_for(std::uint32_t lanes) {
  args_.lanes = lanes;
  if (args_.lanes != 0) shell_.hold_patch(args_);
}

template <typename Real>
Vector3d ShellTissue<Real>::position(int lane, int particle) const {
  return {static_cast<double>(x_[index(particle, 0, lane)]),
          static_cast<double>(x_[index(particle, 1, lane)]),
          static_cast<double>(x_[index(particle, 2, lane)])};
}

template <typename Real>
Vector3d ShellTissue<Real>::velocity(int lane, int particle) const {
  return {static_cast<double>(v_[index(particle, 0, lane)]),
          static_cast<double>(v_[index(particle, 1, lane)]),
          static_cast<double>(v_[index(particle, 2, lane)])};
}

template <typename Real>
void ShellTissue<Real>::set_position(int lane, int particle, const Vector3d& p) {
  for (int axis = 0; axis < 3; ++axis) x_[index(particle, axis, lane)] = static_cast<Real>(p[axis]);
}

// The history of BDF2 becomes that of a node which has always moved so. A fixed node stays at rest.
template <typename Real>
void ShellTissue<Real>::set_velocity(int lane, int particle, const Vector3d& v) {
  const bool fixed = model_->body.fixed[static_cast<std::size_t>(particle)] != 0;
  for (int axis = 0; axis < 3; ++axis) {
    const std::size_t k = index(particle, axis, lane);
    v_[k] = fixed ? Real{0} : static_cast<Real>(v[axis]);
    if (!args_.second_order) continue;
    v_old_[k] = v_[k];
    d_old_[k] = static_cast<Real>(model_->substep()) * v_[k];
  }
}

template <typename Real>
void ShellTissue<Real>::find_nearest(std::span<const Vector3d> points,
                                     std::span<Nearest> nearest) const {
  find_nearest_in_lanes(kernel_, particles(), x_.data(), points, nearest);
}

template <typename Real>
bool ShellTissue<Real>::healthy(int lane) const {
  for (std::size_t k = static_cast<std::size_t>(lane); k < x_.size();
       k += static_cast<std::size_t>(lanes())) {
    if (!std::isfinite(x_[k]) || !std::isfinite(v_[k]) || !std::isfinite(contact_force_[k])) {
      return false;
    }
  }
  return true;
}

template <typename Real>
Vector3d ShellTissue<Real>::contact_force(int lane, int particle) const {
  return {static_cast<double>(contact_force_[index(particle, 0, lane)]),
          static_cast<double>(contact_force_[index(particle, 1, lane)]),
          static_cast<double>(contact_force_[index(particle, 2, lane)])};
}

template <typename Real>
std::vector<Vector3d> ShellTissue<Real>::elastic_gradient(int lane) {
  std::fill(d_.begin(), d_.end(), Real{0});
  args_.at_start = true;
  shell_.find_residual(args_);
  std::vector<Vector3d> gradient;
  for (int i = 0; i < particles(); ++i) {
    const auto p = static_cast<std::size_t>(i);
    Vector3d force = Vector3d::Zero();
    for (int axis = 0; axis < 3 && model_->body.fixed[p] == 0; ++axis) {
      const auto g = static_cast<std::size_t>(axis * lanes() + lane);
      const auto l = static_cast<std::size_t>(lane);
      const Real mass = args_.effects.density[l] *
                        (args_.effects.mass == nullptr
                             ? mass_[p]
                             : args_.effects.mass[p * static_cast<std::size_t>(lanes()) + l]);
      force[axis] = static_cast<double>(b_[index(i, axis, lane)]) +
                    static_cast<double>(contact_force_[index(i, axis, lane)]) +
                    static_cast<double>(mass * gravity_[g]);
    }
    gradient.push_back(force);
  }
  return gradient;
}

template class ShellTissue<float>;
template class ShellTissue<double>;

}  // namespace omentum
