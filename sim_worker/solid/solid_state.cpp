// The elastic solid: its state as bytes.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "sim_worker/solid/solid_tissue.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Of parameters in a state, on the scene's: usable(LaneParameters); friction times 1 + 20 of the
// effect friction_change.
constexpr double kMaxGravityScale = 100;
constexpr double kMaxFrictionScale = 21e3;
constexpr double kRounding = 1e-5;                  // of f32, several operations deep
constexpr std::uint32_t kEffectsFollow = 1U << 31;  // beside the number of held nodes

}  // namespace

// State of a lane: positions, velocities, history of BDF2, contact forces, force on the tool, the
// lane parameters, then the grasp: a word with the number of its nodes and whether effects follow,
// and the nodes. With effects the way of the patch out of the jaws and from them, and the rest that
// is theirs.
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
  const bool has_effects = !(effects_.values(lane) == EffectValues{});
  const std::uint32_t word = count | (has_effects ? kEffectsFollow : 0);
  add(&word, sizeof word);
  add(held.nodes.data(), count * sizeof(std::int32_t));
  add(held.offsets.data(), count * sizeof(held.offsets[0]));
  add(held.weights.data(), count * sizeof(Real));
  if (!has_effects) return;
  add(&held.slipped, sizeof held.slipped);
  add(&held.give, sizeof held.give);
  effects_.save(lane, out);
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
  return usable(scales) &&
         pull <= kMaxGravityScale * model_->surroundings.gravity.norm() * (1 + kRounding) &&
         value(4) >= 0 && value(4) <= 1 && rubs(value(5), model_->surroundings.static_friction) &&
         rubs(value(6), model_->surroundings.dynamic_friction);
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
  const bool has_effects = (count & kEffectsFollow) != 0;
  count &= ~kEffectsFollow;
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
  EffectValues effects;
  std::size_t used = fixed_size + count * entry;
  std::span<const std::byte> of_effects = state.subspan(used);
  if (has_effects) {
    const std::size_t of_grasp = sizeof held.slipped + sizeof held.give;
    if (of_effects.size() < of_grasp) return Failure{"tissue state ends in its effects"};
    std::memcpy(&held.slipped, of_effects.data(), sizeof held.slipped);
    std::memcpy(&held.give, of_effects.data() + sizeof held.slipped, sizeof held.give);
    const bool gives = std::all_of(held.give.begin(), held.give.end(),
                                   [](Real g) { return std::fabs(g) <= Real{1}; });
    if (!gives || !(held.slipped >= 0 && held.slipped <= 1)) {
      return Failure{"tissue state holds a patch that is not in its jaws"};
    }
    of_effects = of_effects.subspan(of_grasp);
    const Result<std::size_t> read = effects_.read(of_effects, effects);
    if (!read) return Failure{read.error()};
    used += of_grasp + read.value();
  } else if (model_->effects.moves_anchor()) {
    return Failure{"tissue state without the effects of the anchor"};
  }

  release(lane);
  effects_.reset(lane, Vector3d::Zero());
  set_effects(lane, effects);
  if (has_effects) effects_.load(lane, of_effects);
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
  return used;
}

#define OMENTUM_INSTANTIATE(Real)                                                  \
  template bool SolidTissue<Real>::usable_parameters(std::span<const Real>) const; \
  template void SolidTissue<Real>::save(int, Bytes&) const;                        \
  template Result<std::size_t> SolidTissue<Real>::load(int, std::span<const std::byte>)
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
