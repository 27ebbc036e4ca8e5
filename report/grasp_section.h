#pragma once

#include <vector>

#include "report/html.h"
#include "sim_worker/backend/grasp_study.h"

namespace omentum {

/// Success over the robot's starts against each parameter of the grasp that can fail: one chart per
/// parameter, the shipped value as a dashed line. Says so when the study is empty.
Section make_grasp_section(const std::vector<GraspStudyRow>& rows);

}  // namespace omentum
