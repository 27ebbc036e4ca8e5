#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/shell/plate_stencils.h"
#include "sim_worker/shell/shell_kernel.h"
#include "sim_worker/tissue/effect_catalogue.h"
#include "sim_worker/tissue/panel_cholesky.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// Mass and stiffness of the shell with the effects that shape them (EffectValues::same_structure).
struct ShellStructure {
  std::vector<double> mass;  ///< per node: rho t A / 3 of each of its triangles, no change of
                             ///< density [kg]
  std::vector<Eigen::Vector4d> plate;  ///< per stencil (plate_stiffness) [N m^3], nominal E
  NodeMatrix bending;                  ///< the same as a matrix over nodes (plate_matrix) [N/m]
  double shear = 0;                    ///< 2 mu t a_T / pitch^2 [N/m], nominal E
  double area = 0;                     ///< lambda t a_T / pitch^2 [N/m], nominal E, plane stress
  /// Factor on both: of a grid per cell = (count_y - 1) ix + iy, of a mesh per triangle, where it
  /// contains 2 a_T / pitch^2.
  std::vector<double> cell;
  bool uniform = true;  ///< every factor is 1
};

/// What the jaws hold of the shell, as rows over its nodes: the mean position of the patch and its
/// mean slopes along x_B and y_B. Row r of the patch is sum_k weight(k, r) x_node[k]; the weights
/// of the mean sum to 1, the largest of a slope is 1. (The slope through the thickness, which the
/// reference holds too, follows from the others: a shell has no shear.)
struct SheetPatch {
  std::vector<std::int32_t> node;  ///< ascending
  Eigen::Matrix<double, Eigen::Dynamic, kPatchRows> weight;
  /// Of a pad, instead of weights: its area on each node [m^2], and how far it holds the node, 1
  /// under it and falling to 0 one pitch beyond its rim, so that the rim is where it is.
  std::vector<double> area, hold;
  std::vector<std::int32_t> inside;  ///< free nodes in the disc, ascending; else the nearest one
};

/// Immutable half of the elastic shell: triangles of a law in plane stress, those of the grid sheet
/// with alternating diagonals or those of a mesh (scene.tissue.sheet), plate bending along the
/// normal (plate_stencils.h), material in SI units that does not depend on the step (docs/tissue.md
/// 6). Safe to share by threads.
struct ShellTissueModel : TissueModel, std::enable_shared_from_this<ShellTissueModel> {
  std::unique_ptr<Tissue<float>> make_tissue(const LaneKernel<float>& kernel) const override;
  std::unique_ptr<Tissue<double>> make_tissue(const LaneKernel<double>& kernel) const override;
  std::uint32_t substeps() const override { return parameters.substeps(); }

  pb::Material material;
  pb::ElasticModel parameters;
  int count_x = 0, count_y = 0;  ///< nodes of a grid; index = count_y ix + iy
  SheetGeometry mesh;            ///< instead of the grid, where it has triangles
  double pitch = 0;              ///< of the grid, mean edge of a mesh [m]
  double thickness = 0, density = 0;
  ShellStructure structure;             ///< with the scene's effects
  std::vector<double> anchor;           ///< spring per node at the scene's effects [N/m]; 0 = none
  std::vector<double> anchor_turn;      ///< the same of make_anchor_turn() [N/m]
  std::vector<std::uint8_t> is_anchor;  ///< per node: clamped in the scene, held by springs here
  std::vector<double> node_area;        ///< [m^2]
  std::vector<double> added_mass;       ///< per node [kg]; empty = none
  /// A without its mass, at nominal E and the scene's effects [N/m]: entries as those of `bending`,
  /// and the diagonal; zero at fixed nodes.
  std::vector<double> preconditioner, preconditioner_diagonal;
  std::vector<PlateStencil> stencils;  ///< of its bending
  double clamp_edge = 0;      ///< y_B of the clamped row that is furthest in, or the lower end [m]
  double second_edge = 0;     ///< of the second clamp, or the upper end [m]
  bool on_soft_body = false;  ///< scene.soft_body, which ShellTissue::lie_on() names

  ShellLaw law() const;
  int nodes() const { return static_cast<int>(body.particles.size()); }
  bool is_mesh() const { return !mesh.triangles.empty(); }
  int triangles() const {
    return is_mesh() ? static_cast<int>(mesh.triangles.size()) : 2 * (count_x - 1) * (count_y - 1);
  }
  bool is_curved() const;  ///< at rest; only a mesh can be
  /// Width of the patch of tissue that belongs to a node, the rim apart [m].
  double node_size(int i) const;
  /// Of a node of a sheet that is so many times as dense as the scene's [kg].
  double mass_at(std::size_t i, double times_as_dense) const {
    const double sheet = times_as_dense * structure.mass[i];
    return added_mass.empty() ? sheet : sheet + added_mass[i];
  }
  /// E t [N/m].
  double membrane_stiffness() const { return material.young_modulus_pa() * thickness; }
  /// The grid sheet at rest, x_B and y_B [m].
  Eigen::AlignedBox2d sheet() const;
  /// The nodes around a point of the grid sheet at rest and their bilinear weights.
  struct NodeWeights {
    std::array<std::int32_t, 4> node{};
    std::array<double, 4> weight{};
  };
  NodeWeights locate(const Eigen::Vector2d& X) const;
  /// Whether jaws can hold the disc around `centre` (p_B at rest on the middle surface [m]).
  bool can_hold(const Eigen::Vector3d& centre, double radius) const;
  /// Patch of a disc that they can hold; of a mesh without nodes where no tissue is.
  SheetPatch make_patch(const Eigen::Vector3d& centre, double radius) const;
  /// The nodes under the pad of scene.tool.grip, as far as they are free.
  SheetPatch make_pad(const Eigen::Vector3d& centre, double radius) const;
  /// What the jaws of the scene hold: make_pad() or make_patch().
  SheetPatch make_grip(const Eigen::Vector3d& centre, double radius) const {
    return surroundings.grip.pad ? make_pad(centre, radius) : make_patch(centre, radius);
  }
  /// Step of the implicit equation: h, or 2 h / 3 for BDF2 [s].
  double effective_step() const;
  bool has_contact() const {
    return !surroundings.bodies.empty() || surroundings.tool_contact || on_soft_body;
  }

  ShellStructure make_structure(const EffectValues& effects) const;
  /// Factor on the energy of a stencil on the edge of a clamp (PlateStencil::clamp) with effects.
  Eigen::Vector4d clamp_factor(const PlateStencil& stencil, const EffectValues& effects) const;
  /// Moments xx, yy, xy of the rest curvature at each stencil, times its area [N m^2], nominal E.
  std::vector<Eigen::Vector3d> make_rest_moments(const EffectValues& effects) const;
  /// Springs of the clamp per node [N/m]; 0 where the effects do not touch it.
  std::vector<double> make_anchor(const EffectValues& effects) const;
  /// Of a grid whose clamp lies on a bed, even over its strip and the thickness t: coupling of each
  /// clamped node with the next one along y_B [N/m]. Between two rows, h apart, that a bed of Q per
  /// area holds by Q h / 2 each, the bed's energy is Q h / 2 (|u|^2 + (h^2 + t^2) / 12 |u'|^2) per
  /// length of the clamp, u the mean of both displacements and u' their difference over h, since
  /// the normal of the sheet turns by u' with it. The two springs alone have h^2 / 4 there, so the
  /// coupling is Q h (t^2 / h^2 - 2) / 12.
  std::vector<double> make_anchor_turn(const EffectValues& effects) const;

  /// Makes `preconditioner` and `preconditioner_diagonal` from the rest of the model.
  void make_preconditioner();
  /// Factor key of a lane: the number of the smallest step of a geometric grid of moduli that is
  /// not below E. It depends on the lane's own parameters only (docs/tissue.md 8).
  static int factor_key(double stiffness_scale);
  /// The same with effects; `peak` is the largest tangent over nominal stiffness of late. Density
  /// has a grid of its own.
  int factor_key(double stiffness_scale, const EffectValues& effects,
                 const ShellStructure& structure, double peak) const;
  /// E of a key's factor / nominal E, and its density / that of the scene without effects.
  static double key_stiffness(int key);
  double key_density(int key) const;
  /// Factor of a key; made once, then shared.
  std::shared_ptr<const PanelFactor> factor(int key) const;

 private:
  mutable std::mutex mutex_;
  mutable std::map<int, std::shared_ptr<const PanelFactor>> factors_;  // guarded by mutex_
};

/// Of the grid, none of a mesh: calls fn(x-leg tail, x-leg head, y-leg tail, y-leg head) for the
/// two triangles of every cell, in the order of shell_kernel.inl.
template <typename Function>
void for_each_triangle(const ShellTissueModel& model, Function&& fn) {
  for (int ix = 0; ix + 1 < model.count_x; ++ix) {
    for (int iy = 0; iy + 1 < model.count_y; ++iy) {
      const int a = model.count_y * ix + iy;
      const int b = a + model.count_y;
      const int c = b + 1;
      const int e = a + 1;
      if ((ix + iy) % 2 == 0) {
        fn(a, b, b, c);
        fn(e, c, a, e);
      } else {
        fn(a, b, a, e);
        fn(e, c, b, c);
      }
    }
  }
}

/// Makes the shell of the scene's grid or mesh sheet. Throws Error for the law of solids.
std::shared_ptr<const ShellTissueModel> make_shell_model(const Scene& scene, double control_period,
                                                         std::vector<std::string>& warnings);

}  // namespace omentum
