#pragma once

#include <memory>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace omentum {

/// Triangle mesh. Vertices in the body frame B [m]; triangles are counter-clockwise seen from outside.
struct TriangleMesh {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Eigen::Vector3i> triangles;
};

/// Reads OBJ (v and f lines; polygons are fanned) or STL (ASCII or binary; equal vertices are merged), scaled to
/// metres. Throws Error naming file and line (or byte) for a missing, malformed, empty, huge or non-finite file.
TriangleMesh load_mesh(const std::string& path, double unit_m);

/// As load_mesh, and throws Error naming file and one offending edge unless the surface is closed and consistently
/// oriented (each directed edge exactly once, its reverse exactly once). An inside-out mesh is turned.
TriangleMesh load_closed_mesh(const std::string& path, double unit_m);

/// Parses mesh text or bytes; `name` is used in messages only. The entry of the fuzz target.
TriangleMesh parse_mesh(const std::string& name, const std::string& content, double unit_m);
void require_closed(const std::string& name, TriangleMesh& mesh);

/// Volume enclosed by a closed mesh [m^3], positive when triangles face outside.
double signed_volume(const TriangleMesh& mesh);

/// Generalised winding number of the point (1 inside, 0 outside of a closed mesh) [Jacobson13].
double winding_number(const TriangleMesh& mesh, const Eigen::Vector3d& point);

/// Tessellations of the analytic shapes, for pictures and for exposure samples.
TriangleMesh make_ellipsoid_mesh(const Eigen::Vector3d& semi_axes, int rings, int sectors);
TriangleMesh make_box_mesh(const Eigen::Vector3d& half_extents);
/// Capsule from p0 to p1.
TriangleMesh make_capsule_mesh(const Eigen::Vector3d& p0, const Eigen::Vector3d& p1, double radius, int sectors);

/// Signed distance of a closed mesh on a regular grid, negative inside; trilinear between nodes. The hot path reads
/// the raw arrays; outside the grid nothing is in contact (the margin exceeds any contact distance).
struct SdfGrid {
  Eigen::Vector3d origin;    ///< position of node (0,0,0) in the body frame [m]
  double pitch = 0;          ///< node distance [m]
  Eigen::Vector3i count;     ///< nodes per axis
  std::vector<float> value;  ///< x fastest: index = i + nx (j + ny k) [m]
};

/// Grid with at most `max_nodes` per axis and a margin of `margin` around the mesh [m].
SdfGrid make_sdf_grid(const TriangleMesh& mesh, int max_nodes, double margin);

}  // namespace omentum
