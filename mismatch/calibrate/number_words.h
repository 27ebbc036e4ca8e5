#pragma once

#include <string>

#include "mismatch/calibrate/calibration.h"

// Numbers of a calibration in the units, digits and words that people use, the same in warnings,
// on a terminal and on the pages of calibrate and explain. Any thread.
namespace omentum {

/// "52.0 kPa (49.3 - 54.8)".
std::string told(const CalibratedNumber& number);
/// The same of what was believed before.
std::string told_belief(const CalibratedNumber& number);

/// The path, with words in brackets where it does not speak for itself:
/// "scene.tissue.material.young_modulus_pa (stiffness)".
std::string with_words(const std::string& path);

/// Words for a nuisance or a number of the numerics: "the smooth difference that grows with the
/// lift" for "discrepancy.with_lift[25]"; one that has none as with_words() has it.
std::string nuisance_words(const std::string& key);

/// A number, behind its recording where it belongs to one, and its words behind it:
/// "r08: clock, the camera's clock".
std::string named_nuisance(const std::string& name);

}  // namespace omentum
