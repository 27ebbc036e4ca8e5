#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/task.h"
#include "proto/config.pb.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// The named defects of the released program that presets derived and derived_head reproduce
/// (docs/task.md, pb::Defects). One function each, under the name of its switch; with the switch
/// off it changes nothing.
class SeedDefects {
 public:
  explicit SeedDefects(const pb::Defects& on) : on_(on) {}

  /// Velocities survive a reset: those to give back, of every particle. Empty when off.
  std::vector<Eigen::Vector3d> reset_positions_only(const Tissue<float>& tissue, int lane,
                                                    const TissueBody& body) const;
  /// The held patch is let go at the tool's new start: its particles. Empty when off.
  std::vector<std::int32_t> reset_patch_at_tool(const Tissue<float>& tissue, int lane) const;
  /// Every training episode starts at p_0.
  bool grid_stuck() const { return on_.grid_stuck(); }

  /// Exposure is a count of the pixels of a 64 x 64 image that see the tumour.
  bool exposure_seed_64px() const { return on_.exposure_seed_64px(); }
  /// The counter is zeroed in each frame before it is read at the frame's end: a reader in between,
  /// here at odd steps, sees nothing.
  float exposure_racy(float exposure, std::uint32_t episode_step) const {
    return on_.exposure_racy() && episode_step % 2 == 1 ? 0 : exposure;
  }

  /// What is held is put on one point.
  bool grasp_collapse_to_point() const { return on_.grasp_collapse_to_point(); }
  /// The jaws hold a round rigid body whose surface is nearer to the tip p_WT than `radius` [m].
  bool grasp_any_body(const Scene& scene, const Eigen::Vector3d& tip, double radius) const;

  /// Adds the bonus of an episode's end to this decision's reward; with the defect to `pending`,
  /// which counts for the next episode.
  void bonus_next_episode(double bonus, double& reward, double& pending) const {
    (on_.bonus_next_episode() ? pending : reward) += bonus;
  }
  /// The state that is rewarded: a jaw closed in the air counts as held.
  TaskState reward_jaw_closed(TaskState state) const {
    if (on_.reward_jaw_closed()) state.held = state.jaw_closed;
    return state;
  }

 private:
  pb::Defects on_;
};

}  // namespace omentum
