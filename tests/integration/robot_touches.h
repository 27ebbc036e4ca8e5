#pragma once

#include <fmt/format.h>

#include <Eigen/Core>
#include <string>

namespace omentum::test {

/// Touches of a robot whose tool, where the double homes it, stands above the sheet: R is W moved,
/// and the tool points down. The first point was touched too high by `error` [m].
inline std::string robot_touches(double error = 0) {
  const Eigen::Vector3d p_WR(-0.02, 0.03, 0.1837);
  const double tip_offset = 0.0102;
  std::string csv =
      "name,world_x_m,world_y_m,world_z_m,control_x_m,control_y_m,control_z_m,q_w,q_x,q_y,q_z\n";
  int k = 0;
  for (const double x : {-0.05, 0.04}) {
    for (const double y : {-0.03, 0.07}) {
      for (const double z : {0.02, 0.05 + 0.1 * x + 0.2 * y}) {
        const double up = k == 0 ? error : 0;
        const Eigen::Vector3d c = Eigen::Vector3d(x, y, z + tip_offset + up) - p_WR;
        csv += fmt::format("p{},{},{},{},{},{},{},0,0.70710678118654757,0.70710678118654757,0\n",
                           k++, x, y, z, c.x(), c.y(), c.z());
      }
    }
  }
  return csv;
}

}  // namespace omentum::test
