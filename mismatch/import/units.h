#pragma once

#include <string>
#include <string_view>

#include "core/result.h"

namespace omentum {

/// What a number in a unit is multiplied by to be in `si` ("m", "s", "rad", "N", "Nm", "Pa", "kg",
/// "Hz", "m_per_s", "rad_per_s", "m2"; empty: a share).
struct UnitFactor {
  std::string_view si;
  double factor = 1;
};

/// Fails with one line that lists the units there are.
Result<UnitFactor> find_unit(std::string_view unit);

/// Unit of SI at the end of the name of a column ("q3_measured_m": "m"); empty of a share or a part
/// of a quaternion.
std::string_view unit_of_column(std::string_view column);

/// Factor from a unit to the unit of a column; fails where they are of two kinds.
Result<double> factor_to_column(std::string_view unit, std::string_view column);

}  // namespace omentum
