#pragma once

#include <Eigen/Core>
#include <vector>

#include "sim_worker/geometry/rigid_shape.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/grasp_patch.h"

namespace omentum {

/// What acts on a tissue from outside, as the scene has it; the same in all lanes.
struct Surroundings {
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();  ///< in W [m/s^2]
  double static_friction = 0, dynamic_friction = 0;
  std::vector<RigidShape> bodies;  ///< what the tissue collides with, the tool apart
  bool tool_contact = false;       ///< with the tool's shaft: a capsule
  double tool_radius = 0;          ///< [m]
  double tool_start = 0;           ///< of the capsule's axis, behind the tip [m]
  double tool_length = 0;          ///< of that axis [m]
  Eigen::Vector3d shaft_axis = Eigen::Vector3d::UnitZ();  ///< from the tip up the shaft, in W
  Grip grip;

  /// The foot of the capsule's axis when the tip is at p_WT [m].
  Eigen::Vector3d capsule_at(const Eigen::Vector3d& p_WT) const {
    return capsule_at(p_WT, shaft_axis);
  }
  /// The same of a tool that points elsewhere.
  Eigen::Vector3d capsule_at(const Eigen::Vector3d& p_WT, const Eigen::Vector3d& axis) const {
    return p_WT + tool_start * axis;
  }
};

/// Throws Error where the scene has more bodies than the lane kernels take (kMaxShapes, the tool
/// included), or of a grip that the model does not have.
Surroundings make_surroundings(const Scene& scene);

}  // namespace omentum
