#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "monitor/run_state.h"

namespace omentum {

/// One line about a robot, for the table and the page.
struct RobotFigure {
  const char* name;
  std::string text;
};

/// Who it is and what it does: "PSM1 of host (pid 7): active, ENABLED, homed". Text of the gateway
/// is as received.
std::string describe_robot(const RobotRow& row, std::int64_t now_ns);

/// Reason, places in W, times of the last second, datagrams that were not taken, stops, policy.
std::vector<RobotFigure> robot_figures(const RobotStatus& status);

}  // namespace omentum
