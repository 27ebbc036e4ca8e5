#include "sim_worker/solid/solid_tissue.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "core/hash.h"
#include "sim_worker/tissue/kernel_shape.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Energy below which a residual is rounding, part of (weight x edge length).
constexpr double kRestEnergy = 1e-12;
// Contact answers a push with this many times the stiffness of the step at the node. Larger settles
// in fewer substeps and costs more conjugate steps.
constexpr double kContactGain = 10;

template <typename Real>
std::vector<Real> convert(const std::vector<double>& values) {
  std::vector<Real> result;
  result.reserve(values.size());
  for (const double v : values) result.push_back(static_cast<Real>(v));
  return result;
}

/// What rounding of the positions leaves of a residual, in the norm of the preconditioner [J]: each
/// strain is wrong by (place x epsilon / spacing), its stress acts on the square of the spacing.
template <typename Real>
double rounding_energy(const SolidTissueModel& model) {
  const double modulus = model.law.lambda + model.law.bulk + model.law.mu;
  double energy = 0;
  for (std::size_t i = 0; i < model.mass.size(); ++i) {
    const double place = (model.body.X_WB * model.body.particles[i]).cwiseAbs().maxCoeff();
    const double force =
        modulus * model.spacing * place * static_cast<double>(std::numeric_limits<Real>::epsilon());
    energy += force * force / model.diagonal[i];
  }
  return energy;
}

}  // namespace

template <typename Real>
SolidTissue<Real>::SolidTissue(std::shared_ptr<const SolidTissueModel> model,
                               const LaneKernel<Real>& kernel)
    : model_(std::move(model)),
      kernel_(kernel),
      solid_(kernel_of<SolidKernel<Real>>(kernel.lanes)),
      effects_(model_, kernel.lanes) {
  OMENTUM_CHECK(solid_.lanes == kernel_.lanes);
  const auto W = static_cast<std::size_t>(kernel_.lanes);
  const auto n = static_cast<std::size_t>(model_->nodes());
  const double step = model_->effective_step();
  const bool second_order = model_->parameters.integrator() == pb::INTEGRATOR_BDF2;

  for (const auto& t : model_->mesh.tetrahedra) {
    tetrahedron_.insert(tetrahedron_.end(), t.begin(), t.end());
  }
  gradient_ = convert<Real>(model_->gradient);
  for (const double v : model_->volume) volume_.push_back(static_cast<Real>(v / 4));
  mass_ = convert<Real>(model_->mass);
  for (const double m : model_->mass) {
    mass_over_step2_.push_back(static_cast<Real>(m / (step * step)));
  }
  for (const double k : model_->diagonal) {
    contact_gain_.push_back(static_cast<Real>(kContactGain * k));
  }
  double weight = 0;
  for (const double m : model_->mass) weight += m * 9.8;  // a scale, whatever the scene's gravity
  model_rest_energy_ =
      std::max(kRestEnergy * weight * model_->spacing, rounding_energy<Real>(*model_));
  factor_ = LaneFactor<Real>(model_->factor);

  for (auto* v : {&x_, &v_, &d_, &moved_, &b_, &step_, &z_, &p_, &hp_, &contact_force_,
                  &contact_next_, &contact_normal_, &hold_target_}) {
    v->assign(3 * n * W, Real{0});
  }
  if (second_order) {
    v_old_.assign(3 * n * W, Real{0});
    d_old_.assign(3 * n * W, Real{0});
  }
  hold_stiffness_.assign(n * W, Real{0});
  contact_slide_.assign(n * W, Real{0});
  for (auto* mask : {&touches_, &free_mask_, &contact_mask_, &candidate_any_}) {
    mask->assign(n, 0);
  }
  candidates_.assign(n * kMaxShapes, 0);
  held_.resize(W);
  for (auto* v : {&stiffness_, &keep_, &static_friction_, &dynamic_friction_, &capsule_sweep_}) {
    v->assign(W, Real{0});
  }
  for (auto* v : {&gravity_, &capsule_, &capsule_motion_, &held_force_}) v->assign(3 * W, Real{0});

  args_.nodes = model_->nodes();
  args_.tetrahedra = static_cast<std::int32_t>(model_->mesh.tetrahedra.size());
  args_.tetrahedron = tetrahedron_.data();
  args_.gradient = gradient_.data();
  args_.volume = volume_.data();
  args_.mass = mass_.data();
  args_.mass_over_step2 = mass_over_step2_.data();
  args_.contact_gain = contact_gain_.data();
  args_.second_order = second_order;
  args_.effective_step = static_cast<Real>(step);
  args_.inverse_step = static_cast<Real>(1 / step);
  args_.third = static_cast<Real>(1.0 / 3);
  args_.x = x_.data();
  args_.v = v_.data();
  args_.v_old = v_old_.data();
  args_.d_old = d_old_.data();
  args_.d = d_.data();
  args_.moved = moved_.data();
  args_.b = b_.data();
  args_.step = step_.data();
  args_.z = z_.data();
  args_.p = p_.data();
  args_.hp = hp_.data();
  args_.contact_force = contact_force_.data();
  args_.contact_next = contact_next_.data();
  args_.contact_normal = contact_normal_.data();
  args_.contact_slide = contact_slide_.data();
  args_.touches = touches_.data();
  args_.free_mask = free_mask_.data();
  args_.hold_stiffness = hold_stiffness_.data();
  args_.hold_target = hold_target_.data();
  args_.load = nullptr;
  args_.stiffness = stiffness_.data();
  args_.gravity = gravity_.data();
  args_.keep = keep_.data();
  args_.candidates = candidates_.data();
  args_.candidate_any = candidate_any_.data();
  args_.particle_radius = static_cast<Real>(model_->body.particle_radius);
  args_.capsule = capsule_.data();
  args_.capsule_motion = capsule_motion_.data();
  args_.static_friction = static_friction_.data();
  args_.dynamic_friction = dynamic_friction_.data();

  shapes_ = make_kernel_shapes<Real>(model_->surroundings);
  // 2 mm beyond what speed and gravity explain: elastic motion of one control step.
  candidate_args_ = {model_->nodes(),
                     x_.data(),
                     v_.data(),
                     contact_mask_.data(),
                     gravity_.data(),
                     args_.particle_radius,
                     static_cast<Real>(model_->control_period),
                     static_cast<Real>(2e-3),
                     shapes_.count,
                     shapes_.shape.data(),
                     capsule_.data(),
                     capsule_sweep_.data(),
                     candidates_.data(),
                     candidate_any_.data()};
  args_.shapes = candidate_args_.shapes;
  args_.shape = shapes_.shape.data();

  for (int lane = 0; lane < lanes(); ++lane) {
    set_parameters(lane, {});
    reset(lane, Vector3d::Zero());
  }
}

template <typename Real>
void SolidTissue<Real>::set_parameters(int lane, const LaneParameters& parameters) {
  OMENTUM_CHECK(usable(parameters), "stiffness {}, gravity {}, damping {}, friction {}",
                parameters.stiffness_scale, parameters.gravity_scale, parameters.damping_scale,
                parameters.friction_scale);
  const auto l = static_cast<std::size_t>(lane);
  const EffectValues effects =
      model_->own_effects(parameters.effects ? *parameters.effects : model_->effects);
  set_effects(lane, effects);
  stiffness_[l] = static_cast<Real>(parameters.stiffness_scale);
  const double damping = model_->material.damping_per_s() * parameters.damping_scale;
  keep_[l] = static_cast<Real>(decay(damping * model_->effective_step()));
  const Vector3d gravity = tilted_gravity(effects, model_->surroundings.gravity);
  for (int axis = 0; axis < 3; ++axis) {
    gravity_[index(0, axis, lane)] = static_cast<Real>(gravity[axis] * parameters.gravity_scale);
  }
  const double friction = parameters.friction_scale * (1 + effects.friction_change);
  static_friction_[l] = static_cast<Real>(model_->surroundings.static_friction * friction);
  dynamic_friction_[l] = static_cast<Real>(model_->surroundings.dynamic_friction * friction);
}

template <typename Real>
void SolidTissue<Real>::set_effects(int lane, const EffectValues& effects) {
  const double compliance = effects_.values(lane).grasp_compliance;
  effects_.set(lane, effects);
  args_.effects = effects_.args();
  const double stiffer = effects_.stiffer(lane);
  rest_energy_[static_cast<std::size_t>(lane)] =
      static_cast<Real>(model_rest_energy_ * stiffer * stiffer);
  if (effects.grasp_compliance != compliance) apply_hold(lane);
}

template <typename Real>
void SolidTissue<Real>::reset(int lane, const Vector3d& offset) {
  release(lane);
  effects_.reset(lane, offset);
  const std::uint32_t bit = 1U << lane;
  for (int i = 0; i < particles(); ++i) {
    const auto p = static_cast<std::size_t>(i);
    set_position(lane, i, model_->body.X_WB * model_->body.particles[p] + offset);
    set_velocity(lane, i, Vector3d::Zero());
    for (int axis = 0; axis < 3; ++axis) {
      contact_force_[index(i, axis, lane)] = Real{0};
      // A fixed node is held where it is.
      hold_target_[index(i, axis, lane)] = x_[index(i, axis, lane)];
    }
    if (model_->body.fixed[p] != 0) continue;
    free_mask_[p] |= bit;
    if (model_->on_surface[p] != 0) contact_mask_[p] |= bit;
  }
  for (int axis = 0; axis < 3; ++axis) held_force_[index(0, axis, lane)] = Real{0};
}

// One control step. The tool moves on a straight line over the substeps.
template <typename Real>
void SolidTissue<Real>::step(std::span<const ToolMotion> motion) {
  const auto substeps = static_cast<int>(model_->parameters.substeps());
  start_step(motion);
  for (int substep = 0; substep < substeps; ++substep) {
    start_substep(motion, substep);
    solve_substep(~0U);
    finish_substep(substep + 1 == substeps);
  }
}

template <typename Real>
void SolidTissue<Real>::start_step(std::span<const ToolMotion> motion) {
  OMENTUM_CHECK(static_cast<int>(motion.size()) == lanes());
  slip_grasps();
  find_contacts(motion);
}

template <typename Real>
void SolidTissue<Real>::start_substep(std::span<const ToolMotion> motion, int substep) {
  place_tool(motion, substep);
  solid_.start_substep(args_);
  start_giving();
  if (effects_.on_nodes()) solid_.start_effects(args_);
  enough_.fill(Real{-1});
}

template <typename Real>
void SolidTissue<Real>::finish_substep(bool last) {
  if (last) {
    solid_.find_reaction(args_, hp_.data());
    find_held_force();
  }
  finish_giving();
  if (effects_.remembers()) solid_.remember_effects(args_);
  solid_.finish_substep(args_);
}

// Candidates of the whole step, once; forces of nodes that cannot touch any more are dropped.
template <typename Real>
void SolidTissue<Real>::find_contacts(std::span<const ToolMotion> motion) {
  for (int lane = 0; lane < lanes(); ++lane) {
    const ToolMotion& m = motion[static_cast<std::size_t>(lane)];
    const Vector3d base = model_->surroundings.capsule_at(m.from);
    for (int axis = 0; axis < 3; ++axis) {
      capsule_[index(0, axis, lane)] = static_cast<Real>(base[axis]);
    }
    capsule_sweep_[static_cast<std::size_t>(lane)] = static_cast<Real>((m.to - m.from).norm());
  }
  kernel_.find_candidates(candidate_args_);
  contact_node_.clear();
  for (int i = 0; i < particles(); ++i) {
    if (candidate_any_[static_cast<std::size_t>(i)] != 0) {
      contact_node_.push_back(i);
      continue;
    }
    const auto begin = contact_force_.begin() + static_cast<std::ptrdiff_t>(index(i, 0, 0));
    std::fill_n(begin, 3 * lanes(), Real{0});
  }
  args_.contacts = static_cast<std::int32_t>(contact_node_.size());
  args_.contact_node = contact_node_.data();
}

template <typename Real>
void SolidTissue<Real>::set_load(const Real* load) {
  args_.load = load;
}

template <typename Real>
Vector3d SolidTissue<Real>::position(int lane, int particle) const {
  return {static_cast<double>(x_[index(particle, 0, lane)]),
          static_cast<double>(x_[index(particle, 1, lane)]),
          static_cast<double>(x_[index(particle, 2, lane)])};
}

template <typename Real>
Vector3d SolidTissue<Real>::velocity(int lane, int particle) const {
  return {static_cast<double>(v_[index(particle, 0, lane)]),
          static_cast<double>(v_[index(particle, 1, lane)]),
          static_cast<double>(v_[index(particle, 2, lane)])};
}

template <typename Real>
void SolidTissue<Real>::set_position(int lane, int particle, const Vector3d& p) {
  const bool fixed = model_->body.fixed[static_cast<std::size_t>(particle)] != 0;
  for (int axis = 0; axis < 3; ++axis) {
    x_[index(particle, axis, lane)] = static_cast<Real>(p[axis]);
    if (fixed) hold_target_[index(particle, axis, lane)] = static_cast<Real>(p[axis]);
  }
}

// The history of BDF2 becomes that of a node which has always moved so. A fixed node stays at rest.
template <typename Real>
void SolidTissue<Real>::set_velocity(int lane, int particle, const Vector3d& v) {
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
void SolidTissue<Real>::find_nearest(std::span<const Vector3d> points,
                                     std::span<Nearest> nearest) const {
  find_nearest_in_lanes(kernel_, particles(), x_.data(), points, nearest);
}

template <typename Real>
bool SolidTissue<Real>::healthy(int lane) const {
  for (std::size_t k = static_cast<std::size_t>(lane); k < x_.size();
       k += static_cast<std::size_t>(lanes())) {
    if (!std::isfinite(x_[k]) || !std::isfinite(v_[k]) || !std::isfinite(contact_force_[k])) {
      return false;
    }
  }
  return true;
}

template <typename Real>
Vector3d SolidTissue<Real>::contact_force(int lane, int particle) const {
  return {static_cast<double>(contact_force_[index(particle, 0, lane)]),
          static_cast<double>(contact_force_[index(particle, 1, lane)]),
          static_cast<double>(contact_force_[index(particle, 2, lane)])};
}

template <typename Real>
Vector3d SolidTissue<Real>::anchor_force(int lane) const {
  Vector3d sum = effects_.anchor_force(lane, x_.data());
  for (int i = 0; i < particles(); ++i) {
    if (model_->body.fixed[static_cast<std::size_t>(i)] == 0) continue;
    for (int axis = 0; axis < 3; ++axis) {
      sum[axis] += static_cast<double>(hp_[index(i, axis, lane)]);
    }
  }
  return sum;
}

template <typename Real>
std::vector<Vector3d> SolidTissue<Real>::elastic_gradient(int lane) {
  std::vector<Vector3d> gradient;
  std::fill(d_.begin(), d_.end(), Real{0});
  solid_.find_residual(args_);
  const Real density = args_.effects.density[lane];
  for (int i = 0; i < particles(); ++i) {
    const auto p = static_cast<std::size_t>(i);
    Vector3d force = Vector3d::Zero();
    for (int axis = 0; axis < 3; ++axis) {
      // Without the inertia of v and the weight.
      const Real inertia =
          density * mass_over_step2_[p] * args_.effective_step * v_[index(i, axis, lane)];
      const Real weight = density * mass_[p] * gravity_[index(0, axis, lane)];
      force[axis] = static_cast<double>(b_[index(i, axis, lane)] + inertia + weight);
    }
    gradient.push_back(force);
  }
  return gradient;
}

template <typename Real>
std::vector<Vector3d> SolidTissue<Real>::elastic_change(int lane,
                                                        std::span<const Vector3d> direction) {
  for (int i = 0; i < particles(); ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      p_[index(i, axis, lane)] = static_cast<Real>(direction[static_cast<std::size_t>(i)][axis]);
    }
  }
  elastic_gradient(lane);  // places the nodes
  solid_.multiply_hessian(args_);
  std::vector<Vector3d> change;
  const Real density = args_.effects.density[lane];
  for (int i = 0; i < particles(); ++i) {
    const Real inertia = density * mass_over_step2_[static_cast<std::size_t>(i)];
    Vector3d force = Vector3d::Zero();
    for (int axis = 0; axis < 3; ++axis) {
      const std::size_t k = index(i, axis, lane);
      force[axis] = static_cast<double>(hp_[k] - inertia * p_[k]);
    }
    change.push_back(force);
  }
  return change;
}

template <typename Real>
std::uint64_t SolidTissue<Real>::hash(int lane) const {
  Bytes bytes;
  save(lane, bytes);
  return fnv1a64(bytes);
}

template class SolidTissue<float>;
template class SolidTissue<double>;

}  // namespace omentum
