#pragma once

#include <Eigen/Core>
#include <array>
#include <span>

namespace omentum {

/// Where a marker sits on a surface: a triangle leads it, turned as that is turned.
struct MarkerPlace {
  Eigen::Vector3i corner{-1, -1, -1};               ///< vertices of the triangle; -1: on no tissue
  Eigen::Vector3d share = Eigen::Vector3d::Zero();  ///< barycentric coordinates of its foot
  /// From the foot to its middle: along the first edge, across it, along the normal [m].
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
  /// Standard deviations of what has to be added to it before anything is fitted [m].
  Eigen::Vector3d sd = Eigen::Vector3d::Constant(0.003);

  bool on_tissue() const { return corner[0] >= 0; }
};

/// A marker on a surface as it is now.
struct PlacedMarker {
  Eigen::Vector3d p = Eigen::Vector3d::Zero();          ///< its middle, in the vertices' frame [m]
  Eigen::Matrix3d frame = Eigen::Matrix3d::Identity();  ///< of the offset
  Eigen::Vector3d foot_to_middle = Eigen::Vector3d::Zero();  ///< [m]
};

/// `more`: added to the offset [m].
PlacedMarker place_marker(const MarkerPlace& place, std::span<const Eigen::Vector3d> vertices,
                          const Eigen::Vector3d& more);

/// Derivatives of its place along `direction` by each of the three corners.
std::array<Eigen::Vector3d, 3> corner_slopes(const MarkerPlace& place, const PlacedMarker& placed,
                                             std::span<const Eigen::Vector3d> vertices,
                                             const Eigen::Vector3d& direction);

/// Middle p of a marker over the foot in a triangle.
MarkerPlace put_marker(const Eigen::Vector3i& corner, const Eigen::Vector3d& share,
                       std::span<const Eigen::Vector3d> vertices, const Eigen::Vector3d& p);

}  // namespace omentum
