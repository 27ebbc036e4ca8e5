#pragma once

#include "dvrk_gateway/gateway_options.h"

namespace omentum {

/// `dvrk_gateway touches`: the operator brings the tip to one point of `--points` after the other,
/// and each key press writes a row of `--out`, the table that `register` reads. Sends nothing. Exit
/// code; throws Error for a wrong option.
int write_touches(const GatewayOptions& options);

}  // namespace omentum
