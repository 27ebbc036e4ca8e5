#pragma once

#include "dvrk_gateway/gateway_options.h"

namespace omentum {

/// Runs episodes in the mode of the options; keys and signals arm, stop and end (docs/dvrk.md 8.2).
/// Throws Error for what is wrong at the start. Exit code: 0 all episodes ran, 1 ended before.
int run_gateway(const GatewayOptions& options);

/// Makes options.registration of the tables of touches and prints it. Exit code: 0 done, 1 the
/// touches do not determine where the arm stands.
int register_robot(const GatewayOptions& options);

/// Listens, arms nothing, sends nothing: a line per stream and per thing that is missing, then "go"
/// or "no go". Exit code: 0 go, 1 no go.
int check_robot(const GatewayOptions& options);

}  // namespace omentum
