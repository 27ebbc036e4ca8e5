#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/check.h"
#include "core/constants.h"
#include "core/trig.h"
#include "sim_worker/geometry/box_tree.h"
#include "sim_worker/geometry/mesh.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3i;

// ------------------------------------------------------------------------------------------------
// Inside or outside: signed crossings of a vertical line
//
// The winding number of a closed mesh at p is the number of triangles that the ray from p along +z
// leaves through, minus those it enters through. x and y are rounded to a lattice of 2^-50 of the
// mesh's extent, where orientations are exact integers, and a line exactly through an edge or a
// vertex is moved by an infinitely small (e, e^2). So the line is on one side of every edge, the
// same for both triangles of the edge; each crossing counts once, and a triangle that stands
// upright is never hit. Triangles are sorted into a grid of columns in x and y, so that a point
// looks at a handful of them.

__extension__ typedef __int128 Wide;  // product of two lattice distances

struct LatticePoint {
  std::int64_t x, y;
};

/// Twice the signed area of (a, b, p), exact.
Wide orientation(LatticePoint a, LatticePoint b, LatticePoint p) {
  return Wide{b.x - a.x} * (p.y - a.y) - Wide{b.y - a.y} * (p.x - a.x);
}

class ColumnGrid {
 public:
  explicit ColumnGrid(const TriangleMesh& mesh) : mesh_(mesh) {
    for (const Vector3d& vertex : mesh.vertices) box_.extend(vertex.head<2>());
    scale_ = 0x1p50 / std::max(box_.sizes().maxCoeff(), 1e-200);
    high_ = on_lattice(box_.max());
    for (const Vector3d& vertex : mesh.vertices) vertices_.push_back(on_lattice(vertex.head<2>()));
    const double wanted = std::sqrt(static_cast<double>(mesh.triangles.size()));
    count_ = std::clamp(static_cast<int>(wanted), 1, 512);
    columns_.resize(count_ * count_);
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) insert(static_cast<int>(t));
  }

  /// True where the winding number of p is positive.
  bool inside(const Vector3d& p) const {
    if (!box_.contains(p.head<2>())) return false;
    const LatticePoint q = on_lattice(p.head<2>());
    int winding = 0;
    for (const int t : columns_[column_x(q.x) + count_ * column_y(q.y)])
      winding += crossing(mesh_.triangles[t], q, p.z());
    return winding > 0;
  }

 private:
  LatticePoint on_lattice(const Eigen::Vector2d& p) const {
    const Eigen::Vector2d u = scale_ * (p - box_.min());
    return {static_cast<std::int64_t>(u.x()), static_cast<std::int64_t>(u.y())};
  }
  int column_x(std::int64_t x) const { return static_cast<int>(x * count_ / (high_.x + 1)); }
  int column_y(std::int64_t y) const { return static_cast<int>(y * count_ / (high_.y + 1)); }

  void insert(int t) {
    const Vector3i& corner = mesh_.triangles[t];
    const auto [x_min, x_max] =
        std::minmax({vertices_[corner[0]].x, vertices_[corner[1]].x, vertices_[corner[2]].x});
    const auto [y_min, y_max] =
        std::minmax({vertices_[corner[0]].y, vertices_[corner[1]].y, vertices_[corner[2]].y});
    for (int j = column_y(y_min); j <= column_y(y_max); ++j) {
      for (int i = column_x(x_min); i <= column_x(x_max); ++i)
        columns_[i + count_ * j].push_back(t);
    }
  }

  /// +1 where the ray from (q, z) along +z leaves through the triangle, -1 where it enters, 0 where
  /// it misses.
  int crossing(const Vector3i& triangle, LatticePoint q, double z) const {
    std::array<Wide, 3> area{};  // barycentric coordinates of q times that of the triangle
    int left = 0;                // edges that the moved line passes on their left
    for (int k = 0; k < 3; ++k) {
      const LatticePoint& a = vertices_[triangle[(k + 1) % 3]];
      const LatticePoint& b = vertices_[triangle[(k + 2) % 3]];
      area[k] = orientation(a, b, q);
      const bool moved_left = a.y != b.y ? b.y < a.y : a.x < b.x;
      left += (area[k] != 0 ? area[k] > 0 : moved_left) ? 1 : 0;
    }
    if (left != 0 && left != 3) return 0;
    double height = 0;  // above z, times the area
    for (int k = 0; k < 3; ++k)
      height += static_cast<double>(area[k]) * (mesh_.vertices[triangle[k]].z() - z);
    if (left == 3) return height > 0 ? 1 : 0;
    return height < 0 ? -1 : 0;
  }

  const TriangleMesh& mesh_;
  Eigen::AlignedBox2d box_;
  double scale_ = 0;  ///< lattice points per metre
  LatticePoint high_{};
  std::vector<LatticePoint> vertices_;
  int count_ = 1;  ///< columns per axis
  std::vector<std::vector<int>> columns_;
};

}  // namespace

double winding_number(const TriangleMesh& mesh, const Vector3d& point) {
  // Sum of the solid angles of the triangles [VanOosterom83], divided by 4 pi.
  double sum = 0;
  for (const Vector3i& t : mesh.triangles) {
    const Vector3d a = mesh.vertices[t[0]] - point;
    const Vector3d b = mesh.vertices[t[1]] - point;
    const Vector3d c = mesh.vertices[t[2]] - point;
    const double la = a.norm();
    const double lb = b.norm();
    const double lc = c.norm();
    const double numerator = a.dot(b.cross(c));
    const double denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    sum += trig::atan2(numerator, denominator);
  }
  return sum / (2 * kPi);
}

std::vector<bool> points_inside(const TriangleMesh& mesh, std::span<const Vector3d> points) {
  std::vector<bool> inside(points.size(), false);
  if (mesh.triangles.empty()) return inside;
  const ColumnGrid columns(mesh);
  for (std::size_t k = 0; k < points.size(); ++k) inside[k] = columns.inside(points[k]);
  return inside;
}

double squared_distance_to_triangle(const Vector3d& p, const Vector3d& a, const Vector3d& b,
                                    const Vector3d& c) {
  const Vector3d normal = (b - a).cross(c - a);
  const double area = normal.squaredNorm();
  if (area > 0) {
    const bool inside = normal.cross(b - a).dot(p - a) >= 0 &&
                        normal.cross(c - b).dot(p - b) >= 0 && normal.cross(a - c).dot(p - c) >= 0;
    if (inside) {
      const double height = normal.dot(p - a);
      return height * height / area;
    }
  }
  const auto to_segment = [&](const Vector3d& from, const Vector3d& to) {
    const Vector3d edge = to - from;
    const double length = edge.squaredNorm();
    const double along = length > 0 ? std::clamp(edge.dot(p - from) / length, 0.0, 1.0) : 0.0;
    return (p - from - along * edge).squaredNorm();
  };
  return std::min({to_segment(a, b), to_segment(b, c), to_segment(c, a)});
}

SdfGrid make_sdf_grid(const TriangleMesh& mesh, int max_nodes, double margin) {
  OMENTUM_CHECK(!mesh.triangles.empty() && max_nodes >= 2 && margin >= 0,
                "{} triangles, {} nodes, margin {}", mesh.triangles.size(), max_nodes, margin);
  Eigen::AlignedBox3d box;
  for (const Vector3d& vertex : mesh.vertices) box.extend(vertex);
  SdfGrid grid;
  grid.origin = box.min() - Vector3d::Constant(margin);
  const Vector3d size = box.sizes() + Vector3d::Constant(2 * margin);
  grid.pitch = size.maxCoeff() / (max_nodes - 1);
  for (int axis = 0; axis < 3; ++axis) {
    // The small number keeps the longest axis at max_nodes in spite of rounding.
    grid.count[axis] = std::max(2, static_cast<int>(std::ceil(size[axis] / grid.pitch - 1e-9)) + 1);
  }
  const BoxTree tree(mesh.triangles, mesh.vertices);
  const ColumnGrid columns(mesh);
  grid.value.reserve(grid.count.prod());
  for (int k = 0; k < grid.count.z(); ++k) {
    for (int j = 0; j < grid.count.y(); ++j) {
      double limit = std::numeric_limits<double>::infinity();
      for (int i = 0; i < grid.count.x(); ++i) {
        const Vector3d node = grid.origin + grid.pitch * Vector3d(i, j, k);
        double squared = limit * limit;
        tree.for_each_near(node, squared, [&](int t) {
          const Vector3i& c = mesh.triangles[t];
          squared = std::min(
              squared, squared_distance_to_triangle(node, mesh.vertices[c[0]], mesh.vertices[c[1]],
                                                    mesh.vertices[c[2]]));
        });
        const double distance = std::sqrt(squared);
        // From node to node the distance changes by a pitch at most; the factor covers rounding.
        limit = (distance + grid.pitch) * (1 + 1e-9);
        grid.value.push_back(static_cast<float>(columns.inside(node) ? -distance : distance));
      }
    }
  }
  return grid;
}

}  // namespace omentum
