#pragma once

// Elastic solids for physics tests: a box, nothing around it unless asked.

#include <algorithm>
#include <memory>
#include <vector>

#include "sim_worker/solid/solid_tissue.h"

namespace omentum::test {

struct SolidCase {
  Eigen::Vector3d size{0.01, 0.12, 0.01};  ///< [m], centred on B
  double edge_length = 0.01;
  SolidMesh mesh;  ///< of that box, where it was made before; else empty
  double young = 15e6, poisson = 0.3, damping = 0, density = 1000;
  unsigned substeps = 5;
  pb::Integrator integrator = pb::INTEGRATOR_BACKWARD_EULER;
  Eigen::Vector3d gravity{0, 0, -9.81};
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  double anchor_max_y = -0.06 + 1e-9;  ///< the face at y_B = -60 mm
  std::vector<RigidShape> bodies;
  pb::TissueEffects effects;
  double static_friction = 0, dynamic_friction = 0;
};

inline Scene make_solid_scene(const SolidCase& c) {
  Scene scene;
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.set_model(pb::TISSUE_ELASTIC);
  tissue.mutable_volume()->set_edge_length_m(c.edge_length);
  tissue.set_density_kg_per_m3(c.density);
  tissue.mutable_material()->set_law(pb::LAW_STABLE_NEO_HOOKE);
  tissue.mutable_material()->set_young_modulus_pa(c.young);
  tissue.mutable_material()->set_poisson_ratio(c.poisson);
  tissue.mutable_material()->set_damping_per_s(c.damping);
  tissue.mutable_elastic()->set_substeps(c.substeps);
  tissue.mutable_elastic()->set_integrator(c.integrator);
  *tissue.mutable_effects() = c.effects;
  tissue.set_static_friction(c.static_friction);
  tissue.set_dynamic_friction(c.dynamic_friction);
  scene.config.mutable_tool()->set_contact(false);
  scene.gravity = c.gravity;
  scene.bodies = c.bodies;
  scene.solid = c.mesh;
  if (c.mesh.nodes.empty())
    scene.solid = fill_mesh(make_box_mesh(0.5 * c.size), "box", c.edge_length);
  scene.tissue.X_WB = c.X_WB;
  scene.tissue.particles = scene.solid.nodes;
  scene.tissue.surface_triangles = scene.solid.surface;
  for (const auto& p : scene.tissue.particles) {
    scene.tissue.fixed.push_back(p.y() <= c.anchor_max_y ? 1 : 0);
  }
  scene.tissue.particle_radius = 0.0015;
  return scene;
}

inline std::shared_ptr<const SolidTissueModel> make_solid(const SolidCase& c) {
  return make_solid_model(make_solid_scene(c), 0.02);
}

/// Bar of 10 x 120 x 10 mm along y that is held nowhere.
inline SolidCase free_bar() {
  SolidCase c;
  c.anchor_max_y = -1;
  c.young = 20e3;
  c.gravity.setZero();
  return c;
}

/// The same, clamped at its lower end in y.
inline SolidCase clamped_bar() {
  SolidCase c = free_bar();
  c.anchor_max_y = SolidCase{}.anchor_max_y;
  c.damping = 20;
  return c;
}

/// Mean of the nodes of the free end.
inline Eigen::Vector3d tip_of(const SolidTissue<double>& tissue) {
  double far = -1;
  for (const Eigen::Vector3d& p : tissue.model().mesh.nodes) far = std::max(far, p.y());
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  int count = 0;
  for (int i = 0; i < tissue.particles(); ++i) {
    if (tissue.model().mesh.nodes[static_cast<std::size_t>(i)].y() < far - 1e-6) continue;
    sum += tissue.position(0, i);
    ++count;
  }
  return sum / count;
}

/// [N]
inline double weight_of(const SolidTissue<double>& tissue) {
  double mass = 0;
  for (const double m : tissue.model().mass) mass += m;
  return 9.81 * mass;
}

}  // namespace omentum::test
