#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/panel_cholesky.h"
#include "sim_worker/solid_mesh.h"
#include "sim_worker/tissue.h"

namespace omentum {

/// Immutable half of the elastic solid: quadratic tetrahedra of stable neo-Hooke material in SI
/// units (docs/decisions/0018). Safe to share by threads.
struct SolidTissueModel : TissueModel, std::enable_shared_from_this<SolidTissueModel> {
  std::unique_ptr<Tissue<float>> make_tissue(const Kernel<float>& kernel) const override;
  std::unique_ptr<Tissue<double>> make_tissue(const Kernel<double>& kernel) const override;
  std::uint32_t substeps() const override { return parameters.substeps(); }

  pb::Material material;
  pb::ElasticModel parameters;
  EffectValues effects;  ///< of the scene
  SolidMesh mesh;
  std::vector<double> gradient;  ///< [tetrahedron][corner][xyz] of the volume coordinates [1/m]
  std::vector<double> volume;    ///< of each tetrahedron [m^3]
  std::vector<double> mass;      ///< per node [kg]
  std::vector<std::uint8_t> on_surface;  ///< per node
  double spacing = 0;                    ///< half of the longest edge asked for [m]
  double mu = 0, lambda = 0, alpha = 0;  ///< [Smith18, section 3.4] from E and nu [Pa, Pa, 1]
  double bulk = 0;                       ///< acts on the mean volume of an element [Pa]
  /// Of the preconditioner on the free nodes: M/h^2 + 2 mu_Lame x Laplace, or, `by_component`, the
  /// Hessian at rest, rows 3 i + axis.
  PanelFactor factor;
  bool by_component = false;
  std::vector<double> diagonal;  ///< per node, of M/h^2 + 2 mu_Lame x Laplace [N/m]
  double static_friction = 0, dynamic_friction = 0;
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();  ///< in W [m/s^2]
  std::vector<RigidShape> contact_bodies;             ///< what nodes collide with, the tool apart
  bool tool_contact = false;
  double tool_radius = 0, tool_start = 0,
         tool_length = 0;  ///< capsule along the shaft, behind the tip [m]
  Eigen::Vector3d shaft_axis = Eigen::Vector3d::UnitZ();  ///< from the tip up the shaft, in W

  int nodes() const { return static_cast<int>(mesh.nodes.size()); }
  double substep() const { return control_period / parameters.substeps(); }
  /// Step of the implicit equation: h, or 2 h / 3 for BDF2 [s].
  double effective_step() const;
};

/// Makes the solid of the scene's volume. Throws Error for another law than stable neo-Hooke.
std::shared_ptr<const SolidTissueModel> make_solid_model(const Scene& scene, double control_period);

/// Makes the scene's deformable body (scene.soft_body). Throws Error for another law, and where it
/// overlaps a rigid body at rest.
std::shared_ptr<const SolidTissueModel> make_soft_body_model(const Scene& scene,
                                                             double control_period);

/// Elastic energy of node positions p [m] at nominal stiffness, zero at rest [J]. For tests of the
/// forces.
double solid_energy(const SolidTissueModel& model, std::span<const Eigen::Vector3d> p);

}  // namespace omentum
