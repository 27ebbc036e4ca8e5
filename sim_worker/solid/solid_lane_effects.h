#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "core/aligned.h"
#include "core/result.h"
#include "core/types.h"
#include "sim_worker/solid/solid_effects.h"
#include "sim_worker/solid/solid_model.h"

namespace omentum {

/// Effects of the lanes of one elastic solid: parameters and memory in the layout of the lane
/// kernel. Memory is made when the first lane needs it. One thread at a time.
template <typename Real>
class SolidLaneEffects {
 public:
  SolidLaneEffects(std::shared_ptr<const SolidTissueModel> model, int lanes);

  /// For the kernel; valid until the next call of set().
  const SolidEffectArgs<Real>& args() const { return args_; }
  const EffectValues& values(int lane) const { return values_[static_cast<std::size_t>(lane)]; }
  /// How many times stiffer than model.law the effects of a lane make the material at most, 1 or
  /// more.
  double stiffer(int lane) const;

  void set(int lane, const EffectValues& values);
  /// Memory of a body that never moved, its rest shape shifted by `offset` [m].
  void reset(int lane, const Eigen::Vector3d& offset);
  /// Whether some effect is more than a number: the kernel has to start and to remember it.
  bool on_nodes() const { return (args_.bonds | args_.film | args_.drag) != 0; }
  bool remembers() const {
    return (args_.prony | args_.slider | args_.softening | args_.bonds) != 0;
  }
  /// Force of the body on its anchor springs at its present places x [node][xyz][lane], in W [N].
  Eigen::Vector3d anchor_force(int lane, const Real* x) const;

  /// Values, then the memory of those that have one.
  void save(int lane, Bytes& out) const;
  /// Two halves, so that nothing changes before all is known to be sound: read() checks and gives
  /// the values and the number of bytes; load() takes them over.
  Result<std::size_t> read(std::span<const std::byte> state, EffectValues& values) const;
  void load(int lane, std::span<const std::byte> state);

 private:
  template <typename Function>
  void for_each_memory(const EffectValues& values, Function&& fn) const;
  void set_masks();
  void set_map(int lane);
  void set_anchor(int lane);

  std::shared_ptr<const SolidTissueModel> model_;
  int lanes_;
  SolidEffectArgs<Real> args_{};
  std::vector<EffectValues> values_;
  std::vector<std::int32_t> skin_;
  AlignedVector<Real> mu_, lambda_, alpha_, bulk_, density_, map_;
  AlignedVector<Real> stiffening_, softening_, softening_energy_, fibre_, fibre_axes_, prony_gains_,
      prony_keep_, prony_gain_, slider_, yield_, anchor_limit_, adhesion_, adhesion_limit_, film_,
      film_reach_, drag_;
  AlignedVector<Real> stress_, branch_, bias_, plastic_, energy_peak_, bond_place_, bond_fresh_,
      bond_longest_, bond_now_, area_, film_now_, film_normal_, drag_now_;
};

extern template class SolidLaneEffects<float>;
extern template class SolidLaneEffects<double>;

}  // namespace omentum
