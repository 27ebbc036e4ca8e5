#pragma once

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/rng.h"
#include "sim_worker/reference/reference_tissue.h"
#include "sim_worker/scene/particles.h"

namespace omentum::test {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kPi = 3.14159265358979323846;
constexpr double kGravity = 9.80665;  // [m/s^2]

/// Repeatable numbers in [-1, 1].
class Random {
 public:
  double next() {
    const PhiloxWords words = philox({count_++, 0, 0, 0}, {7, 0});
    return static_cast<double>(words[0]) * 0x1p-31 - 1;
  }

 private:
  std::uint32_t count_ = 0;
};

/// A sheet of the reference model: grid of particles, mesh, material, surroundings.
struct ReferenceCase {
  unsigned nx = 4, ny = 31;  ///< grid of the sheet
  double anchor = -0.045;    ///< y_B of the clamp edge [m]; below the sheet = nothing clamped
  unsigned ex = 1, ey = 24, ez = 1;
  double thickness = 0.003;
  double young = 1e5, poisson = 0;
  double damping = 0;
  double gravity = kGravity;  ///< along -z_W [m/s^2]
  double static_friction = 0, dynamic_friction = 0;
  double pitch = 0.003;  ///< of the grid [m]
  double period = 0.02;
  unsigned substeps = 1;
  pb::ElasticLaw law = pb::LAW_COROTATED;
  pb::Integrator integrator = pb::INTEGRATOR_BDF2;
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  std::vector<RigidShape> bodies;
  std::vector<PinchCircle> pinches;
  bool tool_contact = false;
};

/// Square of 30 mm, clamped nowhere.
inline ReferenceCase free_sheet() {
  ReferenceCase c;
  c.nx = c.ny = 11;
  c.anchor = -1;
  c.ex = c.ey = 5;
  c.young = 3e4;
  c.poisson = 0.4;
  c.damping = 20;
  return c;
}

inline Scene make_reference_scene(const ReferenceCase& c) {
  Scene scene;
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.set_model(pb::TISSUE_REFERENCE);
  tissue.mutable_grid()->set_count_x(c.nx);
  tissue.mutable_grid()->set_count_y(c.ny);
  tissue.mutable_grid()->set_pitch_m(c.pitch);
  tissue.set_anchor_max_y_m(c.anchor);
  tissue.set_thickness_m(c.thickness);
  tissue.set_static_friction(c.static_friction);
  tissue.set_dynamic_friction(c.dynamic_friction);
  tissue.mutable_material()->set_young_modulus_pa(c.young);
  tissue.mutable_material()->set_poisson_ratio(c.poisson);
  tissue.mutable_material()->set_damping_per_s(c.damping);
  tissue.mutable_material()->set_law(c.law);
  tissue.mutable_reference()->set_elements_x(c.ex);
  tissue.mutable_reference()->set_elements_y(c.ey);
  tissue.mutable_reference()->set_elements_z(c.ez);
  tissue.mutable_reference()->set_substeps(c.substeps);
  tissue.mutable_reference()->set_integrator(c.integrator);
  scene.config.mutable_tool()->set_contact(c.tool_contact);
  scene.gravity = Vector3d(0, 0, -c.gravity);
  scene.tissue.X_WB = c.X_WB;
  scene.tissue.particles = make_grid_particles(tissue.grid());
  for (const Vector3d& p : scene.tissue.particles)
    scene.tissue.fixed.push_back(p.y() <= c.anchor + 1e-9 ? 1 : 0);
  scene.tissue.particle_radius = 0.5 * c.thickness;
  scene.tissue.thickness = c.thickness;
  scene.bodies = c.bodies;
  return scene;
}

inline std::shared_ptr<const ReferenceTissueModel> make_model(const ReferenceCase& c) {
  std::vector<std::string> warnings;
  return make_reference_model(make_reference_scene(c), c.period, warnings, c.pinches);
}

inline Eigen::Isometry3d turned(double degrees, const Vector3d& axis) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.linear() = Eigen::AngleAxisd(degrees * kPi / 180, axis).toRotationMatrix();
  return X;
}

/// Half-space below the plane through `at`, tilted about x_W.
inline RigidShape make_slope(double degrees, const Vector3d& at = Vector3d::Zero()) {
  RigidShape board;
  board.kind = RigidShape::Kind::kHalfSpace;
  board.role = pb::ROLE_BOARD;
  board.X_WS = turned(degrees, Vector3d::UnitX());
  board.X_WS.translation() = at;
  return board;
}

/// Steps with the tool at rest.
inline void run(ReferenceTissue& tissue, int steps, const Vector3d& tip = Vector3d(0, 0, 1)) {
  const ToolMotion still{tip, tip};
  for (int i = 0; i < steps; ++i) tissue.step({&still, 1});
  ASSERT_TRUE(tissue.healthy(0)) << tissue.failure(0);
}

/// Mean over the free edge of what `of` says about a particle.
inline double edge_mean(const ReferenceCase& c, const std::function<double(int)>& of) {
  double sum = 0;
  for (unsigned ix = 0; ix < c.nx; ++ix) sum += of(static_cast<int>(ix * c.ny + c.ny - 1)) / c.nx;
  return sum;
}

inline double rms_difference(const ReferenceTissue& a, const ReferenceTissue& b) {
  double sum = 0;
  for (int i = 0; i < a.particles(); ++i)
    sum += (a.position(0, i) - b.position(0, i)).squaredNorm() / a.particles();
  return std::sqrt(sum);
}

}  // namespace omentum::test
