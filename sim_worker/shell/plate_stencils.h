#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "sim_worker/geometry/sheet_mesh.h"

// Where and how the shell bends: the plate energy as a sum over curvature stencils, of a grid by
// finite differences, of a mesh by the quadratic fits around its nodes (docs/tissue.md 6,
// docs/decisions/0022). Free functions on plain structs: any thread may call them.

// shell/ is the elastic sheet in SI units (docs/tissue.md 6-9): membrane and plate, implicit steps,
// contact forces by sparse sweeps, a grasp that holds mean position and slopes. shell_tissue.cpp
// has the step, shell_kernel.inl the arithmetic, shell_model.cpp what all lanes share.

namespace omentum {

/// Curvatures xx, yy, xy towards the normal [1/m] of a sheet whose nodes are at these places [m].
Eigen::Vector3d curvature(const CurvatureStencil& stencil, std::span<const Eigen::Vector3d> places);

/// Part of the plate energy around a point of the sheet:
///   area B / 2 (fraction_0 kxx^2 + fraction_1 kyy^2 + 2 nu fraction_2 kxx kyy + 2 (1 - nu)
///   fraction_3 kxy^2)
/// with B = E t^3 / 12 (1 - nu^2), of a beam without the 1 - nu^2.
struct PlateStencil {
  CurvatureStencil at;
  Eigen::Vector3d place = Eigen::Vector3d::Zero();     ///< p_B at rest [m]
  Eigen::Vector3d rest = Eigen::Vector3d::Zero();      ///< curvatures of the rest shape [1/m]
  Eigen::Vector4d fraction = Eigen::Vector4d::Zero();  ///< the edge of the clamp apart
  /// Factor on `fraction`: 2 where the stencil is centred on the edge of the clamp. It bends on its
  /// free side only, half a cell long: the same rotation there is twice the curvature, which
  /// doubles the energy. Counted once, the plate would be clamped half a cell inside the clamp, 1.5
  /// mm at a pitch of 3 mm, the membrane at it (benchmarks/compare_elastic.cpp).
  Eigen::Vector4d clamp = Eigen::Vector4d::Ones();
  double area = 0;    ///< [m^2]
  bool beam = false;  ///< a strip along a free rim: no moment across it, so it bends as a beam
};

/// Whether a node of this number is clamped.
using IsClamped = std::function<bool(std::int32_t)>;

// The first stencils are those of the nodes in their order: each defines the normal there too.

/// Of a grid, node = count_y ix + iy; those of the cells follow. The bending moment across a free
/// rim is zero, so that rows on the rim are beams, half a cell wide, and corners do not bend; the
/// twist is that of each cell.
std::vector<PlateStencil> grid_stencils(std::span<const Eigen::Vector3d> nodes, int count_x,
                                        int count_y, double pitch, const IsClamped& is_clamped);

/// Of a mesh, one per node. The natural conditions of a free rim follow by themselves.
std::vector<PlateStencil> mesh_stencils(const SheetGeometry& mesh,
                                        std::span<const Eigen::Vector3d> nodes,
                                        const IsClamped& is_clamped);

/// Moment per curvature xx, yy, xx by yy, xy, times the area, `fraction` being the stencil's own or
/// that times `clamp` [N m^3]; `beam` is E t^3 / 12 there [N m].
Eigen::Vector4d plate_stiffness(const PlateStencil& stencil, const Eigen::Vector4d& fraction,
                                double beam, double nu);

/// Moments xx, yy, xy from curvatures.
Eigen::Vector3d plate_moments(const Eigen::Vector4d& stiffness, const Eigen::Vector3d& curvature);

/// Off-diagonal entries of a symmetric matrix over nodes whose rows sum to zero, by rows,
/// ascending.
struct NodeMatrix {
  std::vector<std::int32_t> begin;  ///< nodes + 1
  std::vector<std::int32_t> node;
  std::vector<double> value;
};

/// Matrix of the plate energy if the curvatures acted on every coordinate alone [N/m]: it bounds
/// the stiffness of the plate however the sheet is rotated.
NodeMatrix plate_matrix(int nodes, std::span<const PlateStencil> stencils,
                        std::span<const Eigen::Vector4d> stiffness);

}  // namespace omentum
