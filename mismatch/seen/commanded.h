#pragma once

#include <span>
#include <string>
#include <vector>

#include "mismatch/seen/observation.h"

namespace omentum {

/// The commands and the camera of a recording, looked at at these times [s], on the clock of the
/// camera; nothing that was observed is in it. Its track ends where observe()'s would. Throws
/// Error: no path of the tool.
Observation observe_commands(const std::string& name, const std::string& path,
                             const Recording& recording, const Scene& scene,
                             std::span<const double> times, std::vector<std::string>& warnings);

}  // namespace omentum
