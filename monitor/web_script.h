#pragma once

#include <string>

namespace omentum {

/// The script of the monitor's page: asks for state and curves, and for frames of the slot that is
/// watched. #slot=N in the address starts the 3-D view. What it saw stands in data-... of the html
/// element: updates, steps, frames, moved.
std::string monitor_script();

}  // namespace omentum
