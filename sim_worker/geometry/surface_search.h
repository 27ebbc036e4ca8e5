#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace omentum {

/// A point of a triangle, by the shares of its corners (they sum to one).
struct TrianglePoint {
  int triangle = -1;
  Eigen::Vector3d share = Eigen::Vector3d::Zero();
  double squared = 0;  ///< distance to what was asked for [m^2]
};

/// Nearest point of the triangle (a, b, c) to q.
TrianglePoint nearest_on_triangle(const Eigen::Vector3d& q, const Eigen::Vector3d& a,
                                  const Eigen::Vector3d& b, const Eigen::Vector3d& c);

/// Nearest points of a surface whose vertices move. A tree of boxes over the triangles, split once
/// at rest, answers from anywhere; after a small motion a walk over neighbouring triangles does.
/// Answers depend on positions and on the triangle a walk starts from, on nothing else. Not for
/// several threads.
class SurfaceSearch {
 public:
  SurfaceSearch(std::span<const Eigen::Vector3i> triangles, std::span<const Eigen::Vector3d> rest);

  /// Takes vertex positions for find(); those of vertices without a triangle are not read.
  void fit(std::span<const Eigen::Vector3d> vertices);
  /// Nearest point to q where fit() saw the vertices; triangle -1: none within `reach` [m]. A
  /// triangle that may be near, `guess`, makes it faster; -1 = none.
  TrianglePoint find(const Eigen::Vector3d& q, std::span<const Eigen::Vector3d> vertices,
                     double reach, int guess = -1) const;
  /// Nearest point to q among those that are reached from triangle `start` over ever nearer edges
  /// and corners.
  TrianglePoint walk(const Eigen::Vector3d& q, std::span<const Eigen::Vector3d> vertices,
                     int start) const;
  /// Nearest point to q of triangle `t`.
  TrianglePoint nearest(const Eigen::Vector3d& q, std::span<const Eigen::Vector3d> vertices,
                        int t) const;

  /// Whether q is behind the surface at its nearest point. On an edge or a corner it is before one
  /// triangle and behind another where these are sharp; the mean normal weighted by angles tells
  /// [Baerentzen05, theorem 1].
  bool is_behind(const Eigen::Vector3d& q, std::span<const Eigen::Vector3d> vertices,
                 const TrianglePoint& point) const;

  /// Unit normal of triangle `t`.
  Eigen::Vector3d normal(int t, std::span<const Eigen::Vector3d> vertices) const;

  const Eigen::Vector3i& triangle(int t) const { return triangles_[static_cast<std::size_t>(t)]; }

 private:
  struct Box {
    Eigen::AlignedBox3d box;
    std::int32_t first = 0, last = 0;  ///< of order_
    std::int32_t right = 0;            ///< the left child follows its parent; 0 = leaf
  };
  std::int32_t split(std::int32_t first, std::int32_t last, std::span<const Eigen::Vector3d> rest);
  template <typename Use>
  void for_each_meeting(const TrianglePoint& point, const Use& use) const;
  void search(std::size_t index, const Eigen::Vector3d& q,
              std::span<const Eigen::Vector3d> vertices, TrianglePoint& best) const;

  std::vector<Eigen::Vector3i> triangles_;
  std::vector<std::int32_t> order_;
  std::vector<Box> boxes_;                                 ///< parents before children
  std::vector<std::int32_t> neighbour_begin_, neighbour_;  ///< triangles with a corner in common
};

}  // namespace omentum
