#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

// Free functions on plain structs, used at load time and for pictures; any thread may call them.
//
//   mesh.cpp           readers
//   mesh_check.cpp     closedness, fitness as a sheet, volume
//   mesh_shapes.cpp    tessellations of analytic shapes
//   mesh_distance.cpp  inside test, distance grid

namespace omentum {

/// Triangle mesh in a body frame B [m], triangles counter-clockwise seen from outside.
struct TriangleMesh {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Eigen::Vector3i> triangles;
};

/// Reads OBJ (v and f lines, which a backslash continues; polygons are fanned, other statements
/// passed over but for surfaces of other kinds) or STL (ASCII in any letters, or binary; equal
/// vertices are merged), scaled by unit_m to metres. Triangles with a repeated corner and unused
/// vertices are dropped. Throws Error naming file and line (or byte) for a missing, malformed,
/// empty, huge or non-finite file, and for an extent outside [0.1 mm, 10 m], which is how a wrong
/// unit shows; for a content of another SHA-256 (hexadecimal) than the one given, empty: any.
TriangleMesh load_mesh(const std::string& path, double unit_m, const std::string& sha256 = {});

/// load_mesh and require_closed.
TriangleMesh load_closed_mesh(const std::string& path, double unit_m);

/// load_mesh from memory; `name` stands in messages, and its ending (.obj, .stl) or else the first
/// bytes choose the format. Total: any content gives a mesh or an Error; entry of the fuzz target.
TriangleMesh parse_mesh(const std::string& name, const std::string& content, double unit_m);

/// Throws Error naming one offending edge unless the surface is closed and consistently oriented:
/// each directed edge exactly once, its reverse exactly once. Vertices that stand at one place, as
/// programs write them for each face or seam, become one where the surface is closed so and not
/// without. Turns an inside-out mesh right side out. After it the winding number is 0 or 1 off a
/// surface that does not intersect itself.
void require_closed(const std::string& name, TriangleMesh& mesh);

/// Throws Error naming place and reason unless the surface, open or closed, is one piece that can
/// be a shell: consistently oriented, two triangles at an edge at most, not folded there by more
/// than 90 deg, no parts that meet in a single vertex, no slivers.
void require_sheet(const std::string& name, TriangleMesh& mesh);

/// Volume enclosed by a closed mesh [m^3], positive when triangles face outside.
double signed_volume(const TriangleMesh& mesh);

/// Generalised winding number of the point (1 inside, 0 outside of a closed mesh) [Jacobson13]; on
/// the surface in between.
double winding_number(const TriangleMesh& mesh, const Eigen::Vector3d& point);

/// For every point whether it lies inside the closed mesh, a few hundred nanoseconds each, whatever
/// the mesh. Exact for lines through vertices and edges; on the surface either answer.
std::vector<bool> points_inside(const TriangleMesh& mesh, std::span<const Eigen::Vector3d> points);

/// Tessellations of analytic shapes [m], for pictures and exposure samples: closed, vertices on the
/// surface (so the volume is a little small). `rings` >= 1 circles of latitude between the poles,
/// `sectors` >= 3.
TriangleMesh make_ellipsoid_mesh(const Eigen::Vector3d& semi_axes, int rings, int sectors);
TriangleMesh make_box_mesh(const Eigen::Vector3d& half_extents);
/// Capsule around the segment from p0 to p1.
TriangleMesh make_capsule_mesh(const Eigen::Vector3d& p0, const Eigen::Vector3d& p1, double radius,
                               int sectors);

/// Squared distance from p to the triangle (a, b, c) [m^2].
double squared_distance_to_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a,
                                    const Eigen::Vector3d& b, const Eigen::Vector3d& c);

/// Signed distance of a closed mesh on a regular grid, negative inside, trilinear between nodes.
/// The lane kernels read the raw arrays; outside the grid nothing is in contact.
struct SdfGrid {
  Eigen::Vector3d origin;    ///< position of node (0,0,0) in the body frame [m]
  double pitch = 0;          ///< node distance [m]
  Eigen::Vector3i count;     ///< nodes per axis
  std::vector<float> value;  ///< x fastest: index = i + nx (j + ny k) [m]
};

/// Samples the exact distance to the triangles at every node; the sign is that of points_inside.
/// At most `max_nodes` per axis and `margin` around the mesh [m], more than any contact distance.
SdfGrid make_sdf_grid(const TriangleMesh& mesh, int max_nodes, double margin);

}  // namespace omentum
