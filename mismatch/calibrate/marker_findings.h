#pragma once

#include "mismatch/calibrate/findings.h"

namespace omentum {

/// Adds offsets of markers and where bodies were held at the start; takes out what recordings
/// without jaws have none of.
void add_marker_numbers(const Findings& findings, Calibration& result);

}  // namespace omentum
