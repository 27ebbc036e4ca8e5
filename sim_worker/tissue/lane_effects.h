#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <vector>

#include "core/result.h"
#include "sim_worker/lanes/lane_array.h"
#include "sim_worker/lanes/lane_effect_args.h"
#include "sim_worker/tissue/effect_catalogue.h"
#include "sim_worker/tissue/state_bytes.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// Effects of the lanes of clusters, a shell or a solid, as far as they share them: parameters and
/// memory in the layout of the lane kernels. Memory is made when the first lane needs it. One
/// thread at a time.
template <typename Real>
class LaneEffects {
 public:
  const EffectValues& values(int lane) const { return values_[lane]; }

  void stop_clock(int lane, bool stopped);

  /// The memory of a lane's effects in its saved state. Two halves, so that nothing changes before
  /// all is known to be sound: read() checks, load() takes over after the lane was given the values
  /// that read() was.
  void save(int lane, StateWriter& state) const;
  Result<std::vector<Real>> read(const EffectValues& values, StateReader& state) const;
  void load(int lane, std::span<const Real> memory);

 protected:
  /// What a material has its stress in.
  struct Layout {
    int elements = 0, components = 0;
    int energies = 0;  ///< triangles or tetrahedra
    int nodes = 0;
  };
  /// Of the parameters of a lane, in the units of the model's stress and energy.
  struct Scales {
    double stiffening = 0, exponential = 0, softening_energy = 0, fibre = 0, slider = 0;
  };
  /// What of the body belongs to a node.
  struct NodePart {
    double measure = 0;       ///< area or mass, up to a factor
    Eigen::AlignedBox2d box;  ///< about where it lies, x_B, y_B [m]
  };
  /// Memory of an effect: the first `count` numbers of a lane.
  struct Memory {
    const LaneArray<Real>* array = nullptr;
    int count = 0;
  };

  /// `scene` are the effects of the scene; the references must outlive the object.
  LaneEffects(const TissueBody& body, const EffectValues& scene,
              const std::vector<std::uint8_t>& is_anchor, Layout layout,
              std::vector<NodePart> parts, int lanes);
  ~LaneEffects() = default;

  /// Parameters and masks; makes what memory they need.
  void set_common(int lane, const EffectValues& values, double substep, const Scales& scales);
  /// Memory of a body that never moved, its rest shape shifted by `offset` [m].
  void reset_common(int lane, const Eigen::Vector3d& offset);
  /// All memory of a lane with these values, in the order of its state.
  virtual std::vector<Memory> memory_of(const EffectValues& values) const;
  /// Lanes whose values are such.
  template <typename Function>
  std::uint32_t lanes_where(Function&& on) const {
    std::uint32_t mask = 0;
    for (int lane = 0; lane < lanes_; ++lane) mask |= on(values(lane)) ? 1U << lane : 0U;
    return mask;
  }

  LaneEffectArgs<Real> common_{};  ///< for the kernel; changes with set_common()
  const TissueBody& body_;
  const EffectValues& scene_;
  const std::vector<std::uint8_t>& is_anchor_;
  const Layout layout_;
  const int lanes_;
  LaneArray<Real> stress_, branch_, bias_, plastic_, energy_peak_, bond_place_, bond_longest_,
      push_left_;

 private:
  void make_memory();
  void place_adhesion();
  void place_pull();

  std::vector<NodePart> parts_;  ///< per node
  std::vector<EffectValues> values_;
  std::vector<double> push_step_;  ///< per lane: what a substep leaves of the push
  std::vector<std::int32_t> pull_node_, pull_index_;
  LaneArray<Real> density_, stiffening_, exponential_, exponential_rate_, adhesion_part_,
      pull_share_, pull_place_, pull_stiffness_, pull_slack_, pull_damper_, push_, push_keep_,
      softening_, softening_energy_, fibre_, fibre_axes_, prony_gains_, prony_keep_, prony_gain_,
      slider_, yield_, anchor_limit_, adhesion_, adhesion_limit_, lubrication_, lubrication_reach_,
      drag_, lubrication_now_, lubrication_normal_;
};

extern template class LaneEffects<float>;
extern template class LaneEffects<double>;

}  // namespace omentum
