#pragma once

#include <vector>

#include "dvrk_gateway/backend/arm_guide.h"
#include "dvrk_gateway/recording/motion.h"

namespace omentum {

/// The motion as one goal per control period, `slow` times as long: places and jaw on straight
/// lines between the samples. Fails, naming the moment of the longest step, where a goal is farther
/// than `step_m` per axis from the one before, and with the factor that would do. Aborts below two
/// samples. Precondition: t_s increases, period_s > 0, slow > 0.
Result<std::vector<MotionSample>> goals_of(const std::vector<MotionSample>& motion, double period_s,
                                           double slow, double step_m);

/// Fails, naming the first moment, where a goal is outside the workspace box, out of reach or
/// beyond a joint limit at the orientation of the mount, or where joints would turn too fast.
Result<void> check_goals(const SafetySetup& setup, const std::vector<MotionSample>& goals);

/// Mode `replay`: waits until the operator has armed, leads the arm to the first goal, then along
/// them, one per period. A jaw that was not recorded stays open. Fails with the reason of a stop.
/// Precondition: there is a goal.
Result<void> replay_goals(ArmGuide& guide, const std::vector<MotionSample>& goals);

}  // namespace omentum
