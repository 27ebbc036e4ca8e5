#pragma once

#include <Eigen/Geometry>
#include <string>

namespace omentum {

/// X_AR of "x,y,z,qw,qx,qy,qz": where the arm's own frame R stands in its reference frame A, as set
/// on the robot's console [m, quaternion of length 1 to 1e-6]. Throws Error, one line naming
/// --base-frame.
Eigen::Isometry3d parse_base_frame(const std::string& text);

}  // namespace omentum
