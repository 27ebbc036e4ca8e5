#include "sim_worker/shell/shell_lane_effects.h"

#include <algorithm>
#include <cmath>

#include "sim_worker/tissue/effect_laws.h"

namespace omentum {

template <typename Real>
auto ShellLaneEffects<Real>::node_parts(const ShellTissueModel& model) -> std::vector<NodePart> {
  std::vector<NodePart> parts;
  for (int i = 0; i < model.nodes(); ++i) {
    const Eigen::Vector2d p = model.body.particles[i].head<2>();
    const Eigen::Vector2d half = Eigen::Vector2d::Constant(0.5 * model.node_size(i));
    Eigen::AlignedBox2d box(p - half, p + half);
    if (!model.is_mesh()) box = box.intersection(model.sheet());
    parts.push_back({model.node_area[i], box});
  }
  return parts;
}

template <typename Real>
ShellLaneEffects<Real>::ShellLaneEffects(std::shared_ptr<const ShellTissueModel> model, int lanes)
    : Base(model->body, model->effects, model->is_anchor,
           {model->triangles(), 3, model->triangles(), model->nodes()}, node_parts(*model), lanes),
      model_(std::move(model)),
      stiffness_(lanes, 1),
      structures_(lanes),
      peak_seen_(lanes, 1) {
  for (const double a : model_->node_area) node_area_.push_back(static_cast<Real>(a));
  args_.shear = shear_.assign(1, 1, lanes);
  args_.area = area_.assign(1, 1, lanes);
  args_.inverse_pitch2 = inverse_pitch2_.assign(1, 1, lanes);
  args_.lateral = lateral_.assign(1, 1, lanes);
  args_.node_area = node_area_.data();
  for (const double m : model_->added_mass) added_mass_.push_back(static_cast<Real>(m));
  common_.added_mass = added_mass_.empty() ? nullptr : added_mass_.data();
  args_.peak = peak_.assign(1, 1, lanes, Real{1});
  args_.last_product = last_product_.assign(1, 1, lanes);
  for (int lane = 0; lane < lanes; ++lane) set(lane, model_->effects, 1);
}

template <typename Real>
const ShellStructure& ShellLaneEffects<Real>::structure_of(int lane) const {
  return this->values(lane).same_structure(model_->effects) ? model_->structure : structures_[lane];
}

template <typename Real>
int ShellLaneEffects<Real>::factor_key(int lane) const {
  return model_->factor_key(stiffness_[lane], this->values(lane), structure_of(lane),
                            peak_seen_[lane]);
}

template <typename Real>
void ShellLaneEffects<Real>::set(int lane, const EffectValues& v, double stiffness_scale) {
  const double nu = model_->material.poisson_ratio() + v.poisson_change;
  this->set_common(lane, v, model_->substep(),
                   {.stiffening = 4 * v.stiffening,
                    .exponential = 1,
                    .softening_energy = 0.5 * (1 + nu) * v.softening_strain * v.softening_strain,
                    .fibre = v.fibre_ratio * (1 + nu),
                    .slider = v.slider_ratio * (1 + nu)});
  static_cast<LaneEffectArgs<Real>&>(args_) = common_;
  stiffness_[lane] = stiffness_scale;
  structures_[lane] =
      v.same_structure(model_->effects) ? ShellStructure{} : model_->make_structure(v);
  const ShellStructure& structure = structure_of(lane);
  const auto scale = static_cast<Real>(stiffness_scale);
  const auto shrink = static_cast<Real>(1 / ((1 + v.stretch) * (1 + v.stretch)));
  shear_[lane] = static_cast<Real>(structure.shear) * scale * shrink;
  area_[lane] = static_cast<Real>(structure.area) * scale * shrink;
  inverse_pitch2_[lane] = static_cast<Real>(1 / (model_->pitch * model_->pitch)) * shrink;
  lateral_[lane] = static_cast<Real>(nu / (1 - nu));
  make_memory();
  set_maps();
  set_rest_moments(lane);
  if (args_.bonds == 0) return;
  const std::vector<double> spring = model_->make_anchor(v);
  const std::vector<double> turn = model_->make_anchor_turn(v);
  for (int i = 0; i < model_->nodes(); ++i) {
    anchor_(i, lane) = static_cast<Real>(spring[i]);
    anchor_turn_(i, lane) = static_cast<Real>(turn[i]);
  }
}

template <typename Real>
void ShellLaneEffects<Real>::make_memory() {
  const auto stencils = static_cast<int>(model_->stencils.size());
  const int nodes = model_->nodes();
  if (args_.prony != 0) {
    args_.moment = moment_.ensure(stencils, 3, lanes_);
    args_.moment_bias = moment_bias_.ensure(stencils, 3, lanes_);
    args_.moment_branch = moment_branch_.ensure(kMaxBranches * stencils, 3, lanes_);
  }
  if (args_.bonds != 0) {
    args_.anchor = anchor_.ensure(nodes, 1, lanes_);
    args_.anchor_turn = anchor_turn_.ensure(nodes, 1, lanes_);
  }
  stiff_pull_ = this->lanes_where([this](const EffectValues& v) { return has_stiff_pull(v); });
  if ((args_.adhesion | args_.lubrication | stiff_pull_) != 0) {
    args_.rest = rest_.ensure(nodes, 3, lanes_);
    args_.direction = direction_.ensure(nodes, 3, lanes_);
    args_.preconditioner_direction = preconditioner_direction_.ensure(nodes, 3, lanes_);
    args_.solution = solution_.ensure(nodes, 3, lanes_);
    args_.response = response_.ensure(nodes, 3, lanes_);
  }
}

/// Whether a string or damper is so stiff that the factor, which does not know of it, would not
/// settle.
template <typename Real>
bool ShellLaneEffects<Real>::has_stiff_pull(const EffectValues& v) const {
  constexpr double kSoft = 0.1;  // of the stretch stiffness of a node
  if (!(v.pull > 0)) return false;
  const std::vector<double> share =
      disc_shares(model_->body.particles, model_->node_area, {v.pull_x, v.pull_y}, v.pull_radius);
  const double whole = v.pull * (v.pull_stiffness + v.pull_damper / model_->substep());
  return whole * *std::ranges::max_element(share) > kSoft * model_->membrane_stiffness();
}

/// Arrays per lane where a lane differs from the scene; the products are those of the kernel
/// without maps, so that a lane with the scene's own values keeps its bits.
template <typename Real>
void ShellLaneEffects<Real>::set_maps() {
  const auto real = [](double v) { return static_cast<Real>(v); };
  bool differ = false;
  bool uniform = true;
  for (int lane = 0; lane < lanes_; ++lane) {
    differ = differ || !this->values(lane).same_structure(model_->effects);
    uniform = uniform && structure_of(lane).uniform;
  }
  args_.mass = args_.plate = args_.cell = nullptr;
  args_.membrane = !uniform || (args_.stiffening | args_.softening | args_.fibres | args_.prony |
                                args_.slider) != 0;
  for (int lane = 0; lane < lanes_ && (differ || !uniform); ++lane) {
    const ShellStructure& s = structure_of(lane);
    if (!uniform) {
      args_.cell = cell_.ensure(static_cast<int>(s.cell.size()), 2, lanes_);
      for (std::size_t c = 0; c < s.cell.size(); ++c) {
        cell_(static_cast<int>(c), 0, lane) = shear_[lane] * real(s.cell[c]);
        cell_(static_cast<int>(c), 1, lane) = area_[lane] * real(s.cell[c]);
      }
    }
    if (!differ) continue;
    args_.mass = mass_.ensure(static_cast<int>(s.mass.size()), 1, lanes_);
    args_.plate = plate_.ensure(static_cast<int>(s.plate.size()), 4, lanes_);
    for (std::size_t i = 0; i < s.mass.size(); ++i)
      mass_(static_cast<int>(i), lane) = real(s.mass[i]);
    for (std::size_t k = 0; k < s.plate.size(); ++k) {
      for (int term = 0; term < 4; ++term)
        plate_(static_cast<int>(k), term, lane) = real(s.plate[k][term]);
    }
  }
}

template <typename Real>
bool ShellLaneEffects<Real>::is_curved(const EffectValues& v) const {
  return model_->is_curved() || v.curvature_x != 0 || v.curvature_y != 0 || v.twist != 0;
}

/// Moments of the rest curvature, where some lane is curved at rest.
template <typename Real>
void ShellLaneEffects<Real>::set_rest_moments(int lane) {
  const auto stencils = static_cast<int>(model_->stencils.size());
  const bool any = this->lanes_where([this](const EffectValues& v) { return is_curved(v); }) != 0;
  args_.rest_moment = any ? rest_moment_.ensure(stencils, 3, lanes_) : nullptr;
  if (rest_moment_.empty()) return;
  rest_moment_.fill_lane(lane, Real{0});
  if (!is_curved(this->values(lane))) return;
  const auto moments = model_->make_rest_moments(this->values(lane));
  for (int k = 0; k < stencils; ++k) {
    rest_moment_.set_vector(k, lane, stiffness_[lane] * moments[k]);
  }
}

template <typename Real>
void ShellLaneEffects<Real>::reset(int lane, const Eigen::Vector3d& offset) {
  this->reset_common(lane, offset);
  for (auto* array : {&moment_, &moment_branch_, &moment_bias_}) array->fill_lane(lane, Real{0});
  peak_[lane] = Real{1};
  peak_seen_[lane] = 1;
}

template <typename Real>
std::uint32_t ShellLaneEffects<Real>::begin_substep() {
  args_.springs = args_.lubrication | stiff_pull_;
  for (int lane = 0; lane < lanes_; ++lane) {
    for (int i = 0; i < model_->nodes() && (args_.adhesion >> lane & 1U) != 0; ++i) {
      if (model_->is_anchor[i] != 0 || bond_longest_(i, lane) < Real{0}) continue;
      args_.springs |= 1U << lane;
      break;
    }
  }
  std::uint32_t changed = 0;
  for (int lane = 0; lane < lanes_; ++lane) {
    if (!follows_law() && (args_.stiffening >> lane & 1U) == 0) continue;
    const int before = factor_key(lane);
    const auto peak = static_cast<double>(peak_[lane]);
    peak_seen_[lane] = std::isfinite(peak) ? std::max(1.0, peak) : 1;
    peak_[lane] = Real{1};
    if (factor_key(lane) != before) changed |= 1U << lane;
  }
  return changed;
}

template <typename Real>
std::vector<typename ShellLaneEffects<Real>::Memory> ShellLaneEffects<Real>::memory_of(
    const EffectValues& v) const {
  std::vector<Memory> memory = Base::memory_of(v);
  const auto moments = 3 * static_cast<int>(model_->stencils.size());
  const int branches = prony_branches(v);
  if (branches > 0) {
    memory.push_back({&moment_, moments});
    memory.push_back({&moment_branch_, branches * moments});
    memory.push_back({&moment_bias_, moments});
  }
  if (v.stiffens() || follows_law()) memory.push_back({&peak_, 1});
  return memory;
}

template class ShellLaneEffects<float>;
template class ShellLaneEffects<double>;

}  // namespace omentum
