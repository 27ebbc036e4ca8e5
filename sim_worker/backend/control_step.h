#pragma once

#include <Eigen/Core>
#include <span>

#include "sim_worker/instrument/arm.h"
#include "sim_worker/tissue/tissue.h"

// backend/ is the simulation as the rollout loop sees it: Backend and Snapshots on a tissue model,
// with exposure, pictures as observations and the named defects of the seed; replay of recordings
// and the study of the grasp run the same loop.

namespace omentum {

/// One control step of a batch of environments, which every simulation takes: the arms bring the
/// tools from commanded to true motion under the load of the last step, and the tissue follows.
/// `motion` has an entry per lane of the tissue: the commanded motion, replaced by the true one.
/// `arms`, `states` and `reports`, one per environment, are empty while the arm has no effects;
/// `reports` may be empty beside them.
template <typename Real>
void control_step(std::span<const Arm> arms, std::span<ArmState> states, Tissue<Real>& tissue,
                  std::span<ToolMotion> motion, std::span<ArmReport> reports = {}) {
  for (std::size_t k = 0; k < states.size(); ++k) {
    motion[k].from = Eigen::Map<const Eigen::Vector3d>(states[k].p_WT_true);
    const ArmReport report =
        arms[k].step(states[k], motion[k].to, tissue.held_force(static_cast<int>(k)));
    motion[k].to = Eigen::Map<const Eigen::Vector3d>(states[k].p_WT_true);
    if (!reports.empty()) reports[k] = report;
  }
  tissue.step(motion);
}

}  // namespace omentum
