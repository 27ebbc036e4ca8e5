#include "sim_worker/tissue/lane_effects.h"

#include <algorithm>

#include "core/check.h"
#include "core/constants.h"
#include "core/trig.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

constexpr double kNever = 1e6;  // [m] stretch of a spring that does not break

}  // namespace

template <typename Real>
LaneEffects<Real>::LaneEffects(const TissueBody& body, const EffectValues& scene,
                               const std::vector<std::uint8_t>& is_anchor, Layout layout, int lanes)
    : body_(body),
      scene_(scene),
      is_anchor_(is_anchor),
      layout_(layout),
      lanes_(lanes),
      values_(lanes) {
  const auto per_lane = [lanes](LaneArray<Real>& array, int items = 1) {
    return array.assign(items, 1, lanes);
  };
  common_.density = per_lane(density_);
  common_.stiffening_scale = per_lane(stiffening_);
  common_.softening_share = per_lane(softening_);
  common_.softening_energy = per_lane(softening_energy_);
  common_.fibre = per_lane(fibre_);
  common_.fibre_axes = per_lane(fibre_axes_, 3);
  common_.prony_gains = per_lane(prony_gains_);
  common_.prony_keep = per_lane(prony_keep_, kMaxBranches);
  common_.prony_gain = per_lane(prony_gain_, kMaxBranches);
  common_.slider_scale = per_lane(slider_);
  common_.slider_yield = per_lane(yield_);
  common_.is_anchor = is_anchor_.data();
  common_.anchor_limit = per_lane(anchor_limit_);
  common_.adhesion_scale = per_lane(adhesion_);
  common_.adhesion_limit = per_lane(adhesion_limit_);
  common_.lubrication_scale = per_lane(lubrication_);
  common_.lubrication_reach = per_lane(lubrication_reach_);
  common_.drag_scale = per_lane(drag_);
}

template <typename Real>
void LaneEffects<Real>::set_common(int lane, const EffectValues& v, double substep,
                                   const Scales& scales) {
  OMENTUM_CHECK(anchors_fit(scene_, v), "anchor compliance {} in a scene of {}",
                v.anchor_compliance, scene_.anchor_compliance);
  const auto real = [](double x) { return static_cast<Real>(x); };
  values_[lane] = v;
  density_[lane] = real(1 + v.density_change);
  stiffening_[lane] = real(scales.stiffening);
  softening_[lane] = real(v.softening);
  softening_energy_[lane] = real(scales.softening_energy);
  fibre_[lane] = real(scales.fibre);
  const trig::SinCos a = trig::sin_cos(v.fibre_angle);
  fibre_axes_(0, lane) = real(a.cos * a.cos);
  fibre_axes_(1, lane) = real(a.sin * a.sin);
  fibre_axes_(2, lane) = real(a.cos * a.sin);
  const PronyStep prony = make_prony(v, substep);
  prony_gains_[lane] = real(prony.gains);
  for (int k = 0; k < kMaxBranches; ++k) {
    prony_keep_(k, lane) = real(prony.keep[k]);
    prony_gain_(k, lane) = real(prony.gain[k]);
  }
  slider_[lane] = real(scales.slider);
  yield_[lane] = real(v.slider_yield);
  anchor_limit_[lane] = real(v.anchor_break > 0 ? v.anchor_break : kNever);
  adhesion_[lane] = real(v.adhesion);
  adhesion_limit_[lane] = real(v.adhesion_break);
  lubrication_[lane] = real(v.suction / substep);
  lubrication_reach_[lane] = real(v.suction_reach);
  drag_[lane] = real(0.5 * v.air_drag * kAirDensity);

  common_.stiffening = lanes_where([](const EffectValues& e) { return e.stiffening != 0; });
  common_.softening = lanes_where([](const EffectValues& e) { return e.softening > 0; });
  common_.fibres = lanes_where([](const EffectValues& e) { return e.fibre_ratio > 0; });
  common_.slider = lanes_where([](const EffectValues& e) { return e.slider_ratio > 0; });
  common_.prony = lanes_where([](const EffectValues& e) { return prony_branches(e) > 0; });
  common_.drag = lanes_where([](const EffectValues& e) { return e.air_drag > 0; });
  common_.adhesion = lanes_where([](const EffectValues& e) { return e.adhesion > 0; });
  common_.lubrication = lanes_where([](const EffectValues& e) { return e.suction > 0; });
  common_.bonds =
      common_.adhesion | lanes_where([this](const EffectValues&) { return scene_.moves_anchor(); });
  common_.branches = 0;
  for (const EffectValues& e : values_)
    common_.branches = std::max(common_.branches, prony_branches(e));
  make_memory();
}

template <typename Real>
void LaneEffects<Real>::make_memory() {
  const auto& [elements, components, energies, nodes] = layout_;
  if (common_.prony != 0) {
    common_.stress = stress_.ensure(elements, components, lanes_);
    common_.bias = bias_.ensure(elements, components, lanes_);
    common_.branch = branch_.ensure(kMaxBranches * elements, components, lanes_);
  }
  if (common_.slider != 0) common_.plastic = plastic_.ensure(elements, components, lanes_);
  if (common_.softening != 0) common_.energy_peak = energy_peak_.ensure(energies, 1, lanes_);
  if (common_.bonds != 0) {
    common_.bond_place = bond_place_.ensure(nodes, 3, lanes_);
    common_.bond_longest = bond_longest_.ensure(nodes, 1, lanes_, Real{-1});
  }
  if (common_.lubrication != 0) {
    common_.lubrication_now = lubrication_now_.ensure(nodes, 1, lanes_);
    common_.lubrication_normal = lubrication_normal_.ensure(nodes, 3, lanes_);
  }
}

template <typename Real>
void LaneEffects<Real>::reset_common(int lane, const Eigen::Vector3d& offset) {
  for (auto* array : {&stress_, &branch_, &bias_, &plastic_, &energy_peak_, &bond_place_})
    array->fill_lane(lane, Real{0});
  bond_longest_.fill_lane(lane, Real{-1});
  for (int i = 0; i < layout_.nodes && common_.bonds != 0; ++i) {
    if (is_anchor_[i] == 0) continue;
    bond_place_.set_vector(i, lane, body_.X_WB * body_.particles[i] + offset);
    bond_longest_(i, lane) = Real{0};
  }
}

template <typename Real>
std::vector<typename LaneEffects<Real>::Memory> LaneEffects<Real>::memory_of(
    const EffectValues& v) const {
  std::vector<Memory> memory;
  const int stresses = layout_.elements * layout_.components;
  const int branches = prony_branches(v);
  if (branches > 0) {
    memory.push_back({&stress_, stresses});
    memory.push_back({&branch_, branches * stresses});
    memory.push_back({&bias_, stresses});
  }
  if (v.slider_ratio > 0) memory.push_back({&plastic_, stresses});
  if (v.softening > 0) memory.push_back({&energy_peak_, layout_.energies});
  if (v.adhesion > 0 || scene_.moves_anchor()) {
    memory.push_back({&bond_place_, 3 * layout_.nodes});
    memory.push_back({&bond_longest_, layout_.nodes});
  }
  return memory;
}

template <typename Real>
void LaneEffects<Real>::save(int lane, StateWriter& state) const {
  for (const auto& [array, count] : memory_of(values(lane))) {
    for (int k = 0; k < count; ++k) state.add(array->lane_value(k, lane));
  }
}

template <typename Real>
Result<std::vector<Real>> LaneEffects<Real>::read(const EffectValues& values,
                                                  StateReader& state) const {
  std::size_t count = 0;
  for (const Memory& memory : memory_of(values)) count += static_cast<std::size_t>(memory.count);
  if (!state.has(count, sizeof(Real)))
    return Failure{"tissue state ends in the memory of its effects"};
  std::vector<Real> numbers(count);
  OMENTUM_CHECK(state.read_all(std::span(numbers)));
  if (!all_finite(std::span<const Real>(numbers)))
    return Failure{"tissue state holds a non-finite memory of an effect"};
  return numbers;
}

template <typename Real>
void LaneEffects<Real>::load(int lane, std::span<const Real> memory) {
  std::size_t next = 0;
  for (const auto& [array, count] : memory_of(values(lane))) {
    auto& mine = const_cast<LaneArray<Real>&>(*array);  // NOLINT: of this object
    for (int k = 0; k < count; ++k) mine.lane_value(k, lane) = memory[next++];
  }
}

template class LaneEffects<float>;
template class LaneEffects<double>;

}  // namespace omentum
