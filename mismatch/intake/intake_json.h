#pragma once

#include <nlohmann/json.hpp>
#include <vector>

#include "mismatch/intake/intake.h"

namespace omentum {

/// What `mismatch info --json` says of a recording and of repeats (docs/import.md 9): the figures
/// of print_intake() and print_floor() under the names of their structures, SI.
nlohmann::ordered_json intake_json(const IntakeFigures& figures);
nlohmann::ordered_json floor_json(const std::vector<FloorFigures>& floor);

}  // namespace omentum
