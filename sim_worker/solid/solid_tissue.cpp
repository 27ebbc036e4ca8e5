#include "sim_worker/solid/solid_tissue.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "core/trig.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Energy below which a residual is rounding, part of (weight x edge length).
constexpr double kRestEnergy = 1e-12;
// Stiffness of contact over that of the step at the node. Larger settles in fewer substeps and
// costs more conjugate steps.
constexpr double kContactGain = 10;

template <typename Real>
AlignedVector<Real> convert(const std::vector<double>& values, double factor = 1) {
  AlignedVector<Real> result;
  for (const double v : values) result.push_back(static_cast<Real>(factor * v));
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
    : Base(*model, kernel, model->effective_step(), model->parameters.integrator()),
      model_(std::move(model)),
      solid_(kernel_of<SolidKernel<Real>>(kernel.lanes)),
      effects_(model_, kernel.lanes) {
  const int W = lanes();
  const int n = particles();
  static_cast<ImplicitArgs<Real>&>(args_) = this->implicit_args();
  load_model();
  held_.resize(W);
  for (auto* mask : {&touches_, &contact_mask_}) mask->assign(n, 0);

  args_.step = step_.assign(n, 3, W);
  args_.z = z_.assign(n, 3, W);
  args_.p = p_.assign(n, 3, W);
  args_.hp = hp_.assign(n, 3, W);
  args_.contact_next = contact_next_.assign(n, 3, W);
  args_.contact_normal = contact_normal_.assign(n, 3, W);
  args_.contact_slide = contact_slide_.assign(n, 1, W);
  args_.touches = touches_.data();
  args_.hold_stiffness = hold_stiffness_.assign(n, 1, W);
  args_.hold_target = hold_target_.assign(n, 3, W);

  for (int lane = 0; lane < W; ++lane) {
    set_parameters(lane, {});
    reset(lane, Vector3d::Zero());
  }
}

/// The model in the kernel's precision.
template <typename Real>
void SolidTissue<Real>::load_model() {
  for (const auto& t : model_->mesh.tetrahedra)
    tetrahedron_.insert(tetrahedron_.end(), t.begin(), t.end());
  const double step = model_->effective_step();
  gradient_ = convert<Real>(model_->gradient);
  volume_ = convert<Real>(model_->volume, 0.25);
  mass_ = convert<Real>(model_->mass);
  for (const double m : model_->mass)
    mass_over_step2_.push_back(static_cast<Real>(m / (step * step)));
  contact_gain_ = convert<Real>(model_->diagonal, kContactGain);
  factor_ = LaneFactor<Real>(model_->factor);
  double weight = 0;
  for (const double m : model_->mass) weight += m * 9.8;  // a scale, whatever the scene's gravity
  model_rest_energy_ =
      std::max(kRestEnergy * weight * model_->spacing, rounding_energy<Real>(*model_));
  args_.tetrahedra = static_cast<std::int32_t>(model_->mesh.tetrahedra.size());
  args_.tetrahedron = tetrahedron_.data();
  args_.gradient = gradient_.data();
  args_.volume = volume_.data();
  args_.mass = mass_.data();
  args_.mass_over_step2 = mass_over_step2_.data();
  args_.contact_gain = contact_gain_.data();
}

template <typename Real>
void SolidTissue<Real>::set_parameters(int lane, const LaneParameters& parameters) {
  const EffectValues effects =
      model_->own_effects(parameters.effects ? *parameters.effects : model_->effects);
  this->set_surroundings(lane, parameters, effects);
  set_effects(lane, effects);
  this->set_material(lane, parameters, model_->material.damping_per_s());
}

template <typename Real>
void SolidTissue<Real>::set_effects(int lane, const EffectValues& effects) {
  const double compliance = effects_.values(lane).grasp_compliance;
  effects_.set(lane, effects);
  args_.effects = effects_.args();
  const double stiffer = effects_.stiffer(lane);
  rest_energy_[lane] = static_cast<Real>(model_rest_energy_ * stiffer * stiffer);
  if (effects.grasp_compliance != compliance) apply_hold(lane);
}

template <typename Real>
void SolidTissue<Real>::reset(int lane, const Vector3d& offset) {
  release(lane);
  effects_.reset(lane, offset);
  this->place_at_rest(lane, offset);
  contact_force_.fill_lane(lane, Real{0});
  p_.fill_lane(lane, Real{0});  // take_response() multiplies it, by 0 at first: it has to be finite
  for (int i = 0; i < particles(); ++i) {
    // A fixed node is held where it is.
    for (int axis = 0; axis < 3; ++axis) hold_target_(i, axis, lane) = x_(i, axis, lane);
    if (!this->is_fixed(i) && model_->on_surface[i] != 0)
      this->set_bit(contact_mask_[i], lane, true);
  }
}

template <typename Real>
void SolidTissue<Real>::begin_step(std::span<const ToolMotion> motion) {
  slip_grasps();
  find_contacts(motion);
}

template <typename Real>
void SolidTissue<Real>::begin_substep(std::span<const ToolMotion> motion, int substep) {
  this->place_tool(motion, substep);
  place_held();
  solid_.start_substep(args_);
  begin_compliant_patches();
  if (effects_.on_nodes()) solid_.start_effects(args_);
  enough_.fill(Real{-1});
}

template <typename Real>
void SolidTissue<Real>::end_substep(bool last) {
  if (last) {
    solid_.find_reaction(args_, hp_.data());
    find_held_force();
  }
  end_compliant_patches();
  if (effects_.remembers()) solid_.remember_effects(args_);
  solid_.finish_substep(args_);
}

// Candidates of the whole step, once; forces of nodes that cannot touch any more are dropped.
template <typename Real>
void SolidTissue<Real>::find_contacts(std::span<const ToolMotion> motion) {
  this->find_candidates(motion, contact_mask_);
  contact_node_.clear();
  for (int i = 0; i < particles(); ++i) {
    if (candidate_any_[i] != 0) {
      contact_node_.push_back(i);
      continue;
    }
    std::fill_n(&contact_force_(i, 0, 0), 3 * lanes(), Real{0});
  }
  args_.contacts = static_cast<std::int32_t>(contact_node_.size());
  args_.contact_node = contact_node_.data();
}

template <typename Real>
void SolidTissue<Real>::set_load(const Real* load) {
  args_.load = load;
}

template <typename Real>
void SolidTissue<Real>::set_position(int lane, int particle, const Vector3d& p) {
  Base::set_position(lane, particle, p);
  if (this->is_fixed(particle)) hold_target_.set_vector(particle, lane, p);
}

template <typename Real>
Vector3d SolidTissue<Real>::anchor_force(int lane) const {
  Vector3d sum = effects_.anchor_force(lane, x_);
  for (int i = 0; i < particles(); ++i) {
    if (this->is_fixed(i)) sum += hp_.vector(i, lane);
  }
  return sum;
}

template <typename Real>
std::vector<Vector3d> SolidTissue<Real>::elastic_gradient(int lane) {
  std::vector<Vector3d> gradient;
  d_.fill(Real{0});
  solid_.find_residual(args_);
  const Real density = args_.effects.density[lane];
  for (int i = 0; i < particles(); ++i) {
    Vector3d force = Vector3d::Zero();
    for (int axis = 0; axis < 3; ++axis) {
      // Without the inertia of v and the weight.
      const Real inertia = density * mass_over_step2_[i] * args_.effective_step * v_(i, axis, lane);
      const Real weight = density * mass_[i] * gravity_(0, axis, lane);
      force[axis] = static_cast<double>(b_(i, axis, lane) + inertia + weight);
    }
    gradient.push_back(force);
  }
  return gradient;
}

template <typename Real>
std::vector<Vector3d> SolidTissue<Real>::elastic_change(int lane,
                                                        std::span<const Vector3d> direction) {
  for (int i = 0; i < particles(); ++i) p_.set_vector(i, lane, direction[i]);
  elastic_gradient(lane);  // places the nodes
  solid_.multiply_hessian(args_);
  std::vector<Vector3d> change;
  const Real density = args_.effects.density[lane];
  for (int i = 0; i < particles(); ++i) {
    const Real inertia = density * mass_over_step2_[i];
    Vector3d force = Vector3d::Zero();
    for (int axis = 0; axis < 3; ++axis)
      force[axis] = static_cast<double>(hp_(i, axis, lane) - inertia * p_(i, axis, lane));
    change.push_back(force);
  }
  return change;
}

template class SolidTissue<float>;
template class SolidTissue<double>;

}  // namespace omentum
