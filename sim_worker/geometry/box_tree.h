#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

// geometry/ is shapes of bodies and tissue: triangle and tetrahedral meshes, distance grids,
// nearest points, the middle surface of a sheet; solid_mesher is a program of its own. No physics.

namespace omentum {

/// Axis-aligned bounding boxes of the triangles of a surface in a binary tree, so that a search
/// looks at the triangles near a point only. Halved at the median centre along the longest axis;
/// the same surface makes the same tree on every machine. Any thread may call the const functions.
class BoxTree {
 public:
  /// Copies the triangles. Vertices in any frame [m].
  BoxTree(std::span<const Eigen::Vector3i> triangles, std::span<const Eigen::Vector3d> vertices);

  /// Takes new vertex positions; the halves stay. Vertices without a triangle are not read.
  void fit(std::span<const Eigen::Vector3d> vertices);

  /// Calls visit(triangle) for the triangles of every leaf whose box is nearer to q than the square
  /// root of `squared` [m^2], which `visit` may lower; of two halves the nearer one first.
  template <typename Visit>
  void for_each_near(const Eigen::Vector3d& q, const double& squared, const Visit& visit) const {
    if (boxes_.front().box.squaredExteriorDistance(q) < squared) search(0, q, squared, visit);
  }

  const Eigen::Vector3i& triangle(int t) const { return triangles_[t]; }

 private:
  struct Box {
    Eigen::AlignedBox3d box;
    std::int32_t first = 0, last = 0;  ///< of order_
    std::int32_t right = 0;            ///< the left child follows its parent; 0 = leaf
  };

  std::int32_t split(std::int32_t first, std::int32_t last,
                     std::span<const Eigen::Vector3d> vertices);

  template <typename Visit>
  void search(std::int32_t index, const Eigen::Vector3d& q, const double& squared,
              const Visit& visit) const {
    const Box& box = boxes_[index];
    if (box.right == 0) {
      for (std::int32_t n = box.first; n < box.last; ++n) visit(order_[n]);
      return;
    }
    std::array<std::int32_t, 2> child = {index + 1, box.right};
    std::array<double, 2> gap = {boxes_[child[0]].box.squaredExteriorDistance(q),
                                 boxes_[child[1]].box.squaredExteriorDistance(q)};
    if (gap[1] < gap[0]) {
      std::swap(child[0], child[1]);
      std::swap(gap[0], gap[1]);
    }
    for (int k = 0; k < 2; ++k) {
      if (gap[k] < squared) search(child[k], q, squared, visit);
    }
  }

  std::vector<Eigen::Vector3i> triangles_;
  std::vector<std::int32_t> order_;  ///< triangles by leaf
  std::vector<Box> boxes_;           ///< parents before children
};

}  // namespace omentum
