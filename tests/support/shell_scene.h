#pragma once

// Elastic sheets for physics tests: nothing around them unless asked.

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "core/rng.h"
#include "sim_worker/scene/particles.h"
#include "sim_worker/shell/shell_tissue.h"
#include "support/cluster_scene.h"
#include "support/elastic_energy.h"

namespace omentum::test {

struct ShellCase {
  unsigned nx = 31, ny = 31;
  double pitch = 0.003;
  double young = 100e3, poisson = 0, damping = 5, bending_scale = 1;
  double thickness = 0.003;
  unsigned substeps = 5, iterations = 1;
  pb::Integrator integrator = pb::INTEGRATOR_BACKWARD_EULER;
  double gravity = 9.81;
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  double anchor_max_y = -0.0449;  ///< the row at y_B = -45 mm
  std::vector<RigidShape> bodies;
  double static_friction = 0, dynamic_friction = 0;
};

/// X_WB of a sheet that hangs along -z from its anchored edge.
inline Eigen::Isometry3d upright() {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.linear() =
      Eigen::AngleAxisd(-0.5 * std::numbers::pi, Eigen::Vector3d::UnitX()).toRotationMatrix();
  return X;
}

/// A sphere for the sheet to lie on.
inline RigidShape make_sphere(const Eigen::Vector3d& centre, double radius) {
  RigidShape sphere;
  sphere.kind = RigidShape::Kind::kSphere;
  sphere.X_WS.translation() = centre;
  sphere.size = Eigen::Vector3d::Constant(radius);
  return sphere;
}

/// The sheet of docs/tissue.md 9 over a sphere: contact distance 40 mm.
inline ShellCase over_sphere() {
  ShellCase c;
  c.young = 30e3;
  c.bodies.push_back(make_sphere({0, -0.010, -0.043}, 0.0385));
  return c;
}

inline Scene make_shell_scene(const ShellCase& c) {
  Scene scene;
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.set_model(pb::TISSUE_ELASTIC);
  tissue.mutable_grid()->set_count_x(c.nx);
  tissue.mutable_grid()->set_count_y(c.ny);
  tissue.mutable_grid()->set_pitch_m(c.pitch);
  tissue.mutable_material()->set_young_modulus_pa(c.young);
  tissue.mutable_material()->set_poisson_ratio(c.poisson);
  tissue.mutable_material()->set_damping_per_s(c.damping);
  tissue.mutable_material()->set_bending_scale(c.bending_scale);
  tissue.mutable_elastic()->set_substeps(c.substeps);
  tissue.mutable_elastic()->set_iterations(c.iterations);
  tissue.mutable_elastic()->set_integrator(c.integrator);
  tissue.set_static_friction(c.static_friction);
  tissue.set_dynamic_friction(c.dynamic_friction);
  scene.config.mutable_tool()->set_contact(false);
  scene.gravity = Eigen::Vector3d(0, 0, -c.gravity);
  scene.bodies = c.bodies;
  scene.tissue.X_WB = c.X_WB;
  scene.tissue.particles = make_grid_particles(tissue.grid());
  for (const auto& p : scene.tissue.particles) {
    scene.tissue.fixed.push_back(p.y() <= c.anchor_max_y ? 1 : 0);
  }
  scene.tissue.particle_radius = 0.0015;
  scene.tissue.thickness = c.thickness;
  return scene;
}

inline std::shared_ptr<const ShellTissueModel> make_shell_sheet(const ShellCase& c) {
  std::vector<std::string> warnings;
  return make_shell_model(make_shell_scene(c), 0.02, warnings);
}

/// The grid sheet of a case as a mesh without any order: inner nodes moved by up to `jitter` of the
/// pitch (rim nodes along the rim, the first two rows not), diagonals by chance.
inline TriangleMesh make_irregular_mesh(const ShellCase& c, double jitter) {
  TriangleMesh mesh;
  const auto nx = static_cast<int>(c.nx);
  const auto ny = static_cast<int>(c.ny);
  const auto chance = [](int i, std::uint32_t k) {
    return static_cast<double>(philox({static_cast<std::uint32_t>(i), k, 0, 0}, {3, 5})[0]) *
           0x1p-32;
  };
  for (int ix = 0; ix < nx; ++ix) {
    for (int iy = 0; iy < ny; ++iy) {
      const int i = ny * ix + iy;
      Eigen::Vector3d p(ix - 0.5 * (nx - 1), iy - 0.5 * (ny - 1), 0);
      if (ix > 0 && ix + 1 < nx) p.x() += jitter * (2 * chance(i, 0) - 1);
      if (iy > 1 && iy + 1 < ny) p.y() += jitter * (2 * chance(i, 1) - 1);
      mesh.vertices.emplace_back(c.pitch * p);
      if (ix + 1 == nx || iy + 1 == ny) continue;
      if (chance(i, 2) < 0.5) {
        mesh.triangles.emplace_back(i, i + ny, i + ny + 1);
        mesh.triangles.emplace_back(i, i + ny + 1, i + 1);
      } else {
        mesh.triangles.emplace_back(i, i + ny, i + 1);
        mesh.triangles.emplace_back(i + ny, i + ny + 1, i + 1);
      }
    }
  }
  return mesh;
}

/// The scene of a case with this middle surface instead of the grid.
inline Scene make_mesh_scene(const ShellCase& c, const TriangleMesh& mesh) {
  Scene scene = make_shell_scene(c);
  scene.config.mutable_tissue()->mutable_sheet();
  scene.tissue.particles = mesh.vertices;
  scene.tissue.surface_triangles = mesh.triangles;
  scene.tissue.fixed.clear();
  for (const auto& p : mesh.vertices) scene.tissue.fixed.push_back(p.y() <= c.anchor_max_y ? 1 : 0);
  scene.sheet = measure_sheet("mesh", mesh.vertices, mesh.triangles);
  return scene;
}

inline std::shared_ptr<const ShellTissueModel> make_shell_mesh(const ShellCase& c,
                                                               const TriangleMesh& mesh) {
  std::vector<std::string> warnings;
  return make_shell_model(make_mesh_scene(c, mesh), 0.02, warnings);
}

/// Steps with one tool motion for every lane.
template <typename Real>
void move_tool(Tissue<Real>& tissue, const Eigen::Vector3d& from, const Eigen::Vector3d& to,
               int steps) {
  for (int step = 0; step < steps; ++step) {
    const Eigen::Vector3d a = from + (to - from) * step / steps;
    const Eigen::Vector3d b = from + (to - from) * (step + 1) / steps;
    tissue.step(std::vector<ToolMotion>(static_cast<std::size_t>(tissue.lanes()), {a, b}));
  }
}

/// The forces of a sheet at places p are the slopes of its energy there, at some of 81 nodes.
inline void expect_gradient_of_energy(ShellTissue<double>& tissue,
                                      const std::vector<Eigen::Vector3d>& p) {
  const auto gradient = tissue.elastic_gradient(0);
  constexpr double kStep = 1e-7;
  for (const std::size_t i : {0UL, 4UL, 40UL, 57UL, 80UL}) {
    for (int axis = 0; axis < 3; ++axis) {
      const auto energy_at = [&](double shift) {
        std::vector<Eigen::Vector3d> q = p;
        q[i][axis] += shift;
        const ShellEnergy e = shell_energy(tissue.model(), q);
        return e.membrane + e.bending;
      };
      const double slope = (energy_at(kStep) - energy_at(-kStep)) / (2 * kStep);
      EXPECT_NEAR(gradient[i][axis], slope, 1e-6 * (1 + std::fabs(slope))) << i << " " << axis;
    }
  }
}

/// Root mean square distance of two states [m].
template <typename A, typename B>
double rms_distance(const A& a, int lane_a, const B& b, int lane_b) {
  double sum = 0;
  for (int i = 0; i < a.particles(); ++i) {
    sum += (a.position(lane_a, i) - b.position(lane_b, i)).squaredNorm();
  }
  return std::sqrt(sum / a.particles());
}

}  // namespace omentum::test
