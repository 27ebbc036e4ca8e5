#include "sim_worker/solid/solid_lane_effects.h"

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
void ensure(AlignedVector<Real>& array, std::size_t size, Real value = Real{0}) {
  if (array.size() < size) array.resize(size, value);
}

}  // namespace

template <typename Real>
SolidLaneEffects<Real>::SolidLaneEffects(std::shared_ptr<const SolidTissueModel> model, int lanes)
    : model_(std::move(model)), lanes_(lanes) {
  const auto W = static_cast<std::size_t>(lanes);
  values_.resize(W);
  for (auto* v : {&mu_, &lambda_, &alpha_, &bulk_, &density_, &stiffening_, &softening_,
                  &softening_energy_, &fibre_, &prony_gains_, &slider_, &yield_, &anchor_limit_,
                  &adhesion_, &adhesion_limit_, &film_, &film_reach_, &drag_}) {
    v->assign(W, Real{0});
  }
  fibre_axes_.assign(3 * W, Real{0});
  prony_keep_.assign(kMaxBranches * W, Real{0});
  prony_gain_.assign(kMaxBranches * W, Real{0});
  for (const Eigen::Vector3i& t : model_->mesh.surface) {
    for (int k = 0; k < 3; ++k) skin_.push_back(t[k]);
  }
  args_.mu = mu_.data();
  args_.lambda = lambda_.data();
  args_.alpha = alpha_.data();
  args_.bulk = bulk_.data();
  args_.density = density_.data();
  args_.stiffening_scale = stiffening_.data();
  args_.softening_share = softening_.data();
  args_.softening_energy = softening_energy_.data();
  args_.fibre = fibre_.data();
  args_.fibre_axes = fibre_axes_.data();
  args_.prony_gains = prony_gains_.data();
  args_.prony_keep = prony_keep_.data();
  args_.prony_gain = prony_gain_.data();
  args_.slider_scale = slider_.data();
  args_.slider_yield = yield_.data();
  args_.is_anchor = model_->is_anchor.data();
  args_.anchor_limit = anchor_limit_.data();
  args_.adhesion_scale = adhesion_.data();
  args_.adhesion_limit = adhesion_limit_.data();
  args_.film_scale = film_.data();
  args_.film_reach = film_reach_.data();
  args_.drag_scale = drag_.data();
  args_.skin = skin_.data();
  args_.skin_triangles = static_cast<std::int32_t>(skin_.size() / 3);
  for (int lane = 0; lane < lanes; ++lane) set(lane, model_->effects);
}

template <typename Real>
double SolidLaneEffects<Real>::stiffer(int lane) const {
  const EffectValues& v = values(lane);
  const auto modulus = [](const SolidLaw& law) { return law.lambda + law.bulk + law.mu; };
  const SolidLaw law = make_solid_law(model_->material.young_modulus_pa(),
                                      model_->material.poisson_ratio() + v.poisson_change);
  const double material = 1 + make_prony(v, model_->substep()).gains + v.fibre_ratio;
  return std::max(1.0, modulus(law) / modulus(model_->law) * (material + v.slider_ratio) *
                           (1 + std::max(0.0, v.inclusion_change)));
}

template <typename Real>
void SolidLaneEffects<Real>::set(int lane, const EffectValues& v) {
  OMENTUM_CHECK(model_->anchors_fit(v), "anchor compliance {} in a scene of {}",
                v.anchor_compliance, model_->effects.anchor_compliance);
  const auto W = static_cast<std::size_t>(lanes_);
  const auto l = static_cast<std::size_t>(lane);
  values_[l] = v;
  const double young = model_->material.young_modulus_pa();
  const SolidLaw law = make_solid_law(young, model_->material.poisson_ratio() + v.poisson_change);
  mu_[l] = real<Real>(law.mu);
  lambda_[l] = real<Real>(law.lambda);
  alpha_[l] = real<Real>(law.alpha);
  bulk_[l] = real<Real>(law.bulk);
  density_[l] = real<Real>(1 + v.density_change);
  stiffening_[l] = real<Real>(v.stiffening * law.shear);
  softening_[l] = real<Real>(v.softening);
  softening_energy_[l] = real<Real>(0.5 * young * v.softening_strain * v.softening_strain);
  fibre_[l] = real<Real>(v.fibre_ratio * young);
  const trig::SinCos a = trig::sin_cos(v.fibre_angle);
  fibre_axes_[l] = real<Real>(a.cos * a.cos);
  fibre_axes_[W + l] = real<Real>(a.sin * a.sin);
  fibre_axes_[2 * W + l] = real<Real>(a.cos * a.sin);
  const PronyStep prony = make_prony(v, model_->substep());
  prony_gains_[l] = real<Real>(prony.gains);
  for (std::size_t k = 0; k < kMaxBranches; ++k) {
    prony_keep_[k * W + l] = real<Real>(prony.keep[k]);
    prony_gain_[k * W + l] = real<Real>(prony.gain[k]);
  }
  slider_[l] = real<Real>(v.slider_ratio * young);
  yield_[l] = real<Real>(v.slider_yield);
  constexpr double kNever = 1e6;  // [m]
  anchor_limit_[l] = real<Real>(v.anchor_break > 0 ? v.anchor_break : kNever);
  adhesion_[l] = real<Real>(v.adhesion);
  adhesion_limit_[l] = real<Real>(v.adhesion_break);
  film_[l] = real<Real>(v.suction / model_->substep());
  film_reach_[l] = real<Real>(v.suction_reach);
  drag_[l] = real<Real>(0.5 * v.air_drag * kAirDensity);
  set_masks();
  set_map(lane);
  set_anchor(lane);
}

template <typename Real>
void SolidLaneEffects<Real>::set_masks() {
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
  args_.material = args_.stiffening | args_.softening | args_.fibres | args_.slider | args_.prony;
  args_.adhesion = mask([](const EffectValues& v) { return v.adhesion > 0; });
  args_.film = mask([](const EffectValues& v) { return v.suction > 0; });
  args_.drag = mask([](const EffectValues& v) { return v.air_drag > 0; });
  args_.bonds =
      args_.adhesion | mask([this](const EffectValues&) { return model_->effects.moves_anchor(); });
  args_.branches = 0;
  for (const EffectValues& v : values_) {
    args_.branches = std::max(args_.branches, make_prony(v, 1).branches);
  }
  const auto W = static_cast<std::size_t>(lanes_);
  const std::size_t nodes = W * model_->mesh.nodes.size();
  const std::size_t tetrahedra = W * model_->mesh.tetrahedra.size();
  const std::size_t tensors = 24 * tetrahedra;
  if (args_.prony != 0) {
    ensure(stress_, tensors);
    ensure(bias_, tensors);
    ensure(branch_, kMaxBranches * tensors);
  }
  if (args_.slider != 0) ensure(plastic_, tensors);
  if (args_.softening != 0) ensure(energy_peak_, tetrahedra);
  if (args_.bonds != 0) {
    ensure(bond_place_, 3 * nodes);
    ensure(bond_longest_, nodes, Real{-1});
    ensure(bond_fresh_, nodes);
    ensure(bond_now_, nodes);
  }
  if ((args_.adhesion | args_.film | args_.drag) != 0) ensure(area_, 3 * nodes);
  if (args_.film != 0) {
    ensure(film_now_, nodes);
    ensure(film_normal_, 3 * nodes);
  }
  if (args_.drag != 0) ensure(drag_now_, 3 * nodes);
  args_.stress = stress_.data();
  args_.branch = branch_.data();
  args_.bias = bias_.data();
  args_.plastic = plastic_.data();
  args_.energy_peak = energy_peak_.data();
  args_.bond_place = bond_place_.data();
  args_.bond_fresh = bond_fresh_.data();
  args_.bond_longest = bond_longest_.data();
  args_.bond_now = bond_now_.data();
  args_.area = area_.data();
  args_.film_now = film_now_.data();
  args_.film_normal = film_normal_.data();
  args_.drag_now = drag_now_.data();
}

template <typename Real>
void SolidLaneEffects<Real>::set_anchor(int lane) {
  if (!model_->effects.moves_anchor()) return;
  const std::vector<double> spring = model_->make_anchor(values(lane));
  for (std::size_t i = 0; i < spring.size(); ++i) {
    if (model_->is_anchor[i] == 0) continue;
    const auto k = i * static_cast<std::size_t>(lanes_) + static_cast<std::size_t>(lane);
    bond_fresh_[k] = real<Real>(spring[i]);
  }
}

/// Stiffness at the integration points, where some lane has an inclusion.
template <typename Real>
void SolidLaneEffects<Real>::set_map(int lane) {
  const bool any = std::any_of(values_.begin(), values_.end(),
                               [](const EffectValues& v) { return v.inclusion_change != 0; });
  const auto W = static_cast<std::size_t>(lanes_);
  const std::size_t tetrahedra = model_->mesh.tetrahedra.size();
  if (any && map_.empty()) map_.assign(4 * tetrahedra * W, Real{1});
  args_.map = any ? map_.data() : nullptr;
  for (std::size_t t = 0; t < tetrahedra && any; ++t) {
    for (std::size_t q = 0; q < 4; ++q) {
      const Eigen::Vector3d p_B = model_->integration_point(t, static_cast<int>(q));
      map_[(4 * t + q) * W + static_cast<std::size_t>(lane)] =
          real<Real>(values(lane).stiffness_at(p_B));
    }
  }
}

template <typename Real>
void SolidLaneEffects<Real>::reset(int lane, const Eigen::Vector3d& offset) {
  const auto W = static_cast<std::size_t>(lanes_);
  const auto l = static_cast<std::size_t>(lane);
  for (auto* array :
       {&stress_, &branch_, &bias_, &plastic_, &energy_peak_, &bond_place_, &bond_fresh_}) {
    for (std::size_t k = l; k < array->size(); k += W) (*array)[k] = Real{0};
  }
  for (std::size_t k = l; k < bond_longest_.size(); k += W) bond_longest_[k] = Real{-1};
  set_anchor(lane);
  for (std::size_t i = 0; i < model_->is_anchor.size(); ++i) {
    if (model_->is_anchor[i] == 0) continue;
    const Eigen::Vector3d p = model_->body.X_WB * model_->body.particles[i] + offset;
    for (std::size_t axis = 0; axis < 3; ++axis)
      bond_place_[(3 * i + axis) * W + l] = real<Real>(p[static_cast<Eigen::Index>(axis)]);
    bond_longest_[i * W + l] = Real{0};
  }
}

template <typename Real>
Eigen::Vector3d SolidLaneEffects<Real>::anchor_force(int lane, const Real* x) const {
  const auto W = static_cast<std::size_t>(lanes_);
  const auto l = static_cast<std::size_t>(lane);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < model_->is_anchor.size() && args_.bonds != 0; ++i) {
    if (model_->is_anchor[i] == 0) continue;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::size_t k = (3 * i + axis) * W + l;
      sum[static_cast<Eigen::Index>(axis)] +=
          static_cast<double>(bond_now_[i * W + l] * (x[k] - bond_place_[k]));
    }
  }
  return sum;
}

/// Memory arrays of a lane with these values, in the order of the state.
template <typename Real>
template <typename Function>
void SolidLaneEffects<Real>::for_each_memory(const EffectValues& values, Function&& fn) const {
  const std::size_t nodes = model_->mesh.nodes.size();
  const std::size_t tetrahedra = model_->mesh.tetrahedra.size();
  const auto branches = static_cast<std::size_t>(make_prony(values, 1).branches);
  if (branches > 0) {
    fn(stress_, 24 * tetrahedra);
    fn(branch_, branches * 24 * tetrahedra);
    fn(bias_, 24 * tetrahedra);
  }
  if (values.slider_ratio > 0) fn(plastic_, 24 * tetrahedra);
  if (values.softening > 0) fn(energy_peak_, tetrahedra);
  if (values.adhesion > 0 || model_->effects.moves_anchor()) {
    fn(bond_place_, 3 * nodes);
    fn(bond_fresh_, nodes);
    fn(bond_longest_, nodes);
  }
}

template <typename Real>
void SolidLaneEffects<Real>::save(int lane, Bytes& out) const {
  const auto add = [&out](const void* data, std::size_t size) {
    const auto* bytes = static_cast<const std::byte*>(data);
    out.insert(out.end(), bytes, bytes + size);
  };
  add(&values(lane), sizeof(EffectValues));
  for_each_memory(values(lane), [&](const AlignedVector<Real>& array, std::size_t count) {
    for (std::size_t k = 0; k < count; ++k) {
      add(&array[k * static_cast<std::size_t>(lanes_) + static_cast<std::size_t>(lane)],
          sizeof(Real));
    }
  });
}

template <typename Real>
Result<std::size_t> SolidLaneEffects<Real>::read(std::span<const std::byte> state,
                                                 EffectValues& v) const {
  if (state.size() < sizeof v) return Failure{"tissue state ends in its effects"};
  std::memcpy(static_cast<void*>(&v), state.data(), sizeof v);
  if (!model_->anchors_fit(v) || v == EffectValues{} ||
      !usable(v, model_->material.poisson_ratio(), {})) {
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
void SolidLaneEffects<Real>::load(int lane, std::span<const std::byte> state) {
  const std::byte* next = state.data() + sizeof(EffectValues);
  for_each_memory(values(lane), [&](const AlignedVector<Real>& array, std::size_t count) {
    auto& memory = const_cast<AlignedVector<Real>&>(array);  // NOLINT: of this object
    for (std::size_t k = 0; k < count; ++k, next += sizeof(Real)) {
      std::memcpy(&memory[k * static_cast<std::size_t>(lanes_) + static_cast<std::size_t>(lane)],
                  next, sizeof(Real));
    }
  });
}

template class SolidLaneEffects<float>;
template class SolidLaneEffects<double>;

}  // namespace omentum
