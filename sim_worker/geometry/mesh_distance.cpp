#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>

#include "core/check.h"
#include "core/constants.h"
#include "sim_worker/geometry/mesh.h"

namespace omentum {
double squared_distance_to_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a,
                                    const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
  const Eigen::Vector3d normal = (b - a).cross(c - a);
  const double area = normal.squaredNorm();
  if (area > 0) {
    const bool inside = normal.cross(b - a).dot(p - a) >= 0 &&
                        normal.cross(c - b).dot(p - b) >= 0 && normal.cross(a - c).dot(p - c) >= 0;
    if (inside) {
      const double height = normal.dot(p - a);
      return height * height / area;
    }
  }
  const auto to_segment = [&](const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
    const Eigen::Vector3d edge = to - from;
    const double length = edge.squaredNorm();
    const double along = length > 0 ? std::clamp(edge.dot(p - from) / length, 0.0, 1.0) : 0.0;
    return (p - from - along * edge).squaredNorm();
  };
  return std::min({to_segment(a, b), to_segment(b, c), to_segment(c, a)});
}

namespace {

const Eigen::Vector3d& corner(const TriangleMesh& mesh, const Eigen::Vector3i& triangle, int k) {
  return mesh.vertices[static_cast<std::size_t>(triangle[k])];
}

// ------------------------------------------------------------------------------------------------
// Inside or outside: signed crossings of a vertical line
//
// The winding number of a closed mesh at p is the number of triangles above p that the line through
// p parallel to z leaves through, minus those it enters through. Whether the line passes left or
// right of an edge is decided once per undirected edge (end points ordered by index), so both
// neighbours see the same answer and no crossing is lost or counted twice; a line exactly through
// an edge is moved by an infinitely small (e, e^2). Triangles are sorted into a grid of columns in
// x and y, so a point looks at a handful of them.

/// +1 if p lies left of the edge a -> b in the xy plane, -1 if right.
int side_of_edge(const TriangleMesh& mesh, int a, int b, const Eigen::Vector3d& p) {
  const bool swapped = a > b;
  const Eigen::Vector3d& low = mesh.vertices[static_cast<std::size_t>(swapped ? b : a)];
  const Eigen::Vector3d& high = mesh.vertices[static_cast<std::size_t>(swapped ? a : b)];
  const double dx = high.x() - low.x();
  const double dy = high.y() - low.y();
  double side = dx * (p.y() - low.y()) - dy * (p.x() - low.x());
  if (side == 0) side = dy != 0 ? -dy : dx;
  return (side > 0) == swapped ? -1 : 1;
}

class ColumnGrid {
 public:
  explicit ColumnGrid(const TriangleMesh& mesh) : mesh_(mesh) {
    low_ = high_ = mesh.vertices.front().head<2>();
    for (const Eigen::Vector3d& vertex : mesh.vertices) {
      low_ = low_.cwiseMin(vertex.head<2>());
      high_ = high_.cwiseMax(vertex.head<2>());
    }
    const double wanted = std::sqrt(static_cast<double>(mesh.triangles.size()));
    count_ = std::clamp(static_cast<int>(wanted), 1, 512);
    columns_.resize(static_cast<std::size_t>(count_) * static_cast<std::size_t>(count_));
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) insert(t);
  }

  /// True where the winding number of p is positive.
  bool inside(const Eigen::Vector3d& p) const {
    if (p.x() < low_.x() || p.y() < low_.y() || p.x() > high_.x() || p.y() > high_.y()) {
      return false;
    }
    int above = 0;
    int all = 0;
    for (const std::uint32_t t : columns_[column_of(p.x(), 0) + column_of(p.y(), 1) * size()]) {
      const int crossing = crossing_of(mesh_.triangles[t], p);
      all += crossing;
      if (crossing != 0 && height_at(mesh_.triangles[t], p) > p.z()) above += crossing;
    }
    // A closed mesh is left as often as it is entered; anything else is rounding at a vertex.
    if (all != 0) return winding_number(mesh_, p) > 0.5;
    return above > 0;
  }

 private:
  std::size_t size() const { return static_cast<std::size_t>(count_); }

  std::size_t column_of(double value, int axis) const {
    const double width = std::max(high_[axis] - low_[axis], 1e-300);
    const int column = static_cast<int>((value - low_[axis]) / width * count_);
    return static_cast<std::size_t>(std::clamp(column, 0, count_ - 1));
  }

  void insert(std::size_t t) {
    const Eigen::Vector3i& triangle = mesh_.triangles[t];
    Eigen::Vector2d low = corner(mesh_, triangle, 0).head<2>();
    Eigen::Vector2d high = low;
    for (int k = 1; k < 3; ++k) {
      low = low.cwiseMin(corner(mesh_, triangle, k).head<2>());
      high = high.cwiseMax(corner(mesh_, triangle, k).head<2>());
    }
    for (std::size_t j = column_of(low.y(), 1); j <= column_of(high.y(), 1); ++j) {
      for (std::size_t i = column_of(low.x(), 0); i <= column_of(high.x(), 0); ++i) {
        columns_[i + j * size()].push_back(static_cast<std::uint32_t>(t));
      }
    }
  }

  /// +1 where the vertical line leaves through the triangle (normal up), -1 where it enters, 0
  /// where it misses.
  int crossing_of(const Eigen::Vector3i& t, const Eigen::Vector3d& p) const {
    const int first = side_of_edge(mesh_, t[0], t[1], p);
    if (side_of_edge(mesh_, t[1], t[2], p) != first) return 0;
    if (side_of_edge(mesh_, t[2], t[0], p) != first) return 0;
    return first;
  }

  double height_at(const Eigen::Vector3i& t, const Eigen::Vector3d& p) const {
    const Eigen::Vector3d& a = corner(mesh_, t, 0);
    const Eigen::Vector3d normal = (corner(mesh_, t, 1) - a).cross(corner(mesh_, t, 2) - a);
    if (normal.z() == 0) return a.z();  // a sliver seen from its edge; it is hit by rounding only
    return a.z() - (normal.x() * (p.x() - a.x()) + normal.y() * (p.y() - a.y())) / normal.z();
  }

  const TriangleMesh& mesh_;
  Eigen::Vector2d low_, high_;
  int count_ = 1;
  std::vector<std::vector<std::uint32_t>> columns_;
};

// ------------------------------------------------------------------------------------------------
// Distance: tree of axis-aligned boxes

class DistanceTree {
 public:
  explicit DistanceTree(const TriangleMesh& mesh) : mesh_(mesh), order_(mesh.triangles.size()) {
    std::iota(order_.begin(), order_.end(), 0U);
    nodes_.reserve(2 * order_.size());
    build(0, order_.size());
  }

  /// Distance from p to the surface; exact where it is below `limit`, else `limit`.
  double distance(const Eigen::Vector3d& p, double limit) const {
    double best = limit * limit;
    search(0, p, best);
    return std::sqrt(best);
  }

 private:
  static constexpr std::size_t kLeafSize = 4;

  struct Node {
    Eigen::AlignedBox3d box;
    std::size_t first = 0, last = 0;  ///< range of order_ (leaf)
    std::size_t left = 0, right = 0;  ///< children; 0 = leaf
  };

  std::size_t build(std::size_t first, std::size_t last) {
    const std::size_t index = nodes_.size();
    nodes_.emplace_back();
    Node node;
    node.first = first;
    node.last = last;
    for (std::size_t k = first; k < last; ++k) {
      for (int c = 0; c < 3; ++c) node.box.extend(corner(mesh_, mesh_.triangles[order_[k]], c));
    }
    if (last - first > kLeafSize) {
      int axis = 0;
      node.box.sizes().maxCoeff(&axis);
      const std::size_t middle = (first + last) / 2;
      const auto centre = [&](std::uint32_t t) {
        const Eigen::Vector3i& triangle = mesh_.triangles[t];
        return corner(mesh_, triangle, 0)[axis] + corner(mesh_, triangle, 1)[axis] +
               corner(mesh_, triangle, 2)[axis];
      };
      const auto at = [&](std::size_t k) {
        return order_.begin() + static_cast<std::ptrdiff_t>(k);
      };
      std::nth_element(at(first), at(middle), at(last),
                       [&](std::uint32_t a, std::uint32_t b) { return centre(a) < centre(b); });
      node.left = build(first, middle);
      node.right = build(middle, last);
    }
    nodes_[index] = node;
    return index;
  }

  void search(std::size_t index, const Eigen::Vector3d& p, double& best) const {
    const Node& node = nodes_[index];
    if (node.left == 0) {
      for (std::size_t k = node.first; k < node.last; ++k) {
        const Eigen::Vector3i& t = mesh_.triangles[order_[k]];
        best =
            std::min(best, squared_distance_to_triangle(p, corner(mesh_, t, 0), corner(mesh_, t, 1),
                                                        corner(mesh_, t, 2)));
      }
      return;
    }
    std::array<std::size_t, 2> child{node.left, node.right};
    std::array<double, 2> gap{nodes_[node.left].box.squaredExteriorDistance(p),
                              nodes_[node.right].box.squaredExteriorDistance(p)};
    if (gap[1] < gap[0]) {
      std::swap(child[0], child[1]);
      std::swap(gap[0], gap[1]);
    }
    for (std::size_t k = 0; k < 2; ++k) {
      if (gap[k] < best) search(child[k], p, best);
    }
  }

  const TriangleMesh& mesh_;
  std::vector<std::uint32_t> order_;
  std::vector<Node> nodes_;
};

}  // namespace

double winding_number(const TriangleMesh& mesh, const Eigen::Vector3d& point) {
  // Sum of the solid angles of the triangles [VanOosterom83], divided by 4 pi.
  double sum = 0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Eigen::Vector3d a = corner(mesh, t, 0) - point;
    const Eigen::Vector3d b = corner(mesh, t, 1) - point;
    const Eigen::Vector3d c = corner(mesh, t, 2) - point;
    const double la = a.norm();
    const double lb = b.norm();
    const double lc = c.norm();
    const double numerator = a.dot(b.cross(c));
    const double denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    sum += std::atan2(numerator, denominator);
  }
  return sum / (2 * kPi);
}

std::vector<bool> points_inside(const TriangleMesh& mesh, std::span<const Eigen::Vector3d> points) {
  std::vector<bool> inside(points.size(), false);
  if (mesh.triangles.empty()) return inside;
  const ColumnGrid columns(mesh);
  for (std::size_t k = 0; k < points.size(); ++k) inside[k] = columns.inside(points[k]);
  return inside;
}

SdfGrid make_sdf_grid(const TriangleMesh& mesh, int max_nodes, double margin) {
  OMENTUM_CHECK(!mesh.triangles.empty() && max_nodes >= 2 && margin >= 0,
                "{} triangles, {} nodes, margin {}", mesh.triangles.size(), max_nodes, margin);
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& vertex : mesh.vertices) box.extend(vertex);
  SdfGrid grid;
  grid.origin = box.min() - Eigen::Vector3d::Constant(margin);
  const Eigen::Vector3d size = box.sizes() + Eigen::Vector3d::Constant(2 * margin);
  grid.pitch = size.maxCoeff() / (max_nodes - 1);
  for (int axis = 0; axis < 3; ++axis) {
    // The small number keeps the longest axis at max_nodes in spite of rounding.
    grid.count[axis] = std::max(2, static_cast<int>(std::ceil(size[axis] / grid.pitch - 1e-9)) + 1);
  }
  const DistanceTree tree(mesh);
  const ColumnGrid columns(mesh);
  grid.value.reserve(static_cast<std::size_t>(grid.count.x()) *
                     static_cast<std::size_t>(grid.count.y()) *
                     static_cast<std::size_t>(grid.count.z()));
  for (int k = 0; k < grid.count.z(); ++k) {
    for (int j = 0; j < grid.count.y(); ++j) {
      double limit = std::numeric_limits<double>::infinity();
      for (int i = 0; i < grid.count.x(); ++i) {
        const Eigen::Vector3d node = grid.origin + grid.pitch * Eigen::Vector3d(i, j, k);
        const double distance = tree.distance(node, limit);
        // A step of one pitch changes the distance by one pitch at most; the factor covers
        // rounding.
        limit = (distance + grid.pitch) * (1 + 1e-9);
        grid.value.push_back(static_cast<float>(columns.inside(node) ? -distance : distance));
      }
    }
  }
  return grid;
}

}  // namespace omentum
