#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/geometry/solid_mesh.h"
#include "sim_worker/tissue/panel_cholesky.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// Constants of stable neo-Hooke whose small strain has the Lame constants of E and nu and whose
/// rest is at F = 1 [Smith18, section 3.4].
struct SolidLaw {
  double shear = 0;                      ///< mu of small strain, what effects are relative to [Pa]
  double mu = 0, lambda = 0, alpha = 0;  ///< [Pa, Pa, 1]
  double local = 0;                      ///< of small strain's lambda what acts at points [Pa]
  double bulk = 0;                       ///< the rest, on the mean volume of an element [Pa]
};
SolidLaw make_solid_law(double young_modulus, double poisson_ratio);

/// Immutable half of the elastic solid: quadratic tetrahedra of stable neo-Hooke material in SI
/// units (docs/decisions/0018). Safe to share by threads.
struct SolidTissueModel : TissueModel, std::enable_shared_from_this<SolidTissueModel> {
  std::unique_ptr<Tissue<float>> make_tissue(const LaneKernel<float>& kernel) const override;
  std::unique_ptr<Tissue<double>> make_tissue(const LaneKernel<double>& kernel) const override;
  std::uint32_t substeps() const override { return parameters.substeps(); }

  pb::Material material;
  pb::ElasticModel parameters;
  SolidMesh mesh;
  std::vector<double> gradient;    ///< [tetrahedron][corner][xyz] of the volume coordinates [1/m]
  std::vector<double> volume;      ///< of each tetrahedron [m^3]
  std::vector<double> mass;        ///< per node [kg]
  std::vector<double> added_mass;  ///< per node, beside that [kg]; empty = none
  std::vector<std::uint8_t> on_surface;  ///< per node
  double spacing = 0;                    ///< half of the longest edge asked for [m]
  SolidLaw law;                          ///< with the scene's effects
  /// Of the preconditioner on the free nodes: M/h^2 + 2 mu_Lame x Laplace with the scene's effects,
  /// or, `by_component`, the Hessian at rest, rows 3 i + axis.
  PanelFactor factor;
  bool by_component = false;
  std::vector<double> diagonal;  ///< per node, of M/h^2 + 2 mu_Lame x Laplace [N/m]

  std::vector<std::uint8_t> is_anchor;  ///< per node: clamped, but free for the anchor's effects
  std::vector<double> anchor;           ///< per node: fresh spring of the scene's anchor [N/m]
  bool beside_sheet = false;            ///< the scene's deformable body, not its tissue

  /// Those of a lane's effects that are this body's: beside a sheet only of what surrounds both and
  /// of the jaws.
  EffectValues own_effects(const EffectValues& values) const;
  /// Springs of the clamped nodes under the effects of the anchor, zero where there is none [N/m].
  std::vector<double> make_anchor(const EffectValues& values) const;
  /// Integration point of a tetrahedron at rest, p_B [m].
  Eigen::Vector3d integration_point(std::size_t tetrahedron, int q) const;

  int nodes() const { return static_cast<int>(mesh.nodes.size()); }
  /// Step of the implicit equation: h, or 2 h / 3 for BDF2 [s].
  double effective_step() const;
  /// Of a node of a body that is so many times as dense [kg].
  double mass_at(std::size_t i, double density) const {
    return added_mass.empty() ? mass[i] * density : mass[i] * density + added_mass[i];
  }
};

/// Makes the solid of the scene's volume. Throws Error for another law than stable neo-Hooke.
std::shared_ptr<const SolidTissueModel> make_solid_model(const Scene& scene, double control_period);

/// Makes the scene's deformable body (scene.soft_body). Throws Error for another law, and where it
/// overlaps a rigid body at rest.
std::shared_ptr<const SolidTissueModel> make_soft_body_model(const Scene& scene,
                                                             double control_period);

}  // namespace omentum
