#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sim_worker/shell/shell_effects.h"
#include "sim_worker/shell/shell_model.h"
#include "sim_worker/tissue/lane_effects.h"

namespace omentum {

/// Effects of the lanes of one elastic shell; see LaneEffects.
template <typename Real>
class ShellLaneEffects final : public LaneEffects<Real> {
 public:
  ShellLaneEffects(std::shared_ptr<const ShellTissueModel> model, int lanes);

  /// For the kernel; valid until the next call of set().
  const ShellEffectArgs<Real>& args() const { return args_; }
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

 private:
  using Base = LaneEffects<Real>;
  using Base::bond_longest_, Base::common_, Base::lanes_;
  using typename Base::Memory;

  using typename Base::NodePart;
  static std::vector<NodePart> node_parts(const ShellTissueModel& model);
  bool has_stiff_pull(const EffectValues& values) const;
  std::vector<Memory> memory_of(const EffectValues& values) const override;
  bool is_curved(const EffectValues& values) const;
  /// Whether the factor follows the tangent of the law, which is not that at rest.
  bool follows_law() const { return model_->law() != ShellLaw::kCorotated; }
  const ShellStructure& structure_of(int lane) const;
  void make_memory();
  void set_maps();
  void set_rest_moments(int lane);

  std::shared_ptr<const ShellTissueModel> model_;
  ShellEffectArgs<Real> args_{};
  std::vector<double> stiffness_;           ///< E / nominal E
  std::vector<ShellStructure> structures_;  ///< of lanes that differ from the scene's
  std::vector<double> peak_seen_;           ///< that the factor key of each lane is made for

  LaneArray<Real> mass_, plate_, cell_, rest_moment_, shear_, area_, inverse_pitch2_, lateral_,
      anchor_, anchor_turn_;
  AlignedVector<Real> node_area_, added_mass_;
  std::uint32_t stiff_pull_ = 0;  ///< lanes whose local force calls for the solve with springs
  LaneArray<Real> moment_, moment_branch_, moment_bias_, peak_;
  LaneArray<Real> rest_, direction_, preconditioner_direction_, solution_, response_, last_product_;
};

extern template class ShellLaneEffects<float>;
extern template class ShellLaneEffects<double>;

}  // namespace omentum
