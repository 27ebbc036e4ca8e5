#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
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

inline constexpr double kSameLine = 1e-9;  ///< [m]: nearer coordinates are one grid line

/// One brick of the mesh (hexahedron.h).
struct ReferenceElement {
  std::array<int, 8> node{};
  Eigen::Vector3d size = Eigen::Vector3d::Zero();  ///< edge lengths at rest [m]
};

/// Where a 3 x 3 block of two nodes lies among the entries of the stiffness matrix; at = -1 where a
/// node is clamped.
struct BlockPlace {
  int at = -1, down = 0, across = 0;
  int entry(int i, int k) const { return at + i * down + k * across; }
};

/// A point of the body: the mean over all elements that touch it, since the parabolas of neighbours
/// differ on the face between them.
struct BodyPoint {
  struct Location {
    int element = 0;
    Eigen::Vector3d xi = Eigen::Vector3d::Zero();  ///< local coordinates, each in [-1, 1]
  };
  std::vector<Location> locations;
  bool fixed = false;  ///< clamped: follows the nodes only
};

/// Node of the lower or upper face, where contact acts.
struct FaceNode {
  int node = 0;
  double area = 0;  ///< of the face that belongs to it [m^2]
};

/// The held patch as rows of constraints on the nodes: its mean position and its mean slopes along
/// x_B, y_B and z_B, each times a length of the patch, so that every row is in metres. Row r is
/// sum_k weight(k, r) x_node[k].
struct GraspPatch {
  static constexpr int kRows = 4;
  std::vector<int> node;
  Eigen::Matrix<double, Eigen::Dynamic, kRows> weight;
  std::vector<std::int32_t> particles;  ///< grid particles in the patch, ascending, never empty
};

/// Both faces under a pad of the jaws: columns of nodes and the area of the pad that each bears.
struct GraspPad {
  std::vector<int> lower, upper;        ///< node of each face, per column
  std::vector<double> area;             ///< [m^2]
  std::vector<std::int32_t> particles;  ///< grid particles under it, ascending, never empty
};

/// A Gauss point of the bed under a clamp that gives way: on one grid line across, between two rows
/// and two layers of its nodes. Of a clamp without a strip the rows are one, the shares of the
/// second zero.
struct BedPoint {
  std::array<int, 4> node{};
  std::array<double, 4> share{};
  double length = 0;     ///< of the clamp that it bears [m]
  double stiffness = 0;  ///< [N/m]
};

/// Model of the converged solid (docs/tissue.md 13): a sheet of the grid maker as a box of bricks,
/// thickness_m thick, its mid-surface through the particles; particle_radius_m does not apply. A
/// grid line lies on the edge of each clamp, y_B = anchor_max_y_m and anchor_min_y_m; material
/// beyond them is rigid.
struct ReferenceTissueModel : TissueModel, std::enable_shared_from_this<ReferenceTissueModel> {
  /// Throws Error: double precision only.
  std::unique_ptr<Tissue<float>> make_tissue(const LaneKernel<float>& kernel) const override;
  /// Throws Error unless the kernel has one lane.
  std::unique_ptr<Tissue<double>> make_tissue(const LaneKernel<double>& kernel) const override;
  std::uint32_t substeps() const override { return numerics.substeps(); }

  /// Patch of the circle around `centre` (x_B, y_B of the rest sheet [m]) as far as it is free
  /// tissue, weighted by area; continuous in centre and radius. Holding the mean is a little more
  /// compliant than a glued rigid disc, like one of 0.78 of the radius in plane (from the
  /// logarithmic field around a disc), but converges faster with the mesh.
  GraspPatch make_patch(const Eigen::Vector2d& centre, double radius) const;
  /// The nodes under the pad of scene.tool.grip around `centre` that are free, or the nearest one.
  GraspPad make_pad(const Eigen::Vector2d& centre, double radius) const;
  BodyPoint locate(const Eigen::Vector3d& p_B) const;
  /// Elements along an axis.
  int cells(int axis) const { return static_cast<int>(lines[axis].size()) - 1; }
  int node_index(int ix, int iy, int iz) const {
    return (iy * (cells(0) + 1) + ix) * (cells(2) + 1) + iz;
  }
  int element_index(int ix, int iy, int iz) const { return (iy * cells(0) + ix) * cells(2) + iz; }
  /// Of them along y those that are not in the strips beyond the clamp edges.
  int free_cells_y() const { return cells(1) - strip_cells() - second_strip_cells(); }
  int strip_cells() const {
    return static_cast<int>(
        std::ranges::count_if(lines[1], [this](double y) { return y < clamp_edge - kSameLine; }));
  }
  int second_strip_cells() const {
    return static_cast<int>(
        std::ranges::count_if(lines[1], [this](double y) { return y > second_edge + kSameLine; }));
  }
  /// Batches of Pack::kLanes elements.
  std::size_t batches() const { return (elements.size() + Pack::kLanes - 1) / Pack::kLanes; }
  /// The sheet without its clamps in x_B, y_B [m].
  Eigen::AlignedBox2d free_sheet() const {
    return {Eigen::Vector2d(lines[0].front(), clamp_edge),
            Eigen::Vector2d(lines[0].back(), second_edge)};
  }

  pb::ReferenceModel numerics;
  pb::Material material;
  Lame lame;
  /// Of the jaws, per row of the patch [m/N]: as good as rigid (docs/decisions/0013), but not 0,
  /// since the rows of a small patch next to the clamp may depend on each other.
  double grasp_compliance = 1e-9;

  std::array<std::vector<double>, 3> lines;  ///< grid lines along x, y, z of B [m]
  double clamp_edge = 0;                     ///< y_B of the clamp edge, or the lower end [m]
  double second_edge = 0;                    ///< of the second clamp, or the upper end [m]
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
  std::vector<BodyPoint> particle_points;             ///< of the grid particles
  std::vector<BodyPoint> upper_points, lower_points;  ///< of the faces above and below them

  // Effects that are part of the mesh. A change of bending by f is a sheet of thickness t sqrt(f),
  // modulus E / sqrt(f) and density rho / sqrt(f): stretch and weight stay, bending is f times.
  double face_inset = 0;      ///< contact faces lie this much inside the mesh's [m]
  std::vector<HexRest> rest;  ///< per batch; empty = boxes
  /// Per batch and Gauss point: how many times as stiff it is there; empty = 1.
  std::vector<std::array<Pack, kHexPoints>> stiffness;
  std::vector<std::uint8_t> is_anchor;  ///< per node: clamped in the scene, free to give way here
  std::vector<double> anchor;           ///< spring per node, of a clamp detached in part [N/m]
  std::vector<BedPoint> bed;            ///< of a clamp with a compliance
  /// Per point of the bed: node blocks (a, b), a >= b, at a (a + 1) / 2 + b.
  std::vector<std::array<BlockPlace, 10>> bed_blocks;
  std::vector<double> node_area;   ///< sheet area of each node, through all layers [m^2]
  std::vector<double> face_area;   ///< of each node of a face, else 0 [m^2]
  std::vector<double> added_mass;  ///< part of `mass`, per node [kg]; empty = none
  /// By how much clamped nodes give way to forces on them [N] on an even bed, per 1 / K [m^2/N];
  /// zero at others.
  std::vector<Eigen::Vector3d> bed_give(std::span<const Eigen::Vector3d> force) const;
  /// By how much a clamped node gives way per force, per length of a detached piece around x_B
  /// [1/N].
  double piece_compliance(std::size_t node, double x) const;
  /// Rectangle of the sheet that belongs to a node, x_B and y_B [m].
  Eigen::AlignedBox2d node_box(std::size_t node) const;
  /// At rest, p_B [m].
  Eigen::Vector3d gauss_point(const ReferenceElement& element, int point) const;
};

/// Where a recording pinches the sheet: x_B and y_B at rest and radius of the patch [m].
struct PinchCircle {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius = 0;
  /// Of the centre from where grid lines are counted off: a pad that is displaced takes its lines
  /// along, as many on each side as before, so that surfaces change smoothly with its place [m].
  Eigen::Vector2d displaced = Eigen::Vector2d::Zero();
};

/// Meshes the scene's sheet; throws Error where the tissue is not a grid or an effect does not fit.
/// Grid lines lie, and are denser, at the clamp edge and the sides of the squares around `pinches`;
/// with `mesh_of`, a model of the same sheet, they are that model's.
std::shared_ptr<const ReferenceTissueModel> make_reference_model(
    const Scene& scene, double control_period, std::vector<std::string>& warnings,
    std::span<const PinchCircle> pinches = {}, const ReferenceTissueModel* mesh_of = nullptr);

/// Shape functions of the eight nodes at xi.
std::array<double, 8> hex_functions(const Eigen::Vector3d& xi);

/// Displacement of a point inside an element of edges `size` with nodes x against its nodes [m]:
/// parabolas sum_k (1 - xi_k^2) u_k in place of the modes, whose strain in the deformed frame is
/// nearest to that of the modes (docs/decisions/0028). At small strain u_kj = -m_kj size_k / (2
/// size_j).
class HexBow {
 public:
  HexBow(const Eigen::Vector3d& size, const std::array<Eigen::Vector3d, 8>& x,
         const std::array<double, 9>& mode, const Eigen::Vector3d& xi);
  const Eigen::Vector3d& value() const { return value_; }
  /// By how much it changes with the nodes and the modes.
  Eigen::Vector3d rate(const std::array<Eigen::Vector3d, 8>& dx,
                       const std::array<double, 9>& dmode) const;

 private:
  double parabola(int k) const;
  Eigen::Vector3d direction(int k) const;

  Eigen::Vector3d size_, xi_;
  Eigen::Matrix3d F_, across_;  ///< in the middle, and its inverse transpose
  Eigen::Matrix3d slopes_;      ///< of the modes, F0 xi_k e_k (x) column k
  Eigen::Vector3d value_;
};

}  // namespace omentum
