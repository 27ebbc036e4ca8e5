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
                               const std::vector<std::uint8_t>& is_anchor, Layout layout,
                               std::vector<NodePart> parts, int lanes)
    : body_(body),
      scene_(scene),
      is_anchor_(is_anchor),
      layout_(layout),
      lanes_(lanes),
      parts_(std::move(parts)),
      values_(lanes),
      push_step_(lanes, 1) {
  const auto per_lane = [lanes](LaneArray<Real>& array, int items = 1) {
    return array.assign(items, 1, lanes);
  };
  common_.density = per_lane(density_);
  common_.stiffening_scale = per_lane(stiffening_);
  common_.exponential_scale = per_lane(exponential_);
  common_.exponential_rate = per_lane(exponential_rate_);
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
  common_.pull_stiffness = per_lane(pull_stiffness_);
  common_.pull_slack = per_lane(pull_slack_);
  common_.pull_damper = per_lane(pull_damper_);
  common_.push = per_lane(push_, 3);
  common_.push_keep = per_lane(push_keep_);
  common_.push_left = push_left_.assign(1, 1, lanes, Real{1});
}

template <typename Real>
void LaneEffects<Real>::set_common(int lane, const EffectValues& v, double substep,
                                   const Scales& scales) {
  OMENTUM_CHECK(anchors_fit(scene_, v), "anchor compliance {} in a scene of {}",
                v.anchor_compliance, scene_.anchor_compliance);
  OMENTUM_CHECK(v.added_mass == scene_.added_mass, "added mass {} kg in a scene of {}",
                v.added_mass, scene_.added_mass);
  const auto real = [](double x) { return static_cast<Real>(x); };
  values_[lane] = v;
  density_[lane] = real(1 + v.density_change);
  stiffening_[lane] = real(scales.stiffening);
  exponential_[lane] = real(v.exponential > 0 ? scales.exponential : 0);
  exponential_rate_[lane] = real(v.exponential);
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
  pull_stiffness_[lane] = real(v.pull * v.pull_stiffness);
  pull_slack_[lane] = real(v.pull_slack);
  pull_damper_[lane] = real(v.pull * v.pull_damper / substep);
  for (const auto& [axis, force] : {std::pair{0, v.push_x}, {1, v.push_y}, {2, v.push_z}})
    push_(axis, lane) = real(v.pull * force);
  push_step_[lane] = v.push_decay > 0 ? trig::decay(substep / v.push_decay) : 1;
  push_keep_[lane] = real(push_step_[lane]);

  common_.stiffening = lanes_where([](const EffectValues& e) { return e.stiffens(); });
  common_.exponential = lanes_where([](const EffectValues& e) { return e.exponential > 0; });
  common_.pull = lanes_where([](const EffectValues& e) { return e.pull > 0; });
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
  place_adhesion();
  place_pull();
}

template <typename Real>
void LaneEffects<Real>::stop_clock(int lane, bool stopped) {
  push_keep_[lane] = stopped ? Real{1} : static_cast<Real>(push_step_[lane]);
}

/// Shares of the nodes that stick, where some lane sticks on a place only.
template <typename Real>
void LaneEffects<Real>::place_adhesion() {
  const bool some = lanes_where([](const EffectValues& e) {
                      return e.adhesion > 0 && !e.sticks_everywhere();
                    }) != 0;
  common_.adhesion_part =
      some ? adhesion_part_.ensure(static_cast<int>(parts_.size()), 1, lanes_) : nullptr;
  for (std::size_t i = 0; i < parts_.size() && some; ++i) {
    for (int lane = 0; lane < lanes_; ++lane) {
      adhesion_part_(static_cast<int>(i), lane) =
          static_cast<Real>(sticking_share(values(lane), parts_[i].box));
    }
  }
}

/// Nodes of the local forces, their shares and where their strings are made fast.
template <typename Real>
void LaneEffects<Real>::place_pull() {
  common_.pull_nodes = 0;
  if (common_.pull == 0) return;
  std::vector<double> measure;
  for (const NodePart& part : parts_) measure.push_back(part.measure);
  const std::span<const Eigen::Vector3d> nodes(body_.particles);
  std::vector<std::vector<double>> share(lanes_);
  for (int lane = 0; lane < lanes_; ++lane) {
    const EffectValues& v = values(lane);
    if (v.pull > 0) share[lane] = disc_shares(nodes, measure, {v.pull_x, v.pull_y}, v.pull_radius);
  }
  pull_node_.clear();
  pull_index_.assign(parts_.size(), -1);
  for (std::size_t i = 0; i < parts_.size(); ++i) {
    if (std::ranges::none_of(share, [i](const auto& s) { return !s.empty() && s[i] > 0; }))
      continue;
    pull_index_[i] = static_cast<std::int32_t>(pull_node_.size());
    pull_node_.push_back(static_cast<std::int32_t>(i));
  }
  common_.pull_index = pull_index_.data();
  const auto count = static_cast<int>(pull_node_.size());
  common_.pull_nodes = count;
  common_.pull_node = pull_node_.data();
  common_.pull_share = pull_share_.assign(count, 1, lanes_);
  common_.pull_place = pull_place_.assign(count, 3, lanes_);
  for (int lane = 0; lane < lanes_; ++lane) {
    const EffectValues& v = values(lane);
    const Eigen::Vector3d anchor(v.pull_anchor_x, v.pull_anchor_y, v.pull_anchor_z);
    for (int k = 0; k < count && !share[lane].empty(); ++k) {
      const std::int32_t i = pull_node_[k];
      const Eigen::Vector3d from_centre = nodes[i] - Eigen::Vector3d(v.pull_x, v.pull_y, 0);
      pull_share_(k, lane) = static_cast<Real>(share[lane][i]);
      pull_place_.set_vector(k, lane, anchor + body_.X_WB.linear() * from_centre);
    }
  }
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
  push_left_[lane] = Real{1};
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
  if (v.pull > 0) memory.push_back({&push_left_, 1});
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
