#include "sim_worker/tissue/implicit_tissue.h"

#include "core/trig.h"

namespace omentum {

template <typename Real>
ImplicitTissue<Real>::ImplicitTissue(const TissueModel& model, const LaneKernel<Real>& kernel,
                                     double effective_step, pb::Integrator integrator)
    : LaneTissue<Real>(model, kernel),
      effective_step_(effective_step),
      second_order_(integrator == pb::INTEGRATOR_BDF2) {
  const int n = particles();
  for (auto* array : {&d_, &moved_, &b_, &contact_force_}) array->assign(n, 3, lanes());
  if (!second_order_) return;
  for (auto* array : {&v_old_, &d_old_}) array->assign(n, 3, lanes());
}

template <typename Real>
ImplicitArgs<Real> ImplicitTissue<Real>::implicit_args() {
  ImplicitArgs<Real> args{};
  static_cast<LaneArgs<Real>&>(args) = this->lane_args();
  args.nodes = particles();
  args.second_order = second_order_;
  args.effective_step = static_cast<Real>(effective_step_);
  args.inverse_step = static_cast<Real>(1 / effective_step_);
  args.third = static_cast<Real>(1.0 / 3);
  args.v_old = v_old_.data();
  args.d_old = d_old_.data();
  args.d = d_.data();
  args.moved = moved_.data();
  args.b = b_.data();
  args.contact_force = contact_force_.data();
  return args;
}

template <typename Real>
void ImplicitTissue<Real>::set_material(int lane, const LaneParameters& parameters,
                                        double damping) {
  this->stiffness_[lane] = static_cast<Real>(parameters.stiffness_scale);
  this->keep_[lane] =
      static_cast<Real>(trig::decay(damping * parameters.damping_scale * effective_step_));
}

// The history of BDF2 becomes that of a node which has always moved so. A fixed node stays at rest.
template <typename Real>
void ImplicitTissue<Real>::set_velocity(int lane, int particle, const Eigen::Vector3d& v) {
  const bool fixed = this->is_fixed(particle);
  const auto substep = static_cast<Real>(this->control_period_ / this->substeps_);
  this->forget_health();
  for (int axis = 0; axis < 3; ++axis) {
    const Real speed = fixed ? Real{0} : static_cast<Real>(v[axis]);
    v_(particle, axis, lane) = speed;
    if (!second_order_) continue;
    v_old_(particle, axis, lane) = speed;
    d_old_(particle, axis, lane) = substep * speed;
  }
}

template <typename Real>
std::vector<const LaneArray<Real>*> ImplicitTissue<Real>::watched_arrays() const {
  return {&x_, &v_, &contact_force_};
}

template <typename Real>
std::vector<const LaneArray<Real>*> ImplicitTissue<Real>::saved_arrays() const {
  return {&x_, &v_, &v_old_, &d_old_, &contact_force_, &this->held_force_};
}

template class ImplicitTissue<float>;
template class ImplicitTissue<double>;

}  // namespace omentum
