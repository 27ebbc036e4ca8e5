#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

// geometry/ is shapes of bodies and tissue: triangle and tetrahedral meshes, distance grids,
// nearest points, the middle surface of a sheet; solid_mesher is a program of its own. No physics.
//
// Triangle meshes: read from files, checked, measured and turned into signed distance grids.
// Everything here runs once at load time and in pictures; nothing is on the hot path but the arrays
// of SdfGrid. Free functions on plain structs, no state: any thread may call them.
//
//   mesh.cpp           readers, closedness, volume
//   mesh_shapes.cpp    tessellations of analytic shapes
//   mesh_distance.cpp  inside test, distance grid

namespace omentum {

/// Triangle mesh. Vertices in the body frame B [m]; triangles are counter-clockwise seen from
/// outside.
struct TriangleMesh {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Eigen::Vector3i> triangles;
};

/// Reads OBJ (v and f lines; polygons are fanned) or STL (ASCII or binary; equal vertices are
/// merged), scaled to metres. Triangles with a repeated corner and vertices without a triangle are
/// dropped. Throws Error naming file and line (or byte) for a missing, malformed, empty, huge or
/// non-finite file, and for an extent outside [0.1 mm, 10 m], which is how a wrong unit shows.
TriangleMesh load_mesh(const std::string& path, double unit_m);

/// As load_mesh, and throws Error naming file and one offending edge unless the surface is closed
/// and consistently oriented (each directed edge exactly once, its reverse exactly once). An
/// inside-out mesh is turned.
TriangleMesh load_closed_mesh(const std::string& path, double unit_m);

/// Parses mesh text or bytes; `name` is used in messages and its ending (.obj, .stl) chooses the
/// format; without one of the two the first bytes do. Total: any content gives a mesh or an Error.
/// The entry of the fuzz target.
TriangleMesh parse_mesh(const std::string& name, const std::string& content, double unit_m);
/// The check of load_closed_mesh. Every mesh that passes has a winding number of 0 or 1 almost
/// everywhere, unless it intersects itself.
void require_closed(const std::string& name, TriangleMesh& mesh);
/// Throws Error naming place and reason unless the surface, open or closed, is one piece that can
/// be a shell: consistently oriented, two triangles at an edge at most, no parts that meet in a
/// single vertex, no slivers.
void require_sheet(const std::string& name, const TriangleMesh& mesh);

/// Volume enclosed by a closed mesh [m^3], positive when triangles face outside.
double signed_volume(const TriangleMesh& mesh);

/// Generalised winding number of the point (1 inside, 0 outside of a closed mesh) [Jacobson13].
double winding_number(const TriangleMesh& mesh, const Eigen::Vector3d& point);

/// For every point whether it lies inside the closed mesh (winding number above 0.5), by signed
/// crossings of a vertical line: a few hundred nanoseconds per point, whatever the mesh. Points on
/// the surface fall on either side.
std::vector<bool> points_inside(const TriangleMesh& mesh, std::span<const Eigen::Vector3d> points);

/// Tessellations of the analytic shapes, for pictures and for exposure samples: closed, facing
/// outside, vertices on the surface (so the volume is a little small). `rings` circles of latitude
/// between the two poles.
TriangleMesh make_ellipsoid_mesh(const Eigen::Vector3d& semi_axes, int rings, int sectors);
TriangleMesh make_box_mesh(const Eigen::Vector3d& half_extents);
/// Capsule from p0 to p1 [m].
TriangleMesh make_capsule_mesh(const Eigen::Vector3d& p0, const Eigen::Vector3d& p1, double radius,
                               int sectors);

/// Squared distance from p to the triangle (a, b, c) [m^2]: to its projection if that falls inside,
/// else to the nearest edge.
double squared_distance_to_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a,
                                    const Eigen::Vector3d& b, const Eigen::Vector3d& c);

/// Signed distance of a closed mesh on a regular grid, negative inside; trilinear between nodes.
/// The hot path reads the raw arrays; outside the grid nothing is in contact (the margin exceeds
/// any contact distance).
struct SdfGrid {
  Eigen::Vector3d origin;    ///< position of node (0,0,0) in the body frame [m]
  double pitch = 0;          ///< node distance [m]
  Eigen::Vector3i count;     ///< nodes per axis
  std::vector<float> value;  ///< x fastest: index = i + nx (j + ny k) [m]
};

/// Samples the exact distance to the triangles at every node; the sign is that of points_inside.
/// Grid with at most `max_nodes` per axis and a margin of `margin` around the mesh [m].
SdfGrid make_sdf_grid(const TriangleMesh& mesh, int max_nodes, double margin);

}  // namespace omentum
