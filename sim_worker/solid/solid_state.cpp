// The elastic solid: its state as bytes. The grasp is the number of its nodes, these, where they
// are from the tip, what part of them is covered, and how far the patch is from where rigid jaws
// have it.
#include <algorithm>
#include <cmath>

#include "sim_worker/solid/solid_tissue.h"

namespace omentum {

using Eigen::Vector3d;

template <typename Real>
bool SolidTissue<Real>::allows(const EffectValues& effects) const {
  return anchors_fit(model_->effects, effects) &&
         baked_fit(model_->effects, effects, kSolidModel) &&
         usable(effects, model_->material.poisson_ratio(), {});
}

template <typename Real>
void SolidTissue<Real>::save(int lane, Bytes& out) const {
  StateWriter state(out);
  const Held& held = held_[lane];
  this->save_lane(lane, !held.nodes.empty(), state);
  if (!held.nodes.empty()) {
    state.add(static_cast<std::uint32_t>(held.nodes.size()));
    state.add_all(std::span<const std::int32_t>(held.nodes));
    state.add_all(std::span<const std::array<Real, 3>>(held.offsets));
    state.add_all(std::span<const Real>(held.weights));
    state.add(held.deflection);
  }
  effects_.save(lane, state);
}

template <typename Real>
Result<typename SolidTissue<Real>::Held> SolidTissue<Real>::read_grasp(StateReader& state) const {
  Held held;
  std::uint32_t count = 0;
  if (!state.read(count) || count == 0 || count > static_cast<std::uint32_t>(particles()))
    return Failure{fmt::format("tissue state with {} held nodes of {}", count, particles())};
  held.nodes.resize(count);
  held.offsets.resize(count);
  held.weights.resize(count);
  if (!state.read_all(std::span(held.nodes)) || !state.read_all(std::span(held.offsets)) ||
      !state.read_all(std::span(held.weights)) || !state.read(held.deflection))
    return Failure{"tissue state ends in its grasp"};
  for (std::size_t k = 0; k < count; ++k) {
    const std::int32_t i = held.nodes[k];
    if (i < 0 || i >= particles() || this->is_fixed(i) || (k > 0 && i <= held.nodes[k - 1])) {
      return Failure{fmt::format(
          "tissue state holds node {}, not a free one of {} in ascending order", i, particles())};
    }
    if (!(held.weights[k] > Real{0} && held.weights[k] <= Real{1}) ||
        !all_finite(std::span<const Real>(held.offsets[k])))
      return Failure{fmt::format("tissue state holds node {} with a bad weight or offset", i)};
  }
  const bool in_jaws = std::all_of(held.deflection.begin(), held.deflection.end(),
                                   [](Real g) { return std::fabs(g) <= Real{1}; });
  if (!in_jaws) return Failure{"tissue state holds a patch that is not in its jaws"};
  return held;
}

template <typename Real>
Result<std::size_t> SolidTissue<Real>::load(int lane, std::span<const std::byte> bytes) {
  StateReader state(bytes);
  const Result<SavedLane> saved = this->read_lane(state);
  if (!saved) return Failure{saved.error()};
  const LaneParameters& parameters = saved.value().parameters;
  Held held;
  if (saved.value().has_grasp) {
    Result<Held> read = read_grasp(state);
    if (!read) return Failure{read.error()};
    held = std::move(read).value();
  }
  const Result<std::vector<Real>> memory = effects_.read(*parameters.effects, state);
  if (!memory) return Failure{memory.error()};

  release(lane);
  effects_.reset(lane, Vector3d::Zero());
  set_parameters(lane, parameters);
  effects_.load(lane, memory.value());
  this->load_lane(lane, saved.value());
  p_.fill_lane(lane, Real{0});
  for (int i = 0; i < particles(); ++i) {
    if (this->is_fixed(i)) set_position(lane, i, position(lane, i));
  }
  held_[lane] = std::move(held);
  slipped_[lane] = saved.value().slipped;
  apply_hold(lane);
  return state.used();
}

#define OMENTUM_INSTANTIATE(Real)                                                             \
  template bool SolidTissue<Real>::allows(const EffectValues&) const;                         \
  template Result<SolidTissue<Real>::Held> SolidTissue<Real>::read_grasp(StateReader&) const; \
  template void SolidTissue<Real>::save(int, Bytes&) const;                                   \
  template Result<std::size_t> SolidTissue<Real>::load(int, std::span<const std::byte>)
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
