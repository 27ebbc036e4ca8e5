#include "sim_worker/solid_tissue.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "core/check.h"
#include "core/hash.h"
#include "sim_worker/kernel_shape.h"
#include "sim_worker/lane_kernels.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr int kMaxConjugateSteps = 40;
// Of the residual in the norm of the preconditioner, within a Newton step and over the substep:
// what is left is done by the next substep, which starts from it.
constexpr double kReduction = 0.01;
constexpr double kNewtonReduction = 1e-5;
constexpr int kMaxNewtonSteps = 16;
// Energy below which a residual is rounding, part of (weight x edge length).
constexpr double kRestEnergy = 1e-12;
// Contact answers a push with this many times the stiffness of the step at the node. Larger settles
// in fewer substeps and costs more conjugate steps.
constexpr double kContactGain = 10;
// A node that the jaw's spring holds this many times stiffer than the step does moves with the jaw.
constexpr double kRigidHold = 100;
constexpr double kLeastCover = 1e-3;
constexpr int kMaxHalvings = 4;
// Of parameters in a state, on the scene's: usable(LaneParameters); friction times 1 + 20 of the
// effect friction_change.
constexpr double kMaxGravityScale = 100;
constexpr double kMaxFrictionScale = 21e3;
constexpr double kRounding = 1e-5;  // of f32, several operations deep

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
  const double modulus = model.lambda + model.bulk + model.mu;
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
                               const Kernel<Real>& kernel)
    : model_(std::move(model)),
      kernel_(kernel),
      solid_(solid_kernel_for(kernel)),
      elastic_(elastic_kernel_for(kernel)) {
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
  rest_energy_ = static_cast<Real>(
      std::max(kRestEnergy * weight * model_->spacing, rounding_energy<Real>(*model_)));
  panel_value_ = convert<Real>(model_->factor.panel_value);

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
  args_.mu = static_cast<Real>(model_->mu);
  args_.lambda = static_cast<Real>(model_->lambda);
  args_.alpha = static_cast<Real>(model_->alpha);
  args_.bulk = static_cast<Real>(model_->bulk);
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

  if (model_->by_component) {
    args_.panel = model_->factor.panels.data();
    args_.panels = static_cast<std::int32_t>(model_->factor.panels.size());
    args_.panel_row = model_->factor.panel_node.data();
    args_.panel_value = panel_value_.data();
  }
  factor_args_.b = z_.data();
  factor_args_.panel = model_->factor.panels.data();
  factor_args_.panels = static_cast<std::int32_t>(model_->factor.panels.size());
  factor_args_.panel_node = model_->factor.panel_node.data();
  factor_args_.panel_value = panel_value_.data();

  // The search for candidates is the cluster kernel's; it reads no more than this.
  candidate_args_.particles = model_->nodes();
  candidate_args_.x = x_.data();
  candidate_args_.v = v_.data();
  candidate_args_.free_mask = contact_mask_.data();
  candidate_args_.candidates = candidates_.data();
  candidate_args_.candidate_any = candidate_any_.data();
  candidate_args_.gravity = gravity_.data();
  candidate_args_.particle_radius = args_.particle_radius;
  candidate_args_.step_s = static_cast<Real>(model_->control_period);
  // 2 mm beyond what speed and gravity explain: elastic motion of one control step.
  candidate_args_.margin = static_cast<Real>(2e-3);
  for (const RigidShape& body : model_->contact_bodies) {
    candidate_args_.shape[candidate_args_.shapes++] = make_kernel_shape<Real>(body);
  }
  if (model_->tool_contact) {
    candidate_args_.shape[candidate_args_.shapes++] =
        make_tool_shape<Real>(model_->tool_radius, model_->tool_length, model_->shaft_axis);
  }
  candidate_args_.capsule = capsule_.data();
  candidate_args_.capsule_sweep = capsule_sweep_.data();
  args_.shapes = candidate_args_.shapes;
  args_.shape = candidate_args_.shape;

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
  const EffectValues& effects = parameters.effects ? *parameters.effects : model_->effects;
  stiffness_[l] = static_cast<Real>(parameters.stiffness_scale);
  const double damping = model_->material.damping_per_s() * parameters.damping_scale;
  keep_[l] = static_cast<Real>(decay(damping * model_->effective_step()));
  const Vector3d gravity = tilted_gravity(effects, model_->gravity);
  for (int axis = 0; axis < 3; ++axis) {
    gravity_[index(0, axis, lane)] = static_cast<Real>(gravity[axis] * parameters.gravity_scale);
  }
  const double friction = parameters.friction_scale * (1 + effects.friction_change);
  static_friction_[l] = static_cast<Real>(model_->static_friction * friction);
  dynamic_friction_[l] = static_cast<Real>(model_->dynamic_friction * friction);
}

template <typename Real>
void SolidTissue<Real>::reset(int lane, const Vector3d& offset) {
  release(lane);
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
  find_contacts(motion);
}

template <typename Real>
void SolidTissue<Real>::start_substep(std::span<const ToolMotion> motion, int substep) {
  place_tool(motion, substep);
  solid_.start_substep(args_);
  enough_.fill(Real{-1});
}

template <typename Real>
void SolidTissue<Real>::finish_substep(bool last) {
  if (last) {
    solid_.find_reaction(args_, hp_.data());
    for (int lane = 0; lane < lanes(); ++lane) {
      for (int axis = 0; axis < 3; ++axis) {
        Real held_sum = 0;
        for (const std::int32_t i : held_[static_cast<std::size_t>(lane)].nodes) {
          held_sum += hp_[index(i, axis, lane)];
        }
        held_force_[index(0, axis, lane)] = held_sum;
      }
    }
  }
  solid_.finish_substep(args_);
}

// Candidates of the whole step, once; forces of nodes that cannot touch any more are dropped.
template <typename Real>
void SolidTissue<Real>::find_contacts(std::span<const ToolMotion> motion) {
  for (int lane = 0; lane < lanes(); ++lane) {
    const ToolMotion& m = motion[static_cast<std::size_t>(lane)];
    const Vector3d base = m.from + model_->tool_start * model_->shaft_axis;
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
void SolidTissue<Real>::place_tool(std::span<const ToolMotion> motion, int substep) {
  const auto substeps = static_cast<int>(model_->parameters.substeps());
  const double share = (substep + 1.0) / substeps;
  for (int lane = 0; lane < lanes(); ++lane) {
    const ToolMotion& m = motion[static_cast<std::size_t>(lane)];
    const Vector3d tip = m.from + share * (m.to - m.from);
    const Vector3d base = tip + model_->tool_start * model_->shaft_axis;
    const Held& held = held_[static_cast<std::size_t>(lane)];
    for (int axis = 0; axis < 3; ++axis) {
      capsule_[index(0, axis, lane)] = static_cast<Real>(base[axis]);
      capsule_motion_[index(0, axis, lane)] =
          static_cast<Real>((m.to[axis] - m.from[axis]) / substeps);
      for (std::size_t k = 0; k < held.nodes.size(); ++k) {
        hold_target_[index(held.nodes[k], axis, lane)] =
            static_cast<Real>(tip[axis]) + held.offsets[k][static_cast<std::size_t>(axis)];
      }
    }
  }
}

/// z = A^-1 b on the free nodes.
template <typename Real>
void SolidTissue<Real>::precondition() {
  z_ = b_;
  if (model_->by_component) {
    solid_.solve_components(args_, z_.data());
  } else {
    elastic_.solve(factor_args_);
  }
  solid_.keep_free(args_, z_.data());
}

/// b, z = A^-1 b and their product, the square of the residual in the norm of the preconditioner.
template <typename Real>
void SolidTissue<Real>::find_residual(PerLane& size) {
  solid_.find_residual(args_);
  precondition();
  solid_.dot(args_, b_.data(), z_.data(), size.data());
}

// Newton steps until the residual is small, in every lane on its own; a step that makes it larger
// is halved. Most substeps take two, an impact ten. What is small is settled by the first call in a
// substep.
template <typename Real>
void SolidTissue<Real>::solve_substep(std::uint32_t active) {
  const auto W = static_cast<std::size_t>(lanes());
  PerLane size{};
  PerLane size_new{};
  PerLane share{};
  find_residual(size);
  for (std::size_t l = 0; l < W; ++l) {
    if (enough_[l] >= Real{0}) continue;
    enough_[l] =
        std::max(static_cast<Real>(kNewtonReduction * kNewtonReduction) * size[l], rest_energy_);
  }
  for (int k = 0; k < kMaxNewtonSteps; ++k) {
    std::uint32_t moves = 0;
    for (std::size_t l = 0; l < W; ++l) {
      if (size[l] > enough_[l]) moves |= active & 1U << l;
    }
    if (moves == 0) return;
    find_newton_step(size, moves);
    share.fill(Real{-1});
    std::uint32_t worse = moves;
    for (int halving = 0; worse != 0 && halving <= kMaxHalvings; ++halving) {
      solid_.add_scaled(args_, d_.data(), step_.data(), share.data(), worse);
      find_residual(size_new);
      for (std::size_t l = 0; l < W; ++l) {
        // Written so that a residual that is no number counts as worse.
        if (size_new[l] <= size[l]) worse &= ~(1U << l);
      }
      share.fill(halving == 0 ? Real{0.5} : share[0] / 2);
    }
    size = size_new;
  }
}

template <typename Real>
void SolidTissue<Real>::set_load(const Real* load) {
  args_.load = load;
}

template <typename Real>
void SolidTissue<Real>::answer(const Real* push, Real* work) {
  std::copy_n(push, b_.size(), b_.begin());
  solid_.keep_free(args_, b_.data());
  precondition();
  step_ = z_;
  PerLane product{};
  solid_.dot(args_, push, step_.data(), product.data());
  std::copy_n(product.begin(), lanes(), work);
}

template <typename Real>
void SolidTissue<Real>::take_answer(const Real* share, std::uint32_t active) {
  solid_.add_scaled(args_, d_.data(), step_.data(), share, active);
}

// step = H^-1 b by conjugate gradients, from the residual b with z = A^-1 b and its square `rz`. A
// lane takes part until its residual is small or its Hessian not positive along the direction; what
// the others do then leaves its bits alone.
template <typename Real>
void SolidTissue<Real>::find_newton_step(PerLane rz, std::uint32_t active) {
  const auto W = static_cast<std::size_t>(lanes());
  PerLane rz_new{};
  PerLane php{};
  PerLane factor{};
  PerLane enough{};
  for (std::size_t l = 0; l < W; ++l) {
    enough[l] = static_cast<Real>(kReduction * kReduction) * rz[l];
  }
  p_ = z_;
  std::fill(step_.begin(), step_.end(), Real{0});
  for (int k = 0; k < kMaxConjugateSteps && active != 0; ++k) {
    solid_.multiply_hessian(args_);
    solid_.dot(args_, p_.data(), hp_.data(), php.data());
    std::uint32_t moves = 0;
    for (std::size_t l = 0; l < W; ++l) {
      factor[l] = Real{0};
      if ((active >> l & 1U) == 0) continue;
      if (php[l] > Real{0}) {
        factor[l] = rz[l] / php[l];
      } else {
        active &= ~(1U << l);
        if (k > 0) continue;
        factor[l] = Real{1};  // a step of the preconditioner alone goes downhill
      }
      moves |= 1U << l;
    }
    solid_.add_scaled(args_, step_.data(), p_.data(), factor.data(), moves);
    for (Real& f : factor) f = -f;
    solid_.add_scaled(args_, b_.data(), hp_.data(), factor.data(), moves);
    precondition();
    solid_.dot(args_, b_.data(), z_.data(), rz_new.data());
    for (std::size_t l = 0; l < W; ++l) {
      factor[l] = (active >> l & 1U) != 0 ? rz_new[l] / rz[l] : Real{0};
      rz[l] = rz_new[l];
      if (!(rz[l] > enough[l])) active &= ~(1U << l);
    }
    solid_.turn_direction(args_, factor.data());
  }
}

template <typename Real>
void SolidTissue<Real>::hold(int lane, const Vector3d& tip, double radius, bool collapse) {
  release(lane);
  Held& held = held_[static_cast<std::size_t>(lane)];
  for (int i = 0; i < particles(); ++i) {
    if (model_->body.fixed[static_cast<std::size_t>(i)] != 0) continue;
    const Vector3d offset = position(lane, i) - tip;
    const double covered = (radius - offset.norm()) / model_->spacing + 0.5;
    if (!(covered > kLeastCover)) continue;
    const Vector3d kept = collapse ? Vector3d::Zero() : offset;
    held.nodes.push_back(i);
    held.offsets.push_back(
        {static_cast<Real>(kept.x()), static_cast<Real>(kept.y()), static_cast<Real>(kept.z())});
    held.weights.push_back(static_cast<Real>(std::min(1.0, covered)));
  }
  apply_hold(lane);
}

/// Masks and springs of a grasp. A node that the jaw covers by the part w hangs on a spring of E x
/// spacing x w / (1 - w): the grasp moves smoothly with the pinch point (tissue.md section 8).
template <typename Real>
void SolidTissue<Real>::apply_hold(int lane) {
  const Held& held = held_[static_cast<std::size_t>(lane)];
  const std::uint32_t bit = 1U << lane;
  for (std::size_t k = 0; k < held.nodes.size(); ++k) {
    const auto i = static_cast<std::size_t>(held.nodes[k]);
    const auto w = static_cast<double>(held.weights[k]);
    const double spring = model_->material.young_modulus_pa() * model_->spacing * w;
    contact_mask_[i] &= ~bit;
    if (spring >= kRigidHold * model_->diagonal[i] * (1 - w)) {
      free_mask_[i] &= ~bit;
    } else {
      hold_stiffness_[i * static_cast<std::size_t>(lanes()) + static_cast<std::size_t>(lane)] =
          static_cast<Real>(spring / (1 - w));
    }
  }
}

template <typename Real>
void SolidTissue<Real>::release(int lane) {
  Held& held = held_[static_cast<std::size_t>(lane)];
  const std::uint32_t bit = 1U << lane;
  for (const std::int32_t node : held.nodes) {
    const auto i = static_cast<std::size_t>(node);
    free_mask_[i] |= bit;
    if (model_->on_surface[i] != 0) contact_mask_[i] |= bit;
    hold_stiffness_[i * static_cast<std::size_t>(lanes()) + static_cast<std::size_t>(lane)] =
        Real{0};
    for (int axis = 0; axis < 3; ++axis) contact_force_[index(node, axis, lane)] = Real{0};
  }
  held = {};
}

template <typename Real>
void SolidTissue<Real>::shift_held(int lane, const Vector3d& by) {
  for (auto& offset : held_[static_cast<std::size_t>(lane)].offsets) {
    for (int axis = 0; axis < 3; ++axis) {
      offset[static_cast<std::size_t>(axis)] += static_cast<Real>(by[axis]);
    }
  }
}

template <typename Real>
Vector3d SolidTissue<Real>::held_force(int lane) const {
  if (held(lane).empty()) return Vector3d::Zero();
  return {static_cast<double>(held_force_[index(0, 0, lane)]),
          static_cast<double>(held_force_[index(0, 1, lane)]),
          static_cast<double>(held_force_[index(0, 2, lane)])};
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
  Vector3d sum = Vector3d::Zero();
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
  for (int i = 0; i < particles(); ++i) {
    const auto p = static_cast<std::size_t>(i);
    Vector3d force = Vector3d::Zero();
    for (int axis = 0; axis < 3 && model_->body.fixed[p] == 0; ++axis) {
      // Without the inertia of v and the weight.
      const Real inertia = mass_over_step2_[p] * args_.effective_step * v_[index(i, axis, lane)];
      const Real weight = mass_[p] * gravity_[index(0, axis, lane)];
      force[axis] = static_cast<double>(b_[index(i, axis, lane)] + inertia + weight);
    }
    gradient.push_back(force);
  }
  return gradient;
}

// State of a lane: positions, velocities, history of BDF2, contact forces, force on the tool, the
// lane parameters, then the grasp.
template <typename Real>
void SolidTissue<Real>::save(int lane, Bytes& out) const {
  const auto add = [&out](const void* data, std::size_t size) {
    const auto* bytes = static_cast<const std::byte*>(data);
    out.insert(out.end(), bytes, bytes + size);
  };
  for (const auto* values : {&x_, &v_, &v_old_, &d_old_, &contact_force_, &held_force_, &stiffness_,
                             &gravity_, &keep_, &static_friction_, &dynamic_friction_}) {
    for (std::size_t k = static_cast<std::size_t>(lane); k < values->size();
         k += static_cast<std::size_t>(lanes())) {
      add(&(*values)[k], sizeof(Real));
    }
  }
  const Held& held = held_[static_cast<std::size_t>(lane)];
  const auto count = static_cast<std::uint32_t>(held.nodes.size());
  add(&count, sizeof count);
  add(held.nodes.data(), count * sizeof(std::int32_t));
  add(held.offsets.data(), count * sizeof(held.offsets[0]));
  add(held.weights.data(), count * sizeof(Real));
}

/// Whether stiffness, gravity [3], keep, static and dynamic friction are what set_parameters()
/// makes of some usable LaneParameters.
template <typename Real>
bool SolidTissue<Real>::usable_parameters(std::span<const Real> values) const {
  const auto value = [&](std::size_t k) { return static_cast<double>(values[k]); };
  LaneParameters scales;
  scales.stiffness_scale = value(0);
  const double pull = Vector3d(value(1), value(2), value(3)).norm();
  const auto rubs = [](double friction, double nominal) {
    return friction >= 0 && friction <= nominal * kMaxFrictionScale * (1 + kRounding);
  };
  return usable(scales) && pull <= kMaxGravityScale * model_->gravity.norm() * (1 + kRounding) &&
         value(4) >= 0 && value(4) <= 1 && rubs(value(5), model_->static_friction) &&
         rubs(value(6), model_->dynamic_friction);
}

template <typename Real>
Result<std::size_t> SolidTissue<Real>::load(int lane, std::span<const std::byte> state) {
  const std::array<AlignedVector<Real>*, 11> arrays = {
      &x_,         &v_,       &v_old_, &d_old_,           &contact_force_,   &held_force_,
      &stiffness_, &gravity_, &keep_,  &static_friction_, &dynamic_friction_};
  std::size_t reals = 0;
  for (const auto* a : arrays) reals += a->size() / static_cast<std::size_t>(lanes());
  std::uint32_t count = 0;
  const std::size_t fixed_size = reals * sizeof(Real) + sizeof count;
  if (state.size() < fixed_size) {
    return Failure{
        fmt::format("tissue state of {} bytes, needed at least {}", state.size(), fixed_size)};
  }
  std::vector<Real> values(reals);
  std::memcpy(values.data(), state.data(), reals * sizeof(Real));
  std::memcpy(&count, state.data() + fixed_size - sizeof count, sizeof count);
  Held held;
  const std::size_t entry = sizeof(std::int32_t) + sizeof(held.offsets[0]) + sizeof(Real);
  if (count > static_cast<std::uint32_t>(particles()) ||
      state.size() < fixed_size + count * entry) {
    return Failure{fmt::format("tissue state of {} bytes with {} held nodes of {}", state.size(),
                               count, particles())};
  }
  for (const Real v : values) {
    if (!std::isfinite(v)) return Failure{"tissue state holds a non-finite number"};
  }
  // The last numbers: stiffness, gravity [3], keep, static and dynamic friction.
  if (!usable_parameters(std::span(values).last(7))) {
    return Failure{"tissue state holds lane parameters out of range"};
  }
  held.nodes.resize(count);
  held.offsets.resize(count);
  held.weights.resize(count);
  if (count > 0) {  // memcpy must not get the null pointer of an empty vector
    const std::byte* at = state.data() + fixed_size;
    std::memcpy(held.nodes.data(), at, count * sizeof(std::int32_t));
    at += count * sizeof(std::int32_t);
    std::memcpy(held.offsets.data(), at, count * sizeof(held.offsets[0]));
    at += count * sizeof(held.offsets[0]);
    std::memcpy(held.weights.data(), at, count * sizeof(Real));
  }
  for (std::size_t k = 0; k < count; ++k) {
    const std::int32_t i = held.nodes[k];
    const auto& offset = held.offsets[k];
    if (i < 0 || i >= particles() || model_->body.fixed[static_cast<std::size_t>(i)] != 0 ||
        (k > 0 && i <= held.nodes[k - 1])) {
      return Failure{fmt::format(
          "tissue state holds node {}, not a free one of {} in ascending order", i, particles())};
    }
    if (!(held.weights[k] > Real{0} && held.weights[k] <= Real{1}) || !std::isfinite(offset[0]) ||
        !std::isfinite(offset[1]) || !std::isfinite(offset[2])) {
      return Failure{fmt::format("tissue state holds node {} with a bad weight or offset", i)};
    }
  }

  release(lane);
  std::size_t next = 0;
  for (auto* a : arrays) {
    for (std::size_t k = static_cast<std::size_t>(lane); k < a->size();
         k += static_cast<std::size_t>(lanes())) {
      (*a)[k] = values[next++];
    }
  }
  for (int i = 0; i < particles(); ++i) {
    if (model_->body.fixed[static_cast<std::size_t>(i)] != 0)
      set_position(lane, i, position(lane, i));
  }
  held_[static_cast<std::size_t>(lane)] = std::move(held);
  apply_hold(lane);
  return fixed_size + count * entry;
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
