#pragma once

// Tissue models for physics tests: a sheet without anything around it unless asked.

#include <memory>
#include <string>
#include <vector>

#include "sim_worker/cluster/cluster_tissue.h"
#include "sim_worker/scene/particles.h"

namespace omentum::test {

struct SheetCase {
  unsigned nx = 30, ny = 30;
  double spacing = 0.0127, radius = 0.0095, stiffness = 0.361;
  unsigned substeps = 8, iterations = 5;
  double damping = 5;
  double gravity = 9.80665;
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  double anchor_max_y = -0.0405;
  double plastic_threshold = 0, plastic_creep = 0;
  double global_stiffness = 0;
  bool self_collision = false;
  double link_radius = 0;
  unsigned rotation_iterations = 1;
};

inline pb::Scene make_sheet_config(const SheetCase& c) {
  pb::Scene config;
  pb::Tissue& tissue = *config.mutable_tissue();
  tissue.mutable_grid()->set_count_x(c.nx);
  tissue.mutable_grid()->set_count_y(c.ny);
  pb::ClusterModel& cluster = *tissue.mutable_cluster();
  cluster.set_cluster_spacing_m(c.spacing);
  cluster.set_cluster_radius_m(c.radius);
  cluster.set_cluster_stiffness(c.stiffness);
  cluster.set_substeps(c.substeps);
  cluster.set_iterations(c.iterations);
  cluster.set_damping_per_s(c.damping);
  cluster.set_orphan_policy(pb::ORPHANS_ATTACH_NEAREST);
  cluster.set_plastic_threshold_m2(c.plastic_threshold);
  cluster.set_plastic_creep(c.plastic_creep);
  cluster.set_global_stiffness(c.global_stiffness);
  cluster.set_self_collision(c.self_collision);
  cluster.set_link_radius_m(c.link_radius);
  cluster.set_rotation_iterations(c.rotation_iterations);
  cluster.set_max_speed_m_per_s(100);
  config.mutable_tool()->set_contact(false);
  return config;
}

/// The sheet alone: no bodies, no tool contact.
inline Scene make_sheet_scene(const SheetCase& c) {
  Scene scene;
  scene.config = make_sheet_config(c);
  scene.gravity = Eigen::Vector3d(0, 0, -c.gravity);
  scene.tissue.X_WB = c.X_WB;
  scene.tissue.particles = make_grid_particles(scene.config.tissue().grid());
  for (const auto& p : scene.tissue.particles)
    scene.tissue.fixed.push_back(p.y() <= c.anchor_max_y + 1e-9 ? 1 : 0);
  scene.tissue.particle_radius = 0.0015;
  scene.tissue.thickness = 0.003;
  scene.tissue.particle_mass = 1000 * 0.003 * 0.003 * 0.003;
  return scene;
}

inline std::shared_ptr<const ClusterTissueModel> make_sheet_model(const SheetCase& c) {
  std::vector<std::string> warnings;
  return make_cluster_model(make_sheet_scene(c), 0.02, warnings);
}

/// Runs without a tool for some seconds.
template <typename Real>
void run_free(Tissue<Real>& tissue, double seconds) {
  const Eigen::Vector3d away(0, 0, 1);
  const std::vector<ToolMotion> still(static_cast<std::size_t>(tissue.lanes()),
                                      ToolMotion{away, away});
  const int steps = static_cast<int>(seconds / 0.02 + 0.5);
  for (int i = 0; i < steps; ++i) tissue.step(still);
}

}  // namespace omentum::test
