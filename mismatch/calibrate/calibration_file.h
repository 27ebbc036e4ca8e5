#pragma once

#include <string>

#include "mismatch/calibrate/calibration.h"

namespace omentum {

/// calibration.json (docs/formats.md 14).
std::string print_calibration(const Calibration& calibration);

/// What a person reads at the end, some lines.
std::string summarise_calibration(const Calibration& calibration);

}  // namespace omentum
