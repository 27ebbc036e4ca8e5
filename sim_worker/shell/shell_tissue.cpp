// The elastic shell in lanes: construction, parameters and the step. Contact, grasp and saved
// states are in shell_contact.cpp, shell_grasp.cpp and shell_state.cpp.
#include "sim_worker/shell/shell_tissue.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/trig.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Rounds of conjugate gradients where tissue hangs on springs (effects adhesion and suction).
constexpr int kSpringRounds = 8;

}  // namespace

template <typename Real>
ShellTissue<Real>::ShellTissue(std::shared_ptr<const ShellTissueModel> model,
                               const LaneKernel<Real>& kernel)
    : Base(*model, kernel, model->effective_step(), model->parameters.integrator()),
      model_(std::move(model)),
      shell_(kernel_of<ShellKernel<Real>>(kernel.lanes)),
      effects_(model_, kernel.lanes) {
  const int W = lanes();
  const int n = particles();
  static_cast<ImplicitArgs<Real>&>(args_) = this->implicit_args();
  for (const double m : model_->structure.mass) mass_.push_back(static_cast<Real>(m));
  held_.resize(W);
  key_.assign(W, 0);
  keep_b_.assign(n, 3, W);
  args_.count_x = model_->count_x;
  args_.count_y = model_->count_y;
  args_.triangles = model_->triangles();
  args_.law = model_->law();
  if (model_->is_mesh()) load_mesh();
  load_stencils();
  args_.fixed = body_.fixed.data();
  args_.mass = mass_.data();
  args_.has_contact = model_->has_contact();
  args_.patch_tip = tip_.data();
  args_.patch_compliance = patch_compliance_.assign(1, 1, W);
  args_.patch_offset = patch_offset_.assign(kPatchRows, 3, W);
  args_.patch_inverse = patch_inverse_.assign(kPatchRows, kPatchRows, W);
  args_.patch_response = patch_response_.assign(n, kPatchRows, W);
  args_.patch_force = patch_force_.assign(kPatchRows, 3, W);
  make_room(1);
  prepare_contacts();
  for (int lane = 0; lane < W; ++lane) {
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
    lanes_of[key_[lane]] |= 1U << lane;
  }
  for (const auto& [key, mask] : lanes_of) groups_.push_back({&factor_of(key), mask});
}

template <typename Real>
void ShellTissue<Real>::set_parameters(int lane, const LaneParameters& parameters) {
  const EffectValues& effects = parameters.effects ? *parameters.effects : model_->effects;
  this->set_surroundings(lane, parameters, effects);
  this->set_material(lane, parameters, model_->material.damping_per_s());
  patch_compliance_[lane] = static_cast<Real>(effects.grasp_compliance);
  effects_.set(lane, effects, parameters.stiffness_scale);
  args_.effects = effects_.args();
  update_key(lane);
}

template <typename Real>
void ShellTissue<Real>::update_key(int lane) {
  key_[lane] = effects_.factor_key(lane);
  if (args_.has_contact) set_contact_stiffness(lane);
  group_lanes();
  if (held_[lane].radius > 0) make_patch(lane);
}

template <typename Real>
void ShellTissue<Real>::reset(int lane, const Vector3d& offset) {
  release(lane);
  this->place_at_rest(lane, offset);
  contact_force_.fill_lane(lane, Real{0});
  effects_.reset(lane, offset);
  update_key(lane);
}

template <typename Real>
void ShellTissue<Real>::begin_step(std::span<const ToolMotion> motion) {
  slip_grasps();
  if (args_.has_contact) find_contacts(motion);
}

template <typename Real>
void ShellTissue<Real>::begin_substep(std::span<const ToolMotion> motion, int substep) {
  const std::uint32_t changed = effects_.begin_substep();
  args_.effects = effects_.args();
  for (int lane = 0; lane < lanes(); ++lane) {
    if ((changed >> lane & 1U) != 0) update_key(lane);
  }
  this->place_tool(motion, substep);
  shell_.start_substep(args_);
}

template <typename Real>
void ShellTissue<Real>::solve_substep() {
  for (std::uint32_t iteration = 0; iteration < model_->parameters.iterations(); ++iteration) {
    args_.at_start = iteration == 0;
    iterate();
  }
}

template <typename Real>
void ShellTissue<Real>::end_substep(bool last) {
  shell_.remember_effects(args_);
  shell_.finish_substep(args_);
  for (int lane = 0; lane < lanes() && last; ++lane) {
    for (int axis = 0; axis < 3; ++axis) held_force_(0, axis, lane) = patch_force_(0, axis, lane);
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
  if ((held_lanes_ | jaw_lanes_) != 0) {
    patch_force_.fill(Real{0});
    for (Held& held : held_) {
      if (held.jaws) held.jaws->let_go();
    }
    hold_for(~0U);
  }
  if (args_.has_contact && !plane_shape_.empty()) resolve_contacts();
}

/// A^-1 b in the given lanes, one solve per distinct factor, and what is then done with it.
template <typename Real>
void ShellTissue<Real>::solve_for(std::uint32_t active, void (*take)(const ShellArgs<Real>&)) {
  const bool several = groups_.size() > 1;
  if (several) keep_b_ = b_;
  bool first = true;
  for (const KeyGroup& group : groups_) {
    args_.lanes = group.lanes & active;
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
      std::copy_n(args_.effects.rest, b_.size(), b_.data());
      args_.lanes = group.lanes;
      kernel_.solve_vectors(group.factor->lanes.args(), b_.data());
      shell_.take_response(args_);
    }
    shell_.advance_springs(args_, round == 0);
  }
  shell_.load_solution(args_);
}

template <typename Real>
void ShellTissue<Real>::hold_for(std::uint32_t active) {
  args_.lanes = active & held_lanes_;
  if (args_.lanes != 0) shell_.hold_patch(args_);
  for (int lane = 0; lane < lanes(); ++lane) {
    if (((active & jaw_lanes_) >> lane & 1U) != 0) hold_jaws(lane);
  }
}

template <typename Real>
std::vector<Vector3d> ShellTissue<Real>::elastic_gradient(int lane) {
  d_.fill(Real{0});
  args_.at_start = true;
  shell_.find_residual(args_);
  std::vector<Vector3d> gradient;
  for (int i = 0; i < particles(); ++i) {
    Vector3d force = Vector3d::Zero();
    Real mass = args_.effects.density[lane] *
                (args_.effects.mass == nullptr ? mass_[i] : args_.effects.mass[i * lanes() + lane]);
    if (args_.effects.added_mass != nullptr) mass += args_.effects.added_mass[i];
    for (int axis = 0; axis < 3 && !this->is_fixed(i); ++axis) {
      force[axis] = static_cast<double>(b_(i, axis, lane)) +
                    static_cast<double>(contact_force_(i, axis, lane)) +
                    static_cast<double>(mass * gravity_(0, axis, lane));
    }
    gradient.push_back(force);
  }
  return gradient;
}

template class ShellTissue<float>;
template class ShellTissue<double>;

}  // namespace omentum
