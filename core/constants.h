#pragma once

#include <numbers>

namespace omentum {

/// Numbers of mathematics and nature that more than one file needs. Whatever a user may want to
/// change is a knob in proto/; numbers of the robot are in core/psm.cpp and docs/dvrk.md.

inline constexpr double kPi = std::numbers::pi;
inline constexpr double kDegree = kPi / 180;         ///< [rad]
inline constexpr double kStandardGravity = 9.80665;  ///< [m/s^2], CGPM 1901
inline constexpr double kAirDensity = 1.2;           ///< [kg/m^3], dry, 20 C

}  // namespace omentum
