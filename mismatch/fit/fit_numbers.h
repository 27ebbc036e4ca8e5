#pragma once

#include <string>
#include <vector>

#include "mismatch/fit/fit_data.h"

namespace omentum {

/// A column of the normal equations by name.
struct FitNumber {
  std::string name;  ///< path in the scene, or "registration.x", "pinch.y", "discrepancy.constant"
  std::string unit;
  NumberRole role = NumberRole::kBase;
  bool own = false;  ///< every recording has one of its own
};

/// Of every column, in the order of FitData::layout. Smooth modes of one function of time share a
/// name, and carry their number: "discrepancy.with_lift[3]".
std::vector<FitNumber> numbers_of(const FitData& data);

/// Name of the smooth discrepancy of one function of time.
std::string discrepancy_name(int function);

}  // namespace omentum
