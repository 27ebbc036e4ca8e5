#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/aligned.h"
#include "core/result.h"
#include "core/types.h"
#include "sim_worker/shell/shell_effects.h"
#include "sim_worker/shell/shell_model.h"

namespace omentum {

/// Effects of the lanes of one elastic tissue: parameters and memory in the layout of the lane
/// kernel. Memory is made when the first lane needs it. One thread at a time.
template <typename Real>
class ShellLaneEffects {
 public:
  ShellLaneEffects(std::shared_ptr<const ShellTissueModel> model, int lanes);

  /// For the kernel; valid until the next call of set().
  const ShellEffectArgs<Real>& args() const { return args_; }
  const EffectValues& values(int lane) const { return values_[static_cast<std::size_t>(lane)]; }
  /// Factor key of a lane with what its effects add to the stiffness.
  int factor_key(int lane) const;
  /// True where springs to ground call for the solve with springs.
  bool has_springs() const { return args_.springs != 0; }

  void set(int lane, const EffectValues& values, double stiffness_scale);
  /// Memory of a sheet that never moved, its rest shape shifted by `offset` [m].
  void reset(int lane, const Eigen::Vector3d& offset);
  /// Before a substep: which lanes hang on springs; the tangent of the last one may ask for another
  /// factor. Returns the lanes for which factor_key() has changed.
  std::uint32_t begin_substep();

  /// Effects that differ from none, then the memory of those that have one.
  void save(int lane, Bytes& out) const;
  /// Two halves, so that nothing changes before all is known to be sound: read() checks and gives
  /// the values and the number of bytes; load() takes them over, after set().
  Result<std::size_t> read(std::span<const std::byte> state, EffectValues& values) const;
  void load(int lane, std::span<const std::byte> state);

 private:
  template <typename Function>
  void for_each_memory(const EffectValues& values, Function&& fn) const;
  void set_masks();
  void set_maps();
  void set_rest_moments(int lane);
  std::size_t at(int i, int axis, int lane) const {
    return static_cast<std::size_t>((3 * i + axis) * lanes_ + lane);
  }

  std::shared_ptr<const ShellTissueModel> model_;
  int lanes_;
  ShellEffectArgs<Real> args_{};
  std::vector<EffectValues> values_;
  std::vector<double> stiffness_;           ///< E / nominal E
  std::vector<ShellStructure> structures_;  ///< of lanes that differ from the scene's
  std::vector<double> peak_seen_;           ///< that the factor key of each lane is made for

  AlignedVector<Real> mass_, plate_, cell_, rest_moment_;
  AlignedVector<Real> shear_, area_, inverse_pitch2_, density_, stiffening_, lateral_, fibre_,
      fibre_axes_, softening_, softening_energy_, prony_gains_, prony_keep_, prony_gain_, slider_,
      yield_, drag_, adhesion_, adhesion_limit_, anchor_limit_, film_, film_reach_;
  AlignedVector<Real> node_area_, anchor_;
  AlignedVector<Real> stress_, branch_, bias_, plastic_, energy_peak_, moment_, moment_branch_,
      moment_bias_, bond_place_, bond_longest_, film_now_, film_normal_, peak_;
  AlignedVector<Real> rest_, direction_, metric_direction_, solution_, answer_, last_product_;
};

extern template class ShellLaneEffects<float>;
extern template class ShellLaneEffects<double>;

}  // namespace omentum
