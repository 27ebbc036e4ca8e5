#pragma once

#include "dvrk_gateway/gateway_options.h"

namespace omentum {

/// The experiment of the paper: the policy once from each start of the robot's grid. In
/// options.folder: robot.csv (a row per start, as soon as it is over), prediction.csv (what
/// simulation says of the same starts) and report.html with both. A folder that has rows already is
/// gone on with. An outcome is asked for, or read from the jaw, which stops short on tissue. Throws
/// Error for what is wrong at the start. Exit code: 0 all starts done, 1 ended before.
int run_experiment(const GatewayOptions& options);

}  // namespace omentum
