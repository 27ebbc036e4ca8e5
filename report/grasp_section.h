#pragma once

#include <vector>

#include "report/html.h"
#include "report/run_folder.h"

namespace omentum {

/// Success over the robot's starts against each parameter of the grasp that can fail: one chart per
/// parameter, the shipped value as a dashed line. The first run that has a study; says so when none
/// has.
Section make_grasp_section(const std::vector<RunFolder>& runs);

}  // namespace omentum
