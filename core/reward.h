#pragma once

#include "proto/config.pb.h"

namespace omentum {

/// What the reward looks at: the state before the motion of the step (seed_task.md section 7).
struct RewardState {
  bool held = false;         ///< tissue held; with the named defect reward_jaw_closed: jaw closed
  double distance_q = 0;     ///< |p - q| [m]
  double distance_target = 0;///< |p - p_T| [m]
  double workspace_diagonal = 1;  ///< L_ws [m]
  double exposure = 0;       ///< 0 ... 1, while held
};

/// Reward of one control period; k = -0.5 / L_ws (P eq. 2 with the sign its text and figure 4 demand).
///   not held             k |p - q| - 0.5                    in [-1, -0.5]
///   held, paper          k |p - p_T|                        in [-0.5, 0]
///   held, derived*       k |p - p_T| - 0.25                 in [-0.75, -0.25]
///   held, omentum        k |p - p_T| + w_e exposure
inline double reward(pb::RewardKind kind, const RewardState& s, double exposure_weight) {
  const double k = -0.5 / s.workspace_diagonal;
  if (!s.held) return k * s.distance_q - 0.5;
  switch (kind) {
    case pb::REWARD_DERIVED:
    case pb::REWARD_DERIVED_HEAD:
      return k * s.distance_target - 0.25;
    case pb::REWARD_OMENTUM:
      return k * s.distance_target + exposure_weight * s.exposure;
    default:
      return k * s.distance_target;
  }
}

}  // namespace omentum
