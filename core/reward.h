#pragma once

#include "proto/config.pb.h"

namespace omentum {

/// Arguments of the reward, of the state before the motion of the step (docs/task.md 7).
struct RewardState {
  bool held = false;           ///< tissue held; with the named defect reward_jaw_closed: jaw closed
  double distance_q = 0;       ///< |p - q| [m]
  double distance_target = 0;  ///< |p - p_T| [m]
  double workspace_diagonal = 1;  ///< L_ws [m]
  double grasp_distance_q = 0;    ///< |p - q| when tissue was taken hold of, while held [m]
  double exposure = 0;            ///< 0 ... 1, while held
};

/// Weights of REWARD_OMENTUM; zero leaves a term out.
struct RewardWeights {
  double exposure = 0;           ///< w_e
  double exposure_distance = 0;  ///< d_e [m]; 0 = exposure counts everywhere
  double grasp_distance = 0;     ///< w_g [1/m]
};

/// Reward of one control period; k = -0.5 / L_ws (P eq. 2 with the sign its text and figure 4
/// demand).
///   not held             k |p - q| - 0.5                    in [-1, -0.5]
///   held, paper          k |p - p_T|                        in [-0.5, 0]
///   held, derived*       k |p - p_T| - 0.25                 in [-0.75, -0.25]
///   held, omentum        k |p - p_T| - w_g |g - q| + w_e exposure max(0, 1 - |p - p_T| / d_e)
/// Without d_e a policy stops where the tumour is first visible, 85 mm from p_T; without w_g it
/// grasps where it first meets the sheet, the flaw that P VI-B names. Both measured,
/// docs/decisions/0009.
inline double reward(pb::RewardKind kind, const RewardState& s, const RewardWeights& w) {
  const double k = -0.5 / s.workspace_diagonal;
  if (!s.held) return k * s.distance_q - 0.5;
  const double held = k * s.distance_target;
  switch (kind) {
    case pb::REWARD_DERIVED:
    case pb::REWARD_DERIVED_HEAD:
      return held - 0.25;
    case pb::REWARD_OMENTUM: {
      const double near = w.exposure_distance > 0 ? 1 - s.distance_target / w.exposure_distance : 1;
      return held - w.grasp_distance * s.grasp_distance_q +
             w.exposure * s.exposure * (near > 0 ? near : 0);
    }
    default:
      return held;
  }
}

}  // namespace omentum
