#pragma once

// A sheet with a deformable body under it, nothing else around unless asked.

#include <memory>
#include <string>
#include <vector>

#include "sim_worker/coupled/coupled_tissue.h"
#include "support/shell_scene.h"

namespace omentum::test {

struct CoupledCase {
  ShellCase sheet;  ///< its bodies and friction hold for both
  TriangleMesh shape = make_box_mesh({0.03, 0.03, 0.01});
  double edge_length = 0.012;
  double young = 10e3, poisson = 0.45, density = 1050, damping = 5;
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  double anchor_max_z = -0.01;  ///< of W
};

/// A loose sheet of 45 x 45 mm just above a cushion of 60 x 60 x 20 mm that is fixed below.
inline CoupledCase on_cushion() {
  CoupledCase c;
  c.sheet.nx = c.sheet.ny = 16;
  c.sheet.young = 5e3;
  c.sheet.poisson = 0.45;
  c.sheet.anchor_max_y = -1;
  c.sheet.X_WB.translation().z() = 0.01 + 0.0015 + 0.0005;
  c.sheet.static_friction = c.sheet.dynamic_friction = 0.3;
  return c;
}

/// A sheet with one anchored edge over a dome.
inline CoupledCase over_dome() {
  CoupledCase c;
  c.sheet.young = 5e3;
  c.sheet.poisson = 0.45;
  c.sheet.static_friction = c.sheet.dynamic_friction = 0.3;
  c.shape = make_ellipsoid_mesh({0.025, 0.025, 0.02}, 15, 32);
  c.edge_length = 0.012;
  c.young = 5e3;
  c.X_WB.translation().z() = -0.024;
  c.anchor_max_z = -0.034;
  return c;
}

inline Scene make_coupled_scene(const CoupledCase& c) {
  Scene scene = make_shell_scene(c.sheet);
  pb::DeformableBody& config = *scene.config.add_body();
  config.set_edge_length_m(c.edge_length);
  config.set_density_kg_per_m3(c.density);
  config.mutable_material()->set_law(pb::LAW_STABLE_NEO_HOOKE);
  config.mutable_material()->set_young_modulus_pa(c.young);
  config.mutable_material()->set_poisson_ratio(c.poisson);
  config.mutable_material()->set_damping_per_s(c.damping);
  SoftBody& soft = scene.soft_body.emplace();
  soft.mesh = fill_mesh(c.shape, "shape", c.edge_length);
  soft.body.X_WB = c.X_WB;
  soft.body.particles = soft.mesh.nodes;
  soft.body.surface_triangles = soft.mesh.surface;
  for (const auto& p : soft.mesh.nodes)
    soft.body.fixed.push_back((c.X_WB * p).z() <= c.anchor_max_z + 1e-9 ? 1 : 0);
  soft.body.particle_radius = 0.0015;
  return scene;
}

inline std::shared_ptr<const CoupledTissueModel> make_coupled(const CoupledCase& c) {
  std::vector<std::string> warnings;
  return make_coupled_model(make_coupled_scene(c), 0.02, warnings);
}

}  // namespace omentum::test
