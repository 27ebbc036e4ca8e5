// What a lane of the elastic shell leaves behind: its state as bytes, and back.
#include <fmt/format.h>

#include <array>
#include <cmath>
#include <cstring>

#include "core/hash.h"
#include "sim_worker/shell/shell_tissue.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// What comes after the fixed part of a state.
constexpr std::uint32_t kGraspFollows = 1;
constexpr std::uint32_t kEffectsFollow = 2;

}  // namespace

// Positions, velocities, history of BDF2, contact forces, force on the tool, the lane parameters
// and a word that says which of the rest follows: the grasp (its disc and targets), the effects
// (slip, values, memory). What results from these (factor, response of the patch) is made again.
template <typename Real>
void ShellTissue<Real>::save(int lane, Bytes& out) const {
  const auto add = [&out](const void* data, std::size_t size) {
    const auto* bytes = static_cast<const std::byte*>(data);
    out.insert(out.end(), bytes, bytes + size);
  };
  for (const auto* values : {&x_, &v_, &v_old_, &d_old_, &contact_force_, &held_force_}) {
    for (std::size_t k = static_cast<std::size_t>(lane); k < values->size();
         k += static_cast<std::size_t>(lanes())) {
      add(&(*values)[k], sizeof(Real));
    }
  }
  const LaneParameters& p = parameters_[static_cast<std::size_t>(lane)];
  for (const double value :
       {p.stiffness_scale, p.gravity_scale, p.damping_scale, p.friction_scale}) {
    add(&value, sizeof value);
  }
  const Held& held = held_[static_cast<std::size_t>(lane)];
  const std::uint32_t word = (held.radius > 0 ? kGraspFollows : 0) |
                             (effects_.values(lane) == EffectValues{} ? 0 : kEffectsFollow);
  add(&word, sizeof word);
  if (held.radius > 0) {
    const std::array<double, 4> disc = {held.centre.x(), held.centre.y(), held.centre.z(),
                                        held.radius};
    add(disc.data(), sizeof disc);
    add(held.target.data(), sizeof held.target);
  }
  if (!(effects_.values(lane) == EffectValues{})) {
    add(&slipped_[static_cast<std::size_t>(lane)], sizeof(double));
    effects_.save(lane, out);
  }
}

/// The grasp that a state begins with.
template <typename Real>
Result<typename ShellTissue<Real>::Held> ShellTissue<Real>::read_grasp(
    std::span<const std::byte> state) const {
  if (state.size() < kGraspSize) return Failure{"tissue state ends in its grasp"};
  std::array<double, 4> disc{};
  Held held;
  std::memcpy(disc.data(), state.data(), sizeof disc);
  std::memcpy(held.target.data(), state.data() + sizeof disc, sizeof held.target);
  held.centre = {disc[0], disc[1], disc[2]};
  held.radius = disc[3];
  if (!held.target.allFinite()) return Failure{"tissue state holds a grasp that is not finite"};
  if (model_->can_hold(held.centre, held.radius))
    held.patch = model_->make_patch(held.centre, held.radius);
  if (held.patch.node.empty()) {
    return Failure{fmt::format("tissue state holds a patch at ({}, {}, {}) m of radius {} m",
                               disc[0], disc[1], disc[2], disc[3])};
  }
  return held;
}

template <typename Real>
Result<std::size_t> ShellTissue<Real>::load(int lane, std::span<const std::byte> state) {
  const std::array<AlignedVector<Real>*, 6> arrays = {
      &x_, &v_, &v_old_, &d_old_, &contact_force_, &held_force_};
  std::size_t reals = 0;
  for (const auto* a : arrays) reals += a->size() / static_cast<std::size_t>(lanes());
  std::array<double, 4> scales{};
  std::uint32_t word = 0;
  const std::size_t fixed_size = reals * sizeof(Real) + sizeof scales + sizeof word;
  if (state.size() < fixed_size) {
    return Failure{
        fmt::format("tissue state of {} bytes, needed at least {}", state.size(), fixed_size)};
  }
  std::vector<Real> values(reals);
  std::memcpy(values.data(), state.data(), reals * sizeof(Real));
  std::memcpy(scales.data(), state.data() + reals * sizeof(Real), sizeof scales);
  std::memcpy(&word, state.data() + fixed_size - sizeof word, sizeof word);
  if ((word & ~(kGraspFollows | kEffectsFollow)) != 0) {
    return Failure{fmt::format("tissue state with flags {:#x}, allowed 0 ... 3", word)};
  }
  const bool has_effects = (word & kEffectsFollow) != 0;
  for (const Real v : values) {
    if (!std::isfinite(v)) return Failure{"tissue state holds a non-finite number"};
  }
  LaneParameters parameters{scales[0], scales[1], scales[2], scales[3], EffectValues{}};
  if (!usable(parameters)) return Failure{"tissue state holds lane parameters out of range"};
  std::size_t used = fixed_size;
  Held held;
  if ((word & kGraspFollows) != 0) {
    Result<Held> read = read_grasp(state.subspan(used));
    if (!read) return Failure{read.error()};
    held = std::move(read).value();
    used += kGraspSize;
  }
  double slipped = 0;
  std::span<const std::byte> of_effects;
  if (has_effects) {
    if (state.size() < used + sizeof slipped) return Failure{"tissue state ends in its effects"};
    std::memcpy(&slipped, state.data() + used, sizeof slipped);
    if (!(slipped >= 0 && slipped <= 1)) return Failure{"tissue state holds a bad slip"};
    used += sizeof slipped;
    of_effects = state.subspan(used);
    const Result<std::size_t> read = effects_.read(of_effects, *parameters.effects);
    if (!read) return Failure{read.error()};
    used += read.value();
  } else if (model_->effects.moves_anchor()) {
    return Failure{"tissue state without the effects of the anchor"};
  }

  release(lane);
  std::size_t next = 0;
  for (auto* a : arrays) {
    for (std::size_t k = static_cast<std::size_t>(lane); k < a->size();
         k += static_cast<std::size_t>(lanes())) {
      (*a)[k] = values[next++];
    }
  }
  effects_.reset(lane, Vector3d::Zero());
  set_parameters(lane, parameters);
  if (held.radius > 0) grip(lane, std::move(held));
  slipped_[static_cast<std::size_t>(lane)] = slipped;
  if (has_effects) effects_.load(lane, of_effects);
  return used;
}

template <typename Real>
std::uint64_t ShellTissue<Real>::hash(int lane) const {
  Bytes bytes;
  save(lane, bytes);
  return fnv1a64(bytes);
}

#define OMENTUM_INSTANTIATE(Real)                                                        \
  template void ShellTissue<Real>::save(int, Bytes&) const;                              \
  template Result<ShellTissue<Real>::Held> ShellTissue<Real>::read_grasp(                \
      std::span<const std::byte>) const;                                                 \
  template Result<std::size_t> ShellTissue<Real>::load(int, std::span<const std::byte>); \
  template std::uint64_t ShellTissue<Real>::hash(int) const
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
