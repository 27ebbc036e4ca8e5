#pragma once

namespace omentum {

/// Memory that this process may take [byte]: the least of what the machine has and of the limits of
/// its control group and of itself (ulimit -v).
double machine_memory();

}  // namespace omentum
