#pragma once

#include <string>
#include <vector>

#include "core/csv.h"
#include "core/psm.h"
#include "core/registration.h"
#include "core/result.h"

namespace omentum {

/// Tables of touches (docs/formats.md 8) and what `dvrk_gateway register` makes of them.

/// One touch: pose of the control point when the tip was at a point.
struct Touch {
  std::string name;                                ///< of the point
  Eigen::Vector3d p_WT = Eigen::Vector3d::Zero();  ///< where the point is [m]; 0 without columns
  PsmPose pose_RC;                                 ///< local/measured_cp
};

/// Columns name, world_x_m, world_y_m, world_z_m, control_x_m, control_y_m, control_z_m, q_w, q_x,
/// q_y, q_z (quaternion of R_RC, of length 1 within 1e-3); for pivoting those of world and name may
/// be absent. Fails with one line, path:line:character: a column that is missing or unknown, a cell
/// that is no finite number.
Result<std::vector<Touch>> read_touches(const CsvTable& table, bool with_world);

/// What a registration is made of.
struct RegistrationInput {
  std::string touches;  ///< path of the table of touches
  std::string pivots;   ///< path of the table of the tip's pivoting; empty: nominal tip offset
  std::string instrument = large_needle_driver().name;
  double nominal_tip_offset = 0.0102;  ///< of the tip along the jaw, z_C [m]
  pb::RegistrationRules rules;
  Eigen::Vector3d workspace_min = Eigen::Vector3d::Zero();  ///< W, where errors are predicted [m]
  Eigen::Vector3d workspace_max = Eigen::Vector3d::Zero();
  std::int64_t date_ns = 0;  ///< since 1970-01-01 UTC
};

/// Reads both tables, finds the tip and registers. One line why not.
Result<Registration> register_from_tables(const RegistrationInput& input);

/// For the operator: a line per point with residual and leave-one-out error, the figures of the
/// fit, the predicted errors in the box, warnings.
std::string describe_registration(const Registration& registration,
                                  const pb::RegistrationRules& rules,
                                  const Eigen::Vector3d& workspace_min,
                                  const Eigen::Vector3d& workspace_max);

}  // namespace omentum
