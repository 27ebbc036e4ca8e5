#pragma once

#include <string>

#include "mismatch/calibrate/calibration.h"

namespace omentum {

/// report.html: one text that loads nothing. Numbers with intervals, error before and after, the
/// recordings in three dimensions with their clouds. `folder`: meshes of the scene lie there.
std::string make_calibration_page(const Calibration& calibration, const std::string& folder);

}  // namespace omentum
