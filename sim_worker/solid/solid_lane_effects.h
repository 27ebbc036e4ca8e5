#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "sim_worker/solid/solid_effects.h"
#include "sim_worker/solid/solid_model.h"
#include "sim_worker/tissue/lane_effects.h"

namespace omentum {

/// Effects of the lanes of one elastic solid; see LaneEffects.
template <typename Real>
class SolidLaneEffects final : public LaneEffects<Real> {
 public:
  SolidLaneEffects(std::shared_ptr<const SolidTissueModel> model, int lanes);

  /// For the kernel; valid until the next call of set().
  const SolidEffectArgs<Real>& args() const { return args_; }
  /// How many times stiffer than model.law the effects of a lane make the material at most, 1 or
  /// more.
  double stiffer(int lane) const;

  void set(int lane, const EffectValues& values);
  /// Memory of a body that never moved, its rest shape shifted by `offset` [m].
  void reset(int lane, const Eigen::Vector3d& offset);
  /// Whether some effect is more than a number: the kernel has to start and to remember it.
  bool on_nodes() const { return (args_.bonds | args_.lubrication | args_.drag) != 0; }
  bool remembers() const {
    return (args_.prony | args_.slider | args_.softening | args_.bonds | args_.pull) != 0;
  }
  /// Force of the body on its anchor springs at its present places x, in W [N].
  Eigen::Vector3d anchor_force(int lane, const LaneArray<Real>& x) const;

 private:
  using Base = LaneEffects<Real>;
  using Base::bond_place_, Base::common_, Base::lanes_;
  using typename Base::Memory;
  using typename Base::NodePart;

  static std::vector<NodePart> node_parts(const SolidTissueModel& model);
  std::vector<Memory> memory_of(const EffectValues& values) const override;
  void make_memory();
  void set_map(int lane);
  void set_anchor(int lane);

  std::shared_ptr<const SolidTissueModel> model_;
  SolidEffectArgs<Real> args_{};
  std::vector<std::int32_t> skin_;
  AlignedVector<Real> added_mass_;
  LaneArray<Real> mu_, lambda_, alpha_, bulk_, map_;
  LaneArray<Real> bond_fresh_, bond_now_, area_, drag_now_;
};

extern template class SolidLaneEffects<float>;
extern template class SolidLaneEffects<double>;

}  // namespace omentum
