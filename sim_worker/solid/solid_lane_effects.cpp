#include "sim_worker/solid/solid_lane_effects.h"

#include <algorithm>

#include "sim_worker/tissue/effect_laws.h"

namespace omentum {

template <typename Real>
auto SolidLaneEffects<Real>::node_parts(const SolidTissueModel& model) -> std::vector<NodePart> {
  std::vector<NodePart> parts;
  for (int i = 0; i < model.nodes(); ++i) {
    const Eigen::Vector2d p = model.body.particles[i].head<2>();
    const Eigen::Vector2d half = Eigen::Vector2d::Constant(0.5 * model.spacing);
    parts.push_back({model.mass[i], Eigen::AlignedBox2d(p - half, p + half)});
  }
  return parts;
}

template <typename Real>
SolidLaneEffects<Real>::SolidLaneEffects(std::shared_ptr<const SolidTissueModel> model, int lanes)
    : Base(model->body, model->effects, model->is_anchor,
           {4 * static_cast<int>(model->mesh.tetrahedra.size()), 6,
            static_cast<int>(model->mesh.tetrahedra.size()), model->nodes()},
           node_parts(*model), lanes),
      model_(std::move(model)) {
  for (const Eigen::Vector3i& t : model_->mesh.surface) {
    for (int k = 0; k < 3; ++k) skin_.push_back(t[k]);
  }
  args_.mu = mu_.assign(1, 1, lanes);
  args_.lambda = lambda_.assign(1, 1, lanes);
  args_.alpha = alpha_.assign(1, 1, lanes);
  args_.bulk = bulk_.assign(1, 1, lanes);
  for (const double m : model_->added_mass) added_mass_.push_back(static_cast<Real>(m));
  common_.added_mass = added_mass_.empty() ? nullptr : added_mass_.data();
  args_.skin = skin_.data();
  args_.skin_triangles = static_cast<std::int32_t>(skin_.size() / 3);
  for (int lane = 0; lane < lanes; ++lane) set(lane, model_->effects);
}

template <typename Real>
double SolidLaneEffects<Real>::stiffer(int lane) const {
  const EffectValues& v = this->values(lane);
  const auto modulus = [](const SolidLaw& law) { return law.lambda + law.bulk + law.mu; };
  const SolidLaw law = make_solid_law(model_->material.young_modulus_pa(),
                                      model_->material.poisson_ratio() + v.poisson_change);
  double inclusion = 0;
  for (const double change : v.inclusion_change) inclusion += std::max(0.0, change);
  const double material = 1 + make_prony(v, model_->substep()).gains + v.fibre_ratio;
  return std::max(
      1.0, modulus(law) / modulus(model_->law) * (material + v.slider_ratio) * (1 + inclusion));
}

template <typename Real>
void SolidLaneEffects<Real>::set(int lane, const EffectValues& v) {
  const double young = model_->material.young_modulus_pa();
  const SolidLaw law = make_solid_law(young, model_->material.poisson_ratio() + v.poisson_change);
  this->set_common(lane, v, model_->substep(),
                   {.stiffening = v.stiffening * law.shear,
                    .exponential = 2 * law.shear,
                    .softening_energy = 0.5 * young * v.softening_strain * v.softening_strain,
                    .fibre = v.fibre_ratio * young,
                    .slider = v.slider_ratio * young});
  static_cast<LaneEffectArgs<Real>&>(args_) = common_;
  args_.material = args_.stiffening | args_.softening | args_.fibres | args_.slider | args_.prony;
  mu_[lane] = static_cast<Real>(law.mu);
  lambda_[lane] = static_cast<Real>(law.lambda);
  alpha_[lane] = static_cast<Real>(law.alpha);
  bulk_[lane] = static_cast<Real>(law.bulk);
  make_memory();
  set_map(lane);
  set_anchor(lane);
}

template <typename Real>
void SolidLaneEffects<Real>::make_memory() {
  const int nodes = model_->nodes();
  if (args_.bonds != 0) {
    args_.bond_fresh = bond_fresh_.ensure(nodes, 1, lanes_);
    args_.bond_now = bond_now_.ensure(nodes, 1, lanes_);
  }
  if ((args_.adhesion | args_.lubrication | args_.drag) != 0)
    args_.area = area_.ensure(nodes, 3, lanes_);
  if (args_.drag != 0) args_.drag_now = drag_now_.ensure(nodes, 3, lanes_);
}

template <typename Real>
void SolidLaneEffects<Real>::set_anchor(int lane) {
  if (!model_->effects.moves_anchor()) return;
  const std::vector<double> spring = model_->make_anchor(this->values(lane));
  for (int i = 0; i < model_->nodes(); ++i) {
    if (model_->is_anchor[i] != 0) bond_fresh_(i, lane) = static_cast<Real>(spring[i]);
  }
}

/// Stiffness at the integration points, where some lane has an inclusion.
template <typename Real>
void SolidLaneEffects<Real>::set_map(int lane) {
  const bool any = this->lanes_where([](const EffectValues& v) { return v.has_inclusion(); }) != 0;
  const auto tetrahedra = static_cast<int>(model_->mesh.tetrahedra.size());
  args_.map = any ? map_.ensure(4 * tetrahedra, 1, lanes_, Real{1}) : nullptr;
  for (int point = 0; point < 4 * tetrahedra && any; ++point) {
    const Eigen::Vector3d p_B =
        model_->integration_point(static_cast<std::size_t>(point / 4), point % 4);
    map_(point, lane) = static_cast<Real>(this->values(lane).stiffness_at(p_B));
  }
}

template <typename Real>
void SolidLaneEffects<Real>::reset(int lane, const Eigen::Vector3d& offset) {
  this->reset_common(lane, offset);
  bond_fresh_.fill_lane(lane, Real{0});
  set_anchor(lane);
}

template <typename Real>
Eigen::Vector3d SolidLaneEffects<Real>::anchor_force(int lane, const LaneArray<Real>& x) const {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int i = 0; i < model_->nodes() && args_.bonds != 0; ++i) {
    if (model_->is_anchor[i] == 0) continue;
    for (int axis = 0; axis < 3; ++axis) {
      sum[axis] +=
          static_cast<double>(bond_now_(i, lane) * (x(i, axis, lane) - bond_place_(i, axis, lane)));
    }
  }
  return sum;
}

template <typename Real>
std::vector<typename SolidLaneEffects<Real>::Memory> SolidLaneEffects<Real>::memory_of(
    const EffectValues& v) const {
  std::vector<Memory> memory = Base::memory_of(v);
  if (v.adhesion > 0 || model_->effects.moves_anchor())
    memory.push_back({&bond_fresh_, model_->nodes()});
  return memory;
}

template class SolidLaneEffects<float>;
template class SolidLaneEffects<double>;

}  // namespace omentum
