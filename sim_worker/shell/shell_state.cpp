// What a lane of the elastic shell leaves behind: its state as bytes, and back. The grasp is its
// disc and targets; what results from these (factor, response of the patch) is made again.
#include <array>
#include <cmath>

#include "sim_worker/shell/shell_tissue.h"

namespace omentum {

using Eigen::Vector3d;

template <typename Real>
bool ShellTissue<Real>::allows(const EffectValues& effects) const {
  return anchors_fit(model_->effects, effects) &&
         baked_fit(model_->effects, effects, kShellModel) &&
         usable(effects, model_->material.poisson_ratio(), body_.particles);
}

template <typename Real>
void ShellTissue<Real>::save(int lane, Bytes& out) const {
  StateWriter state(out);
  const Held& held = held_[lane];
  this->save_lane(lane, held.radius > 0, state);
  if (held.radius > 0) {
    for (const double v : {held.centre.x(), held.centre.y(), held.centre.z(), held.radius})
      state.add(v);
    state.add_all(std::span<const double>(held.target.data(), held.target.size()));
    state.add_all(std::span<const double>(held.arm.data(), held.arm.size()));
  }
  effects_.save(lane, state);
}

template <typename Real>
Result<typename ShellTissue<Real>::Held> ShellTissue<Real>::read_grasp(StateReader& state) const {
  std::array<double, 4> disc{};
  Held held;
  if (!state.read_all(std::span(disc)) ||
      !state.read_all(std::span<double>(held.target.data(), held.target.size())))
    return Failure{"tissue state ends in its grasp"};
  held.centre = {disc[0], disc[1], disc[2]};
  held.radius = disc[3];
  if (!held.target.allFinite()) return Failure{"tissue state holds a grasp that is not finite"};
  if (model_->can_hold(held.centre, held.radius))
    held.patch = model_->make_grip(held.centre, held.radius);
  if (held.patch.node.empty()) {
    return Failure{fmt::format("tissue state holds a patch at ({}, {}, {}) m of radius {} m",
                               disc[0], disc[1], disc[2], disc[3])};
  }
  if (!model_->surroundings.grip.pad) return held;
  held.arm.resize(3, static_cast<Eigen::Index>(held.patch.node.size()));
  if (!state.read_all(std::span<double>(held.arm.data(), held.arm.size())) || !held.arm.allFinite())
    return Failure{"tissue state ends in its pad"};
  return held;
}

template <typename Real>
Result<std::size_t> ShellTissue<Real>::load(int lane, std::span<const std::byte> bytes) {
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
  this->load_lane(lane, saved.value());
  effects_.reset(lane, Vector3d::Zero());
  set_parameters(lane, parameters);
  if (held.radius > 0) grip(lane, std::move(held));
  slipped_[lane] = saved.value().slipped;
  effects_.load(lane, memory.value());
  return state.used();
}

#define OMENTUM_INSTANTIATE(Real)                                                             \
  template bool ShellTissue<Real>::allows(const EffectValues&) const;                         \
  template Result<ShellTissue<Real>::Held> ShellTissue<Real>::read_grasp(StateReader&) const; \
  template void ShellTissue<Real>::save(int, Bytes&) const;                                   \
  template Result<std::size_t> ShellTissue<Real>::load(int, std::span<const std::byte>)
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
