#pragma once

#include <Eigen/Geometry>
#include <numbers>

#include "sim_worker/scene/scene.h"

namespace omentum::test {

/// The scene of docs/task.md 3 with the sheet of preset `omentum` (31 x 31 particles, pitch
/// 3 mm), built from its numbers without the scene loader, so that camera and report tests do not
/// depend on it.
inline Scene make_paper_scene() {
  Scene scene;
  scene.gravity = {0, 0, -9.80665};
  TissueBody& tissue = scene.tissue;
  Eigen::Matrix3d R_WB;
  R_WB.col(0) = Eigen::Vector3d(0.99900, -0.04463, -0.00203).normalized();
  R_WB.col(2) = R_WB.col(0).cross(Eigen::Vector3d(0.03904, 0.89416, -0.44604)).normalized();
  R_WB.col(1) = R_WB.col(2).cross(R_WB.col(0));
  tissue.X_WB.linear() = R_WB;
  tissue.X_WB.translation() = Eigen::Vector3d(-0.0172, 0.0536, 0.0340);
  constexpr int kCount = 31;
  for (int j = 0; j < kCount; ++j) {
    for (int i = 0; i < kCount; ++i) {
      tissue.particles.emplace_back(0.003 * (i - 15), 0.003 * (j - 15), 0);
      tissue.fixed.push_back(j < 2 ? 1 : 0);
      if (i + 1 == kCount || j + 1 == kCount) continue;
      const int k = i + kCount * j;
      tissue.surface_triangles.emplace_back(k, k + 1, k + kCount + 1);
      tissue.surface_triangles.emplace_back(k, k + kCount + 1, k + kCount);
    }
  }
  tissue.thickness = 0.003;
  tissue.particle_radius = 0.0015;
  RigidShape tumour;
  tumour.name = "tumour";
  tumour.role = pb::ROLE_TUMOUR;
  tumour.kind = RigidShape::Kind::kSphere;
  tumour.size = Eigen::Vector3d::Constant(0.0137);
  tumour.X_WS.translation() = Eigen::Vector3d(0.0109, 0.0361, 0.0192);
  RigidShape kidney;
  kidney.name = "kidney";
  kidney.role = pb::ROLE_ORGAN;
  kidney.kind = RigidShape::Kind::kEllipsoid;
  kidney.size = {0.024, 0.031, 0.054};
  Eigen::Matrix3d R_WS;
  R_WS.col(0) = Eigen::Vector3d(0.238, -0.044, 0.970).normalized();
  R_WS.col(1) = Eigen::Vector3d(-0.967, -0.110, 0.232).normalized();
  R_WS.col(1) = (R_WS.col(1) - R_WS.col(1).dot(R_WS.col(0)) * R_WS.col(0)).normalized();
  R_WS.col(2) = R_WS.col(0).cross(R_WS.col(1));
  kidney.X_WS.linear() = R_WS;
  kidney.X_WS.translation() = Eigen::Vector3d(0.014, -0.026, 0.0285);
  scene.bodies = {tumour, kidney};
  scene.tumour = 0;
  CameraPose& camera = scene.camera;
  camera.position = {0.01006, 0.2270, 0.1848};
  const Eigen::Vector3d axis = Eigen::Vector3d(0, -0.7544, -0.6565).normalized();
  const Eigen::Vector3d up = Eigen::Vector3d(0, -0.6565, 0.7544).normalized();
  camera.R_WC.col(0) = axis.cross(up);
  camera.R_WC.col(1) = up;
  camera.R_WC.col(2) = -axis;
  camera.vertical_fov_rad = 60 * std::numbers::pi / 180;
  scene.exposure_fov_rad = 7.76 * std::numbers::pi / 180;
  scene.exposure_pixels = 320;
  scene.workspace_min = {-0.0916, -0.0825, 0.001};
  scene.workspace_max = {0.0691, 0.1155, 0.119};
  scene.tool_start = {0.0104, 0.0511, 0.1076};
  scene.target = {-0.0368, 0.0549, 0.1101};
  scene.tumour_point = {0.0065, 0.0507, 0.0189};
  return scene;
}

/// Particle positions of the flat sheet in W, x y z interleaved.
inline std::vector<float> rest_positions(const Scene& scene) {
  std::vector<float> positions;
  for (const Eigen::Vector3d& p_B : scene.tissue.particles) {
    const Eigen::Vector3d p = scene.tissue.X_WB * p_B;
    for (const double value : p) positions.push_back(static_cast<float>(value));
  }
  return positions;
}

/// A made-up lifted sheet: the point (grasp_x, grasp_y) of B [m] is pulled towards `goal`, its
/// neighbourhood follows with a smooth weight. `share` runs from 0 (flat) to 1. For pictures and
/// tests of the camera, not physics.
inline std::vector<float> lifted_positions(const Scene& scene, double grasp_x, double grasp_y,
                                           const Eigen::Vector3d& goal, double share) {
  std::vector<float> positions;
  const Eigen::Vector3d grasp = scene.tissue.X_WB * Eigen::Vector3d(grasp_x, grasp_y, 0);
  for (const Eigen::Vector3d& p_B : scene.tissue.particles) {
    const double across = (p_B.x() - grasp_x) / 0.045;
    const double fixed_share = (p_B.y() + 0.045) / (grasp_y + 0.045);  // 0 at the anchored edge
    const double along = fixed_share < 1 ? fixed_share * fixed_share : 2 - fixed_share;
    const double weight = std::max(0.0, along) * std::exp(-across * across);
    Eigen::Vector3d p = scene.tissue.X_WB * p_B + share * weight * (goal - grasp);
    for (const double value : p) positions.push_back(static_cast<float>(value));
  }
  return positions;
}

}  // namespace omentum::test
