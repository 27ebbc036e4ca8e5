#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <memory>
#include <string>

#include "proto/scene.pb.h"
#include "sim_worker/geometry/mesh.h"

namespace omentum {

/// A rigid body of the scene, resolved: analytic shape or mesh with its signed distance grid.
struct RigidShape {
  enum class Kind { kSphere, kEllipsoid, kBox, kHalfSpace, kMesh };
  std::string name;
  pb::BodyRole role = pb::ROLE_ORGAN;
  Kind kind = Kind::kSphere;
  Eigen::Isometry3d X_WS = Eigen::Isometry3d::Identity();  ///< pose of the shape in W
  Eigen::Vector3d size =
      Eigen::Vector3d::Zero();         ///< radius in all three, semi-axes, or half extents [m]
  TriangleMesh surface;                ///< tessellation in the shape's own frame, for pictures
  std::shared_ptr<const SdfGrid> sdf;  ///< kMesh only
};

}  // namespace omentum
