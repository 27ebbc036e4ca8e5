#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <string>
#include <string_view>

namespace omentum {

/// The instruments of the da Vinci that a classic PSM can hold, as data (docs/dvrk.md 1.1, from
/// sawIntuitiveResearchKit share/tool). Frames and joints: core/psm.h.

struct JointRange {
  const char* name;
  double min, max;
};

struct PsmInstrument {
  const char* name;     ///< as in --instrument
  const char* number;   ///< Intuitive's, printed on the instrument; 42 is for an Si arm
  double tool_length;   ///< L_tool, shaft from the roll axis to the wrist-pitch axis [m]
  double pitch_to_yaw;  ///< a6, wrist-pitch axis to wrist-yaw axis [m]
  std::array<JointRange, 6> limits;        ///< yaw ... wrist yaw [rad, insertion m]
  JointRange jaw;                          ///< [rad]
  std::array<double, 6> effort_limits;     ///< [N m, insertion N]
  double jaw_effort_limit;                 ///< [N m]
  std::array<double, 16> joints_of_discs;  ///< disc angles to roll, pitch, yaw, jaw; row-major

  Eigen::Matrix4d disc_coupling() const;  ///< joints_of_discs as a matrix
};

/// Every instrument: classic and Si of large needle driver, Cadiere, DeBakey, ProGrasp, fenestrated
/// and Maryland bipolar.
std::span<const PsmInstrument> psm_instruments();

/// Large needle driver 400006: what the simulation holds, and the default.
const PsmInstrument& large_needle_driver();

/// By name or number. Throws Error: one line with the names of all.
const PsmInstrument& find_instrument(std::string_view name);

}  // namespace omentum
