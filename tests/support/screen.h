#pragma once

#include <cmath>
#include <vector>

#include "sim_worker/camera/camera.h"
#include "tests/support/paper_scene.h"

namespace omentum::test {

/// Scene whose sheet is one rectangle, given by its corners in W at drawing time.
inline Scene scene_with_one_rectangle() {
  Scene scene = make_paper_scene();
  scene.tissue.particles.assign(4, Eigen::Vector3d::Zero());
  scene.tissue.surface_triangles = {{0, 1, 2}, {0, 2, 3}};
  return scene;
}

/// A rectangle 60 mm in front of the tumour, across the line of sight, that covers the part of the
/// view with x_C in [low, high] (in units of the tumour's radius as seen).
inline std::vector<float> screen(const Scene& scene, double low, double high) {
  const Eigen::Vector3d& centre = scene.bodies[0].X_WS.translation();
  const Eigen::Vector3d to_camera = (scene.camera.position - centre).normalized();
  const double distance = (scene.camera.position - centre).norm();
  const double radius =
      0.0137 / std::sqrt(1 - std::pow(0.0137 / distance, 2)) * (distance - 0.06) / distance;
  const CameraPose view = look_at(scene.camera.position, centre, scene.camera.R_WC.col(1), 1);
  const Eigen::Vector3d middle = centre + 0.06 * to_camera;
  std::vector<float> positions;
  for (const auto& [x, y] : {std::pair{low, -3.0}, {high, -3.0}, {high, 3.0}, {low, 3.0}}) {
    const Eigen::Vector3d p = middle + radius * (x * view.R_WC.col(0) + y * view.R_WC.col(1));
    for (const double value : p) positions.push_back(static_cast<float>(value));
  }
  return positions;
}

}  // namespace omentum::test
