#include "sim_worker/coupled/coupled_tissue.h"

#include <algorithm>

#include "core/check.h"
#include "core/hash.h"
#include "sim_worker/solid/solid_model.h"

namespace omentum {

using Eigen::Vector3d;

std::shared_ptr<const CoupledTissueModel> make_coupled_model(const Scene& scene,
                                                             double control_period,
                                                             std::vector<std::string>& warnings) {
  auto model = std::make_shared<CoupledTissueModel>();
  model->sheet = make_shell_model(scene, control_period, warnings);
  model->solid = make_soft_body_model(scene, control_period);
  model->body = model->sheet->body;
  model->surroundings = model->sheet->surroundings;
  model->effects = model->sheet->effects;
  model->control_period = control_period;
  return model;
}

std::unique_ptr<Tissue<float>> CoupledTissueModel::make_tissue(
    const LaneKernel<float>& kernel) const {
  return std::make_unique<CoupledTissue<float>>(shared_from_this(), kernel);
}

std::unique_ptr<Tissue<double>> CoupledTissueModel::make_tissue(
    const LaneKernel<double>& kernel) const {
  return std::make_unique<CoupledTissue<double>>(shared_from_this(), kernel);
}

template <typename Real>
CoupledTissue<Real>::CoupledTissue(std::shared_ptr<const CoupledTissueModel> model,
                                   const LaneKernel<Real>& kernel)
    : model_(std::move(model)),
      sheet_(model_->sheet, kernel),
      contact_(model_->solid, kernel, sheet_.particles(), model_->sheet->body.particle_radius),
      held_(kernel.lanes) {
  sheet_.lie_on(contact_);
}

template <typename Real>
void CoupledTissue<Real>::reset(int lane, const Vector3d& offset) {
  sheet_.reset(lane, offset);
  contact_.reset(lane);
}

template <typename Real>
void CoupledTissue<Real>::set_parameters(int lane, const LaneParameters& parameters) {
  sheet_.set_parameters(lane, parameters);
  LaneParameters of_body;
  of_body.gravity_scale = parameters.gravity_scale;
  of_body.friction_scale = parameters.friction_scale;
  of_body.effects = parameters.effects;
  solid().set_parameters(lane, of_body);
}

// The sheet looks for the body's surface as it begins a step, and slips out of the jaws with it.
template <typename Real>
void CoupledTissue<Real>::begin_step(std::span<const ToolMotion> motion) {
  sheet_.begin_step(motion);
  solid().begin_step(motion);
}

template <typename Real>
void CoupledTissue<Real>::begin_substep(std::span<const ToolMotion> motion, int substep) {
  sheet_.begin_substep(motion, substep);
  solid().begin_substep(motion, substep);
  contact_.begin_substep(sheet_.substep_positions());
}

// The body under the forces of the last substep, the sheet with contact, which changes them, and
// the body again.
template <typename Real>
void CoupledTissue<Real>::solve_substep() {
  solid().solve_substep();
  sheet_.solve_substep();
  contact_.settle();
}

template <typename Real>
void CoupledTissue<Real>::end_substep(bool last) {
  solid().end_substep(last);
  sheet_.end_substep(last);
}

template <typename Real>
void CoupledTissue<Real>::hold(int lane, const Vector3d& tip, double radius, bool collapse) {
  release(lane);
  sheet_.hold(lane, tip, radius, collapse);
}

template <typename Real>
void CoupledTissue<Real>::release(int lane) {
  sheet_.release(lane);
  solid().release(lane);
}

template <typename Real>
std::span<const std::int32_t> CoupledTissue<Real>::held(int lane) const {
  std::vector<std::int32_t>& nodes = held_[lane];
  const auto of_sheet = sheet_.held(lane);
  nodes.assign(of_sheet.begin(), of_sheet.end());
  for (const std::int32_t i : contact_.solid().held(lane)) nodes.push_back(sheet_.particles() + i);
  return nodes;
}

template <typename Real>
void CoupledTissue<Real>::shift_held(int lane, const Vector3d& by) {
  sheet_.shift_held(lane, by);
  solid().shift_held(lane, by);
}

template <typename Real>
Vector3d CoupledTissue<Real>::position(int lane, int particle) const {
  const int of_body = particle - sheet_.particles();
  return of_body < 0 ? sheet_.position(lane, particle) : contact_.solid().position(lane, of_body);
}

template <typename Real>
Vector3d CoupledTissue<Real>::velocity(int lane, int particle) const {
  const int of_body = particle - sheet_.particles();
  return of_body < 0 ? sheet_.velocity(lane, particle) : contact_.solid().velocity(lane, of_body);
}

template <typename Real>
void CoupledTissue<Real>::set_position(int lane, int particle, const Vector3d& p) {
  const int of_body = particle - sheet_.particles();
  if (of_body < 0) {
    sheet_.set_position(lane, particle, p);
  } else {
    solid().set_position(lane, of_body, p);
  }
}

template <typename Real>
void CoupledTissue<Real>::set_velocity(int lane, int particle, const Vector3d& v) {
  const int of_body = particle - sheet_.particles();
  if (of_body < 0) {
    sheet_.set_velocity(lane, particle, v);
  } else {
    solid().set_velocity(lane, of_body, v);
  }
}

template <typename Real>
const Real* CoupledTissue<Real>::surface_positions() {
  const auto row = static_cast<std::size_t>(3 * lanes());
  const std::size_t of_sheet = row * static_cast<std::size_t>(sheet_.particles());
  const std::size_t of_body = row * static_cast<std::size_t>(solid().particles());
  surface_.resize(of_sheet + of_body);
  std::copy_n(sheet_.surface_positions(), of_sheet, surface_.begin());
  std::copy_n(solid().surface_positions(), of_body,
              surface_.begin() + static_cast<std::ptrdiff_t>(of_sheet));
  return surface_.data();
}

// State of a lane: the sheet, then the contact and the body.
template <typename Real>
void CoupledTissue<Real>::save(int lane, Bytes& out) const {
  sheet_.save(lane, out);
  contact_.save(lane, out);
}

template <typename Real>
Result<std::size_t> CoupledTissue<Real>::load(int lane, std::span<const std::byte> state) {
  Bytes before;
  sheet_.save(lane, before);
  const Result<std::size_t> of_sheet = sheet_.load(lane, state);
  if (!of_sheet) return Failure{of_sheet.error()};
  const Result<std::size_t> of_body = contact_.load(lane, state.subspan(of_sheet.value()));
  if (!of_body) {
    OMENTUM_CHECK(sheet_.load(lane, before).has_value());
    return Failure{of_body.error()};
  }
  return of_sheet.value() + of_body.value();
}

template <typename Real>
std::uint64_t CoupledTissue<Real>::hash(int lane) const {
  Bytes bytes;
  save(lane, bytes);
  return fnv1a64(bytes);
}

template class CoupledTissue<float>;
template class CoupledTissue<double>;

}  // namespace omentum
