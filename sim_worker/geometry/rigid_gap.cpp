#include "sim_worker/geometry/rigid_gap.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/check.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kFar = 1;  // [m] distance outside a grid: no contact, whatever the sheet

Gap from_vector(const Vector3d& away, double surface) {
  const double length = away.norm();
  if (!(length > 1e-12)) return {-surface, Vector3d::UnitZ()};  // at the centre: any way out
  return {length - surface, away / length};
}

// The nearest point q of the surface has p - q = t q / a^2 with t the root of
// sum (a_i p_i / (t + a_i^2))^2 = 1: convex and falling, so Newton's method converges from any t
// left of the root. Points deeper than half the shortest semi-axis are treated as that deep.
Gap ellipsoid_gap(const Vector3d& semi_axes, const Vector3d& p) {
  const Vector3d squares = semi_axes.cwiseAbs2();
  const double lowest = -0.5 * squares.minCoeff();
  double t = 0;
  for (int iteration = 0; iteration < 50; ++iteration) {
    const Vector3d shifted = squares.array() + t;
    const Vector3d u = semi_axes.cwiseProduct(p).cwiseQuotient(shifted);
    const double slope = -2 * u.cwiseAbs2().cwiseQuotient(shifted).sum();
    if (!(slope < 0)) break;  // the centre
    const double next = std::max(lowest, t - (u.squaredNorm() - 1) / slope);
    const bool done = std::fabs(next - t) <= 1e-15 * squares.maxCoeff();
    t = next;
    if (done) break;
  }
  const Vector3d w = p.cwiseQuotient((squares.array() + t).matrix());  // q / a^2
  const double length = w.norm();
  if (!(length > 0)) return {-semi_axes.minCoeff(), Vector3d::UnitZ()};
  return {t * length, w / length};
}

Gap box_gap(const Vector3d& half, const Vector3d& p) {
  const Vector3d q = p.cwiseAbs() - half;
  int axis = 0;
  const double largest = q.maxCoeff(&axis);
  if (largest <= 0) {
    Vector3d normal = Vector3d::Zero();
    normal[axis] = p[axis] < 0 ? -1 : 1;
    return {largest, normal};
  }
  return from_vector(p - p.cwiseMax(-half).cwiseMin(half), 0);
}

Gap grid_gap(const SdfGrid& grid, const Vector3d& p) {
  std::array<int, 3> cell{};
  std::array<double, 3> t{};
  for (int k = 0; k < 3; ++k) {
    const double u = (p[k] - grid.origin[k]) / grid.pitch;
    if (!(u >= 0) || !(u < grid.count[k] - 1)) return {kFar, Vector3d::UnitZ()};
    cell[k] = static_cast<int>(u);
    t[k] = u - cell[k];
  }
  double value = 0;
  Vector3d slope = Vector3d::Zero();
  for (int corner = 0; corner < 8; ++corner) {
    const std::array<int, 3> up = {corner & 1, corner >> 1 & 1, corner >> 2 & 1};
    std::array<double, 3> weight{};
    for (int k = 0; k < 3; ++k) weight[k] = up[k] != 0 ? t[k] : 1 - t[k];
    const int node =
        cell[0] + up[0] + grid.count[0] * (cell[1] + up[1] + grid.count[1] * (cell[2] + up[2]));
    const auto phi = static_cast<double>(grid.value[node]);
    value += weight[0] * weight[1] * weight[2] * phi;
    for (int k = 0; k < 3; ++k) {
      const double sign = up[k] != 0 ? 1 : -1;
      slope[k] += sign * weight[(k + 1) % 3] * weight[(k + 2) % 3] * phi;
    }
  }
  const double length = slope.norm();
  if (!(length > 0)) return {kFar, Vector3d::UnitZ()};
  return {value, slope / length};
}

Gap local_gap(const RigidShape& body, const Vector3d& p) {
  switch (body.kind) {
    case RigidShape::Kind::kSphere:
      return from_vector(p, body.size[0]);
    case RigidShape::Kind::kEllipsoid:
      return ellipsoid_gap(body.size, p);
    case RigidShape::Kind::kBox:
      return box_gap(body.size, p);
    case RigidShape::Kind::kHalfSpace:
      return {p.z(), Vector3d::UnitZ()};
    case RigidShape::Kind::kMesh:
      break;
  }
  OMENTUM_CHECK(body.sdf != nullptr);
  return grid_gap(*body.sdf, p);
}

}  // namespace

Gap rigid_gap(const RigidShape& body, const Vector3d& p_W) {
  Gap gap = local_gap(body, body.X_WS.linear().transpose() * (p_W - body.X_WS.translation()));
  gap.normal = body.X_WS.linear() * gap.normal;
  return gap;
}

Gap capsule_gap(const Vector3d& a, const Vector3d& b, double radius, const Vector3d& p_W) {
  const Vector3d along = b - a;
  const double length2 = along.squaredNorm();
  const double t = length2 > 0 ? std::clamp((p_W - a).dot(along) / length2, 0.0, 1.0) : 0.0;
  return from_vector(p_W - a - t * along, radius);
}

}  // namespace omentum
