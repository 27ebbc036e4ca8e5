#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "sim_worker/geometry/box_tree.h"

namespace omentum {

/// A point of a triangle.
struct TrianglePoint {
  int triangle = -1;
  Eigen::Vector3d share = Eigen::Vector3d::Zero();  ///< barycentric coordinates, sum 1
  double squared = 0;                               ///< squared distance to the query point [m^2]
};

/// Nearest point of the triangle (a, b, c) to q.
TrianglePoint nearest_on_triangle(const Eigen::Vector3d& q, const Eigen::Vector3d& a,
                                  const Eigen::Vector3d& b, const Eigen::Vector3d& c);

/// Nearest points of a surface whose vertices move, in the frame of its vertices. Finds them from
/// anywhere with a BoxTree over the rest shape, or after a small motion by a walk over neighbouring
/// triangles. Results depend on the positions and on the triangle a walk starts from, on nothing
/// else. `vertices` are those of the last fit(). One thread at a time.
class SurfaceSearch {
 public:
  SurfaceSearch(std::span<const Eigen::Vector3i> triangles, std::span<const Eigen::Vector3d> rest);

  /// Takes vertex positions for find(); those of vertices without a triangle are not read.
  void fit(std::span<const Eigen::Vector3d> vertices) { tree_.fit(vertices); }
  /// Nearest point to q; triangle -1: none within `reach` [m]. `guess`, a triangle that may be
  /// near, makes it faster; -1 = none.
  TrianglePoint find(const Eigen::Vector3d& q, std::span<const Eigen::Vector3d> vertices,
                     double reach, int guess = -1) const;
  /// Local search: nearest point to q among those reached from triangle `start` over ever nearer
  /// edges and corners.
  TrianglePoint walk(const Eigen::Vector3d& q, std::span<const Eigen::Vector3d> vertices,
                     int start) const;
  /// Nearest point to q of triangle `t`.
  TrianglePoint nearest(const Eigen::Vector3d& q, std::span<const Eigen::Vector3d> vertices,
                        int t) const;
  /// Whether q is behind the surface at its nearest point, by the angle-weighted mean normal of the
  /// triangles that meet there [Baerentzen05, theorem 1].
  bool is_behind(const Eigen::Vector3d& q, std::span<const Eigen::Vector3d> vertices,
                 const TrianglePoint& point) const;
  /// Unit normal of triangle `t`.
  Eigen::Vector3d normal(int t, std::span<const Eigen::Vector3d> vertices) const;

  const Eigen::Vector3i& triangle(int t) const { return tree_.triangle(t); }

 private:
  void improve(const Eigen::Vector3d& q, std::span<const Eigen::Vector3d> vertices, int t,
               TrianglePoint& best) const;
  template <typename Use>
  void for_each_meeting(const TrianglePoint& point, const Use& use) const;

  BoxTree tree_;
  std::vector<std::int32_t> neighbour_begin_, neighbour_;  ///< triangles with a corner in common
};

}  // namespace omentum
