#pragma once

#include <string>

#include "mismatch/calibrate/calibration.h"

// Numbers of a calibration in the units and digits that people use, the same in warnings, on a
// terminal and on the page. Any thread.
namespace omentum {

/// "52.0 kPa (49.3 - 54.8)".
std::string told(const CalibratedNumber& number);
/// The same of what was believed before.
std::string told_belief(const CalibratedNumber& number);

/// The path, with words in brackets where it does not speak for itself:
/// "scene.tissue.material.young_modulus_pa (stiffness)".
std::string with_words(const std::string& path);

}  // namespace omentum
