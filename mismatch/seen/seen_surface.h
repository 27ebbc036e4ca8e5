#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "sim_worker/geometry/surface_search.h"

namespace omentum {

/// A closed surface of a sheet, by the places of its grid: the upper face, then the lower.
/// `upper`: triangles of the upper face, counter-clockwise from above; `count`: places of the grid.
std::vector<Eigen::Vector3i> close_sheet(std::span<const Eigen::Vector3i> upper, int count);

/// Where a ray meets a surface first.
struct RayHit {
  int triangle = -1;
  Eigen::Vector3d share = Eigen::Vector3d::Zero();  ///< barycentric coordinates
  double range = 0;                                 ///< from the camera to the triangle [m]
  /// Along the triangle's normal, of the smooth face through its corners, to second order in the
  /// size of triangles [m]; 0 on the rim.
  double bulge = 0;
};

/// A surface as a camera sees it: rays of a pinhole find their first triangle through a grid over
/// the picture. One thread at a time.
class SeenSurface {
 public:
  SeenSurface(std::vector<Eigen::Vector3i> triangles, std::span<const Eigen::Vector3d> rest);

  /// Takes positions and the camera that looks along -z of R_WC. Vertices behind the camera are not
  /// seen.
  void fit(std::span<const Eigen::Vector3d> vertices, const Eigen::Vector3d& p_WC,
           const Eigen::Matrix3d& R_WC);
  /// Of the ray through p_W.
  std::optional<RayHit> cast(const Eigen::Vector3d& p_W) const;
  /// Whether nothing is between the camera and a vertex.
  bool sees(int vertex) const;
  /// Place of a point in the picture, at unit depth; nothing behind the camera.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& p_W) const;
  /// Nearest point of the surface; triangle -1: none within `reach` [m].
  TrianglePoint nearest(const Eigen::Vector3d& q, double reach) const;
  /// Of a ray through q that misses the surface, the point of the edge that it passes nearest in
  /// the picture. Triangle -1: no surface within `reach` of q [m].
  TrianglePoint nearest_to_ray(const Eigen::Vector3d& q, double reach) const;

  const std::vector<Eigen::Vector3i>& triangles() const { return triangles_; }
  const std::vector<Eigen::Vector3d>& vertices() const { return vertices_; }
  Eigen::Vector3d at(const RayHit& hit) const { return at(hit.triangle, hit.share); }
  Eigen::Vector3d at(int triangle, const Eigen::Vector3d& share) const;
  /// Outward unit normal.
  Eigen::Vector3d normal(int triangle) const;

 private:
  std::optional<RayHit> cast_along(const Eigen::Vector3d& direction, const Eigen::Vector2d& place,
                                   double nearer_than) const;
  int cell_of(double x, int axis) const;
  double bulge(int triangle, const Eigen::Vector3d& share) const;

  std::vector<Eigen::Vector3i> triangles_;
  std::vector<Eigen::Vector3d> vertices_;
  std::vector<Eigen::Vector3d> normals_;  ///< of the upper and the lower face, at their vertices
  SurfaceSearch search_;
  Eigen::Vector3d p_WC_ = Eigen::Vector3d::Zero();
  Eigen::Matrix3d R_WC_ = Eigen::Matrix3d::Identity();
  static constexpr int kCells = 48;      ///< of the grid over the picture, along each axis
  Eigen::Vector2d low_, step_;           ///< of the grid
  std::vector<std::vector<int>> cells_;  ///< triangles that may be seen in each
};

}  // namespace omentum
