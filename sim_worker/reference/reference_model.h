#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/reference/frontal_cholesky.h"
#include "sim_worker/reference/hexahedron.h"
#include "sim_worker/reference/hyperelastic_law.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// One brick of the mesh (sim_worker/reference/hexahedron.h).
struct ReferenceElement {
  std::array<int, 8> node{};
  Eigen::Vector3d size = Eigen::Vector3d::Zero();  ///< edge lengths at rest [m]
  double stiffness = 1;                            ///< factor on the Lame constants
};

/// Where a 3 x 3 block of two nodes lies among the entries of the stiffness matrix: entry (i, k) at
/// at + i down + k across. Nowhere (-1) where one is clamped.
struct BlockPlace {
  int at = -1, down = 0, across = 0;
};

/// A point of the body as the elements around it see it. On a face between elements the parabolas
/// of the neighbours differ, so the point is the mean over all elements that touch it.
struct BodyPoint {
  struct Share {
    int element = 0;
    Eigen::Vector3d xi = Eigen::Vector3d::Zero();  ///< local coordinates, each in [-1, 1]
  };
  std::vector<Share> shares;
  bool fixed = false;  ///< clamped: follows the nodes only
};

/// Node of the lower or upper face, where contact acts.
struct FaceNode {
  int node = 0;
  double area = 0;  ///< of the face that belongs to it [m^2]
};

/// What the jaws hold, as rows of constraints on the nodes: the mean position of the patch and its
/// mean slopes along x_B, y_B and z_B, each times a length of the patch, so that every row is in
/// metres. Row r of the patch is sum_k weight(k, r) x_node[k].
struct GraspPatch {
  static constexpr int kRows = 4;
  std::vector<int> node;
  Eigen::Matrix<double, Eigen::Dynamic, kRows> weight;
  std::vector<std::int32_t> particles;  ///< grid particles in the patch, ascending, never empty
};

/// The converged solid: immutable half (docs/tissue.md 13). A sheet of the grid maker as a box
/// of bricks: it spans the grid in x_B and y_B and is thickness_m thick, its mid-surface through
/// the particles. The lower face therefore starts thickness_m / 2 below the particles;
/// particle_radius_m does not apply. One grid line lies on the clamp edge y_B = anchor_max_y_m;
/// material beyond it is rigid.
struct ReferenceTissueModel : TissueModel, std::enable_shared_from_this<ReferenceTissueModel> {
  /// Throws Error: double precision only.
  std::unique_ptr<Tissue<float>> make_tissue(const LaneKernel<float>& kernel) const override;
  /// Throws Error unless the kernel has one lane.
  std::unique_ptr<Tissue<double>> make_tissue(const LaneKernel<double>& kernel) const override;
  std::uint32_t substeps() const override { return numerics.substeps(); }

  /// Patch of the circle around `centre` (x_B, y_B of the rest sheet [m]) as far as it is free
  /// tissue, every part weighted by its area. Changes continuously with centre and radius. Where a
  /// glued rigid pad would load its rim, this holds the mean: it gives way a little more, like a
  /// rigid disc of 0.78 of the radius in plane (from the logarithmic field around a disc), but
  /// converges faster with the mesh.
  GraspPatch make_patch(const Eigen::Vector2d& centre, double radius) const;
  BodyPoint locate(const Eigen::Vector3d& p_B) const;
  int node_index(int ix, int iy, int iz) const {
    const int nx = static_cast<int>(lines[0].size());
    const int nz = static_cast<int>(lines[2].size());
    return (iy * nx + ix) * nz + iz;
  }
  int element_index(int ix, int iy, int iz) const {
    const int nx = static_cast<int>(lines[0].size()) - 1;
    const int nz = static_cast<int>(lines[2].size()) - 1;
    return (iy * nx + ix) * nz + iz;
  }

  pb::ReferenceModel numerics;
  pb::Material material;
  Lame lame;
  /// Of the jaws, per row of the patch [m/N]. The patch is as good as rigid: with 1e-8 a stretched
  /// sheet of 200 kPa is 0.004 mm rms from one with 0 (docs/decisions/0013). Not 0, since of a
  /// small patch next to the clamp the rows may depend on each other.
  double grasp_compliance = 1e-9;

  std::array<std::vector<double>, 3> lines;  ///< grid lines along x, y, z of B [m]
  double clamp_edge = 0;                     ///< y_B of the clamp edge, or the lower end [m]
  std::vector<Eigen::Vector3d> nodes;        ///< p_B at rest [m]
  std::vector<double> mass;                  ///< lumped, per node [kg]
  double total_mass = 0;                     ///< [kg]
  std::vector<int> unknown;                  ///< first of three per node, -1 = clamped
  int unknowns = 0;
  Dissection order;  ///< of elimination
  std::vector<ReferenceElement> elements;
  /// Per element: node blocks (a, b), a >= b, at a (a + 1) / 2 + b, as HexTangent has them.
  std::vector<std::array<BlockPlace, 36>> element_blocks;
  std::vector<BlockPlace> node_blocks;  ///< of every node with itself
  std::vector<FaceNode> face_nodes;
  std::vector<BodyPoint> particle_points;  ///< of the grid particles

  // Effects that are part of the mesh. A change of bending is a sheet of thickness t sqrt(f),
  // modulus E / sqrt(f) and density rho / sqrt(f): stretch and weight stay, bending is f times.
  double face_inset = 0;                ///< the real faces lie this much further in [m]
  std::vector<HexRest> rest;            ///< per four elements; empty = boxes
  std::vector<std::uint8_t> is_anchor;  ///< per node: clamped in the scene, held by springs here
  std::vector<double> anchor;           ///< spring per node [N/m]
  std::vector<double> node_area;        ///< sheet area of each node, through all layers [m^2]
  std::vector<double> face_area;        ///< of each node of a face, else 0 [m^2]
};

/// Where a recording pinches the sheet, known before the mesh is made: x_B and y_B at rest and the
/// radius of the patch [m].
struct PinchCircle {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius = 0;
};

/// Meshes the scene's sheet; throws Error where the tissue is not a grid. Grid lines crowd at the
/// clamp edge and at the sides of the squares around `pinches`, and lie on them.
std::shared_ptr<const ReferenceTissueModel> make_reference_model(
    const Scene& scene, double control_period, std::vector<std::string>& warnings,
    std::span<const PinchCircle> pinches = {});

/// Shape functions of the eight nodes at xi.
std::array<double, 8> hex_functions(const Eigen::Vector3d& xi);

}  // namespace omentum
