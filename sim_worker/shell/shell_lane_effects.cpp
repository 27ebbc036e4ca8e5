#include "sim_worker/shell/shell_lane_effects.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/check.h"
#include "core/trig.h"

namespace omentum {
namespace {

template <typename Real>
Real real(double v) {
  return static_cast<Real>(v);
}

template <typename Real>
void ensure(AlignedVector<Real>& array, std::size_t size) {
  if (array.size() < size) array.resize(size, Real{0});
}

}  // namespace

template <typename Real>
ShellLaneEffects<Real>::ShellLaneEffects(std::shared_ptr<const ShellTissueModel> model, int lanes)
    : model_(std::move(model)), lanes_(lanes) {
  const auto W = static_cast<std::size_t>(lanes);
  values_.resize(W);
  stiffness_.assign(W, 1);
  structures_.resize(W);
  peak_seen_.assign(W, 1);
  for (auto* v :
       {&shear_, &area_, &inverse_pitch2_, &density_, &stiffening_, &lateral_, &fibre_, &softening_,
        &softening_energy_, &prony_gains_, &slider_, &yield_, &drag_, &adhesion_, &adhesion_limit_,
        &anchor_limit_, &film_, &film_reach_, &last_product_}) {
    v->assign(W, Real{0});
  }
  peak_.assign(W, Real{1});
  fibre_axes_.assign(3 * W, Real{0});
  prony_keep_.assign(kMaxBranches * W, Real{0});
  prony_gain_.assign(kMaxBranches * W, Real{0});
  for (const double a : model_->node_area) node_area_.push_back(real<Real>(a));
  args_.shear = shear_.data();
  args_.area = area_.data();
  args_.inverse_pitch2 = inverse_pitch2_.data();
  args_.density = density_.data();
  args_.stiffening_scale = stiffening_.data();
  args_.softening_share = softening_.data();
  args_.softening_energy = softening_energy_.data();
  args_.lateral = lateral_.data();
  args_.fibre = fibre_.data();
  args_.fibre_axes = fibre_axes_.data();
  args_.prony_gains = prony_gains_.data();
  args_.prony_keep = prony_keep_.data();
  args_.prony_gain = prony_gain_.data();
  args_.slider_scale = slider_.data();
  args_.slider_yield = yield_.data();
  args_.drag_scale = drag_.data();
  args_.adhesion_scale = adhesion_.data();
  args_.adhesion_limit = adhesion_limit_.data();
  args_.anchor_limit = anchor_limit_.data();
  args_.film_scale = film_.data();
  args_.film_reach = film_reach_.data();
  args_.node_area = node_area_.data();
  args_.is_anchor = model_->is_anchor.data();
  args_.peak = peak_.data();
  args_.last_product = last_product_.data();
  for (int lane = 0; lane < lanes; ++lane) set(lane, model_->effects, 1);
}

template <typename Real>
int ShellLaneEffects<Real>::factor_key(int lane) const {
  const auto l = static_cast<std::size_t>(lane);
  const EffectValues& v = values_[l];
  const ShellStructure& structure =
      v.same_structure(model_->effects) ? model_->structure : structures_[l];
  return model_->factor_key(stiffness_[l], v, structure, peak_seen_[l]);
}

template <typename Real>
void ShellLaneEffects<Real>::set(int lane, const EffectValues& v, double stiffness_scale) {
  const EffectValues& scene = model_->effects;
  OMENTUM_CHECK(scene.anchor_compliance > 0
                    ? v.anchor_compliance > 0
                    : v.anchor_compliance == 0 && v.anchor_free_from == scene.anchor_free_from &&
                          v.anchor_free_to == scene.anchor_free_to,
                "anchor compliance {} in a scene of {}", v.anchor_compliance,
                scene.anchor_compliance);
  const auto W = static_cast<std::size_t>(lanes_);
  const auto l = static_cast<std::size_t>(lane);
  values_[l] = v;
  stiffness_[l] = stiffness_scale;
  structures_[l] = v.same_structure(scene) ? ShellStructure{} : model_->make_structure(v);
  const ShellStructure& structure = v.same_structure(scene) ? model_->structure : structures_[l];
  const double nu = model_->material.poisson_ratio() + v.poisson_change;
  const auto scale = real<Real>(stiffness_scale);
  const auto shrink = real<Real>(1 / ((1 + v.stretch) * (1 + v.stretch)));
  shear_[l] = real<Real>(structure.shear) * scale * shrink;
  area_[l] = real<Real>(structure.area) * scale * shrink;
  inverse_pitch2_[l] = real<Real>(1 / (model_->pitch * model_->pitch)) * shrink;
  density_[l] = real<Real>(1 + v.density_change);
  stiffening_[l] = real<Real>(4 * v.stiffening);
  softening_[l] = real<Real>(v.softening);
  softening_energy_[l] = real<Real>(0.5 * (1 + nu) * v.softening_strain * v.softening_strain);
  lateral_[l] = real<Real>(nu / (1 - nu));
  fibre_[l] = real<Real>(v.fibre_ratio * (1 + nu));
  const trig::SinCos a = trig::sin_cos(v.fibre_angle);
  fibre_axes_[l] = real<Real>(a.cos * a.cos);
  fibre_axes_[W + l] = real<Real>(a.cos * a.sin);
  fibre_axes_[2 * W + l] = real<Real>(a.sin * a.sin);
  const PronyStep prony = make_prony(v, model_->substep());
  prony_gains_[l] = real<Real>(prony.gains);
  for (std::size_t k = 0; k < kMaxBranches; ++k) {
    prony_keep_[k * W + l] = real<Real>(prony.keep[k]);
    prony_gain_[k * W + l] = real<Real>(prony.gain[k]);
  }
  slider_[l] = real<Real>(v.slider_ratio * (1 + nu));
  yield_[l] = real<Real>(v.slider_yield);
  drag_[l] = real<Real>(0.5 * v.air_drag * kAirDensity);
  adhesion_[l] = real<Real>(v.adhesion);
  adhesion_limit_[l] = real<Real>(v.adhesion_break);
  constexpr double kNever = 1e6;  // [m]
  anchor_limit_[l] = real<Real>(v.anchor_break > 0 ? v.anchor_break : kNever);
  film_[l] = real<Real>(v.suction / model_->substep());
  film_reach_[l] = real<Real>(v.suction_reach);
  set_masks();
  set_maps();
  set_rest_moments(lane);
  if (args_.bonds != 0) {
    const std::vector<double> spring = model_->make_anchor(v);
    for (std::size_t i = 0; i < spring.size(); ++i) {
      anchor_[i * W + l] = real<Real>(spring[i]);
    }
  }
}

template <typename Real>
void ShellLaneEffects<Real>::set_masks() {
  const auto mask = [this](auto on) {
    std::uint32_t lanes = 0;
    for (int lane = 0; lane < lanes_; ++lane) {
      if (on(values_[static_cast<std::size_t>(lane)])) lanes |= 1U << lane;
    }
    return lanes;
  };
  args_.stiffening = mask([](const EffectValues& v) { return v.stiffening != 0; });
  args_.softening = mask([](const EffectValues& v) { return v.softening > 0; });
  args_.fibres = mask([](const EffectValues& v) { return v.fibre_ratio > 0; });
  args_.slider = mask([](const EffectValues& v) { return v.slider_ratio > 0; });
  args_.prony = mask([](const EffectValues& v) { return make_prony(v, 1).branches > 0; });
  args_.drag = mask([](const EffectValues& v) { return v.air_drag > 0; });
  args_.adhesion = mask([](const EffectValues& v) { return v.adhesion > 0; });
  args_.film = mask([](const EffectValues& v) { return v.suction > 0; });
  args_.bonds =
      args_.adhesion | mask([this](const EffectValues&) { return model_->effects.moves_anchor(); });
  args_.branches = 0;
  for (const EffectValues& v : values_) {
    args_.branches = std::max(args_.branches, make_prony(v, 1).branches);
  }
  const auto W = static_cast<std::size_t>(lanes_);
  const auto nodes = 3 * W * static_cast<std::size_t>(model_->nodes());
  const auto triangles = 3 * W * static_cast<std::size_t>(model_->triangles());
  const auto stencils = 3 * W * model_->stencils.size();
  if (args_.prony != 0) {
    for (auto* v : {&stress_, &bias_}) ensure(*v, triangles);
    ensure(branch_, kMaxBranches * triangles);
    for (auto* v : {&moment_, &moment_bias_}) ensure(*v, stencils);
    ensure(moment_branch_, kMaxBranches * stencils);
  }
  if (args_.slider != 0) ensure(plastic_, triangles);
  if (args_.softening != 0) ensure(energy_peak_, triangles / 3);
  if (args_.bonds != 0) {
    ensure(bond_place_, nodes);
    if (bond_longest_.empty()) bond_longest_.assign(nodes / 3, Real{-1});
    ensure(anchor_, nodes / 3);
  }
  if (args_.film != 0) {
    ensure(film_now_, nodes / 3);
    ensure(film_normal_, nodes);
  }
  if ((args_.adhesion | args_.film) != 0) {
    for (auto* v : {&rest_, &direction_, &metric_direction_, &solution_, &answer_}) {
      ensure(*v, nodes);
    }
  }
  args_.stress = stress_.data();
  args_.branch = branch_.data();
  args_.bias = bias_.data();
  args_.plastic = plastic_.data();
  args_.energy_peak = energy_peak_.data();
  args_.moment = moment_.data();
  args_.moment_branch = moment_branch_.data();
  args_.moment_bias = moment_bias_.data();
  args_.bond_place = bond_place_.data();
  args_.bond_longest = bond_longest_.data();
  args_.anchor = anchor_.data();
  args_.film_now = film_now_.data();
  args_.film_normal = film_normal_.data();
  args_.rest = rest_.data();
  args_.direction = direction_.data();
  args_.metric_direction = metric_direction_.data();
  args_.solution = solution_.data();
  args_.answer = answer_.data();
}

/// Arrays per lane where a lane differs from the scene; the products are those of the kernel
/// without maps, so that a lane with the scene's own values keeps its bits.
template <typename Real>
void ShellLaneEffects<Real>::set_maps() {
  const auto W = static_cast<std::size_t>(lanes_);
  bool differ = false;
  bool uniform = true;
  for (std::size_t l = 0; l < W; ++l) {
    const bool same = values_[l].same_structure(model_->effects);
    differ = differ || !same;
    uniform = uniform && (same ? model_->structure : structures_[l]).uniform;
  }
  args_.mass = args_.plate = args_.cell = nullptr;
  args_.membrane = !uniform || (args_.stiffening | args_.softening | args_.fibres | args_.prony |
                                args_.slider) != 0;
  for (std::size_t l = 0; l < W && (differ || !uniform); ++l) {
    const bool same = values_[l].same_structure(model_->effects);
    const ShellStructure& s = same ? model_->structure : structures_[l];
    if (!uniform) {
      ensure(cell_, 2 * W * s.cell.size());
      for (std::size_t c = 0; c < s.cell.size(); ++c) {
        cell_[2 * W * c + l] = shear_[l] * real<Real>(s.cell[c]);
        cell_[2 * W * c + W + l] = area_[l] * real<Real>(s.cell[c]);
      }
    }
    if (!differ) continue;
    ensure(mass_, W * s.mass.size());
    ensure(plate_, 4 * W * s.plate.size());
    for (std::size_t i = 0; i < s.mass.size(); ++i) mass_[W * i + l] = real<Real>(s.mass[i]);
    for (std::size_t k = 0; k < s.plate.size(); ++k) {
      for (std::size_t term = 0; term < 4; ++term) {
        plate_[(4 * k + term) * W + l] = real<Real>(s.plate[k][static_cast<Eigen::Index>(term)]);
      }
    }
  }
  if (!uniform) args_.cell = cell_.data();
  if (differ) args_.mass = mass_.data();
  if (differ) args_.plate = plate_.data();
}

/// Moments of the rest curvature, where some lane is curved at rest.
template <typename Real>
void ShellLaneEffects<Real>::set_rest_moments(int lane) {
  const bool model_curved = model_->is_curved();
  const auto curved = [&](const EffectValues& v) {
    return model_curved || v.curvature_x != 0 || v.curvature_y != 0 || v.twist != 0;
  };
  const bool any = std::any_of(values_.begin(), values_.end(), curved);
  const auto W = static_cast<std::size_t>(lanes_);
  const auto l = static_cast<std::size_t>(lane);
  if (any) ensure(rest_moment_, 3 * W * model_->stencils.size());
  args_.rest_moment = any ? rest_moment_.data() : nullptr;
  if (rest_moment_.empty()) return;
  std::vector<Eigen::Vector3d> moments(model_->stencils.size(), Eigen::Vector3d::Zero());
  if (curved(values_[l])) moments = model_->make_rest_moments(values_[l]);
  for (std::size_t k = 0; k < moments.size(); ++k) {
    for (std::size_t term = 0; term < 3; ++term) {
      rest_moment_[(3 * k + term) * W + l] =
          real<Real>(stiffness_[l] * moments[k][static_cast<Eigen::Index>(term)]);
    }
  }
}

template <typename Real>
void ShellLaneEffects<Real>::reset(int lane, const Eigen::Vector3d& offset) {
  const auto W = static_cast<std::size_t>(lanes_);
  const auto l = static_cast<std::size_t>(lane);
  for (auto* array : {&stress_, &branch_, &bias_, &plastic_, &energy_peak_, &moment_,
                      &moment_branch_, &moment_bias_, &bond_place_}) {
    for (std::size_t k = l; k < array->size(); k += W) (*array)[k] = Real{0};
  }
  for (std::size_t k = l; k < bond_longest_.size(); k += W) bond_longest_[k] = Real{-1};
  peak_[l] = Real{1};
  peak_seen_[l] = 1;
  for (int i = 0; i < model_->nodes() && args_.bonds != 0; ++i) {
    const auto k = static_cast<std::size_t>(i);
    if (model_->is_anchor[k] == 0) continue;
    const Eigen::Vector3d p = model_->body.X_WB * model_->body.particles[k] + offset;
    for (int axis = 0; axis < 3; ++axis) bond_place_[at(i, axis, lane)] = real<Real>(p[axis]);
    bond_longest_[k * W + l] = Real{0};
  }
}

template <typename Real>
std::uint32_t ShellLaneEffects<Real>::begin_substep() {
  args_.springs = args_.film;
  const auto W = static_cast<std::size_t>(lanes_);
  for (std::size_t l = 0; l < W && args_.adhesion != 0; ++l) {
    const std::uint32_t lane = 1U << l;
    for (std::size_t i = 0; i * W < bond_longest_.size() && (args_.adhesion & lane) != 0; ++i) {
      if (model_->is_anchor[i] != 0 || bond_longest_[i * W + l] < Real{0}) continue;
      args_.springs |= lane;
      break;
    }
  }
  std::uint32_t changed = 0;
  for (int lane = 0; lane < lanes_ && args_.stiffening != 0; ++lane) {
    if ((args_.stiffening >> lane & 1U) == 0) continue;
    const auto l = static_cast<std::size_t>(lane);
    const int before = factor_key(lane);
    const auto peak = static_cast<double>(peak_[l]);
    peak_seen_[l] = std::isfinite(peak) ? std::max(1.0, peak) : 1;
    peak_[l] = Real{1};
    if (factor_key(lane) != before) changed |= 1U << lane;
  }
  return changed;
}

/// Memory arrays of a lane with these values, in the order of the state.
template <typename Real>
template <typename Function>
void ShellLaneEffects<Real>::for_each_memory(const EffectValues& values, Function&& fn) const {
  const std::size_t nodes = 3 * static_cast<std::size_t>(model_->nodes());
  const std::size_t triangles = 3 * static_cast<std::size_t>(model_->triangles());
  const std::size_t stencils = 3 * model_->stencils.size();
  const auto branches = static_cast<std::size_t>(make_prony(values, 1).branches);
  if (branches > 0) {
    fn(stress_, triangles);
    fn(branch_, branches * triangles);
    fn(bias_, triangles);
    fn(moment_, stencils);
    fn(moment_branch_, branches * stencils);
    fn(moment_bias_, stencils);
  }
  if (values.slider_ratio > 0) fn(plastic_, triangles);
  if (values.softening > 0) fn(energy_peak_, triangles / 3);
  if (values.adhesion > 0 || model_->effects.moves_anchor()) {
    fn(bond_place_, nodes);
    fn(bond_longest_, nodes / 3);
  }
  if (values.stiffening != 0) fn(peak_, 1);
}

template <typename Real>
void ShellLaneEffects<Real>::save(int lane, Bytes& out) const {
  const auto add = [&out](const void* data, std::size_t size) {
    const auto* bytes = static_cast<const std::byte*>(data);
    out.insert(out.end(), bytes, bytes + size);
  };
  const auto l = static_cast<std::size_t>(lane);
  const EffectValues& v = values_[l];
  if (v == EffectValues{}) return;
  add(&v, sizeof v);
  for_each_memory(v, [&](const AlignedVector<Real>& array, std::size_t count) {
    for (std::size_t k = 0; k < count; ++k) {
      add(&array[k * static_cast<std::size_t>(lanes_) + l], sizeof(Real));
    }
  });
}

template <typename Real>
Result<std::size_t> ShellLaneEffects<Real>::read(std::span<const std::byte> state,
                                                 EffectValues& v) const {
  if (state.size() < sizeof v) return Failure{"tissue state ends in its effects"};
  std::memcpy(&v, state.data(), sizeof v);
  const EffectValues& scene = model_->effects;
  const bool anchors_fit = scene.anchor_compliance > 0
                               ? v.anchor_compliance > 0
                               : v.anchor_compliance == 0 &&
                                     v.anchor_free_from == scene.anchor_free_from &&
                                     v.anchor_free_to == scene.anchor_free_to;
  if (!anchors_fit || v == EffectValues{} ||
      !usable(v, model_->material.poisson_ratio(), model_->body.particles)) {
    return Failure{"tissue state holds effects out of range"};
  }
  std::size_t reals = 0;
  for_each_memory(v, [&](const AlignedVector<Real>&, std::size_t count) { reals += count; });
  if (state.size() < sizeof v + reals * sizeof(Real)) {
    return Failure{"tissue state ends in the memory of its effects"};
  }
  AlignedVector<Real> memory(reals);
  if (reals > 0) std::memcpy(memory.data(), state.data() + sizeof v, reals * sizeof(Real));
  if (!std::all_of(memory.begin(), memory.end(), [](Real r) { return std::isfinite(r); })) {
    return Failure{"tissue state holds a non-finite memory of an effect"};
  }
  return sizeof v + reals * sizeof(Real);
}

template <typename Real>
void ShellLaneEffects<Real>::load(int lane, std::span<const std::byte> state) {
  const std::byte* next = state.data() + sizeof(EffectValues);
  const auto l = static_cast<std::size_t>(lane);
  for_each_memory(values_[l], [&](const AlignedVector<Real>& array, std::size_t count) {
    auto& memory = const_cast<AlignedVector<Real>&>(array);  // NOLINT: of this object
    for (std::size_t k = 0; k < count; ++k, next += sizeof(Real)) {
      std::memcpy(&memory[k * static_cast<std::size_t>(lanes_) + l], next, sizeof(Real));
    }
  });
}

template class ShellLaneEffects<float>;
template class ShellLaneEffects<double>;

}  // namespace omentum
