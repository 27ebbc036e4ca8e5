// The elastic solid: its state as bytes.
#include <array>
#include <cmath>
#include <cstring>

#include "sim_worker/solid_tissue.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Of parameters in a state, on the scene's: usable(LaneParameters); friction times 1 + 20 of the
// effect friction_change.
constexpr double kMaxGravityScale = 100;
constexpr double kMaxFrictionScale = 21e3;
constexpr double kRounding = 1e-5;  // of f32, several operations deep

}  // namespace

// State of a lane: positions, velocities, history of BDF2, contact forces, force on the tool, the
// lane parameters, then the grasp.
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
  add(&count, sizeof count);
  add(held.nodes.data(), count * sizeof(std::int32_t));
  add(held.offsets.data(), count * sizeof(held.offsets[0]));
  add(held.weights.data(), count * sizeof(Real));
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
  return usable(scales) && pull <= kMaxGravityScale * model_->gravity.norm() * (1 + kRounding) &&
         value(4) >= 0 && value(4) <= 1 && rubs(value(5), model_->static_friction) &&
         rubs(value(6), model_->dynamic_friction);
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

  release(lane);
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
  return fixed_size + count * entry;
}

#define OMENTUM_INSTANTIATE(Real)                                                  \
  template bool SolidTissue<Real>::usable_parameters(std::span<const Real>) const; \
  template void SolidTissue<Real>::save(int, Bytes&) const;                        \
  template Result<std::size_t> SolidTissue<Real>::load(int, std::span<const std::byte>)
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
