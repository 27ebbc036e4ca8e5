#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "sim_worker/geometry/mesh.h"

namespace omentum {

/// Straight-edged quadratic tetrahedra: four corners and the middles of six edges each. Linear
/// tetrahedra would lock in bending and near incompressibility.
struct SolidMesh {
  std::vector<Eigen::Vector3d> nodes;  ///< p_B at rest [m]
  /// Corners 0-3 (positive volume), then the middles of the edges of kSolidEdge.
  std::vector<std::array<std::int32_t, 10>> tetrahedra;
  /// Each outer face of a tetrahedron as four triangles over corners and middles, counter-clockwise
  /// seen from outside.
  std::vector<Eigen::Vector3i> surface;
};

/// Edge of each middle node: corners of node 4 + k.
inline constexpr int kSolidEdge[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};

/// Fills a closed mesh with tetrahedra of at most `edge_length` [m] by the program solid_mesher,
/// which lies beside this one. `name` is used in messages. Throws Error if that fails.
SolidMesh fill_mesh(const TriangleMesh& surface, const std::string& name, double edge_length);

/// Reads what solid_mesher wrote and adds the middles. Total: any content gives a mesh or an Error
/// naming the file and what is wrong.
SolidMesh parse_solid_mesh(const std::string& name, const std::string& content);

/// Volume of a tetrahedron from its corners [m^3].
double tetrahedron_volume(const SolidMesh& mesh, const std::array<std::int32_t, 10>& tetrahedron);

}  // namespace omentum
