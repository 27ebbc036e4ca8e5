#include "mismatch/seen/marker_place.h"

#include <Eigen/Geometry>

namespace omentum {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Eigen::Vector3i;

namespace {

const Vector3d& at(std::span<const Vector3d> vertices, int i) {
  return vertices[static_cast<std::size_t>(i)];
}

/// Along the first edge, across it in the triangle, along the normal.
Matrix3d frame_of(const Vector3i& corner, std::span<const Vector3d> vertices) {
  const Vector3d first = at(vertices, corner[1]) - at(vertices, corner[0]);
  const Vector3d second = at(vertices, corner[2]) - at(vertices, corner[0]);
  Matrix3d frame;
  frame.col(0) = first.normalized();
  frame.col(2) = first.cross(second).normalized();
  frame.col(1) = frame.col(2).cross(frame.col(0));
  return frame;
}

Vector3d foot_of(const Vector3i& corner, const Vector3d& share,
                 std::span<const Vector3d> vertices) {
  Vector3d foot = Vector3d::Zero();
  for (int k = 0; k < 3; ++k) foot += share[k] * at(vertices, corner[k]);
  return foot;
}

}  // namespace

PlacedMarker place_marker(const MarkerPlace& place, std::span<const Vector3d> vertices,
                          const Vector3d& more) {
  PlacedMarker placed;
  placed.frame = frame_of(place.corner, vertices);
  placed.foot_to_middle = placed.frame * (place.offset + more);
  placed.p = foot_of(place.corner, place.share, vertices) + placed.foot_to_middle;
  return placed;
}

std::array<Vector3d, 3> corner_slopes(const MarkerPlace& place, const PlacedMarker& placed,
                                      std::span<const Vector3d> vertices,
                                      const Vector3d& direction) {
  // The triangle turns by w: direction . (w x offset) = w . (offset x direction), and with edges
  // e1 = l t, e2 = a t + b s in the frame (t, s, n):
  // w . n = de1 . s / l, w . s = -de1 . n / l, w . t = (de2 . n - a / l de1 . n) / b.
  const Vector3d t = placed.frame.col(0), s = placed.frame.col(1), n = placed.frame.col(2);
  const double length = (at(vertices, place.corner[1]) - at(vertices, place.corner[0])).norm();
  const Vector3d second = at(vertices, place.corner[2]) - at(vertices, place.corner[0]);
  const double a = second.dot(t), b = second.dot(s);
  const Vector3d m = placed.foot_to_middle.cross(direction);
  const Vector3d by_first =
      m.dot(n) / length * s - (m.dot(s) / length + m.dot(t) * a / (b * length)) * n;
  const Vector3d by_second = m.dot(t) / b * n;
  return {place.share[0] * direction - by_first - by_second, place.share[1] * direction + by_first,
          place.share[2] * direction + by_second};
}

MarkerPlace put_marker(const Vector3i& corner, const Vector3d& share,
                       std::span<const Vector3d> vertices, const Vector3d& p) {
  MarkerPlace place;
  place.corner = corner;
  place.share = share;
  place.offset = frame_of(corner, vertices).transpose() * (p - foot_of(corner, share, vertices));
  return place;
}

}  // namespace omentum
