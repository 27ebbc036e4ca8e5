#include "sim_worker/tissue/grasp_patch.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

#include "core/constants.h"
#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::AlignedBox2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

/// How far a ray from `centre` runs inside the free sheet, `radius` at most [m].
double ray_length(const AlignedBox2d& free, const Vector2d& centre, const Vector2d& direction,
                  double radius) {
  double length = radius;
  for (int axis = 0; axis < 2; ++axis) {
    if (direction[axis] > 1e-12)
      length = std::min(length, (free.max()[axis] - centre[axis]) / direction[axis]);
    if (direction[axis] < -1e-12)
      length = std::min(length, (free.min()[axis] - centre[axis]) / direction[axis]);
  }
  return std::max(length, 0.0);
}

}  // namespace

Vector2d Grip::box(double radius) const {
  if (!rectangle) return Vector2d::Constant(radius);
  return half.x() * axis.cwiseAbs() + half.y() * Vector2d(axis.y(), axis.x()).cwiseAbs();
}

bool Grip::covers(const Vector2d& p, double radius) const {
  constexpr double kRim = 1e-9;  // [m]: rounding of grid lines on the rim
  if (!rectangle) return p.norm() <= radius + kRim;
  const Vector2d across(-axis.y(), axis.x());
  return std::fabs(p.dot(axis)) <= half.x() + kRim && std::fabs(p.dot(across)) <= half.y() + kRim;
}

std::vector<PatchPoint> patch_points(const AlignedBox2d& free, const Vector2d& centre,
                                     double radius) {
  // The force of the jaws acts at these points: with five on a ray, 1.3 mm apart on a disc of 5 mm,
  // a solid with finer elements took it for a force on rings and sank with every refinement.
  constexpr int kRays = 64;
  constexpr int kParts = 4;  // of a ray
  // Gauss-Legendre on [0, 1], five points.
  constexpr std::array<double, 5> kAt = {0.04691007703066800, 0.23076534494715845, 0.5,
                                         0.76923465505284155, 0.95308992296933200};
  constexpr std::array<double, 5> kWeight = {0.11846344252809454, 0.23931433524968324,
                                             0.28444444444444444, 0.23931433524968324,
                                             0.11846344252809454};
  std::vector<PatchPoint> points;
  double total = 0;
  for (int ray = 0; ray < kRays; ++ray) {
    const trig::SinCos angle = trig::sin_cos(2 * kPi * (ray + 0.5) / kRays);
    const Vector2d direction(angle.cos, angle.sin);
    const double length = ray_length(free, centre, direction, radius);
    for (int part = 0; part < kParts; ++part) {
      for (std::size_t k = 0; k < kAt.size(); ++k) {
        const double rho = (part + kAt[k]) / kParts * length;
        const double weight = kWeight[k] * length * rho;
        points.push_back({centre + rho * direction, weight});
        total += weight;
      }
    }
  }
  for (PatchPoint& point : points) point.weight /= total;
  return points;
}

SheetPoint nearest_on_sheet(const std::function<Vector3d(const Vector2d&)>& at,
                            const AlignedBox2d& sheet, const Vector2d& start, const Vector3d& tip) {
  Vector2d X = start;
  Vector3d miss = at(X) - tip;
  constexpr double kDifference = 1e-6;  // [m]: far below an element, far above rounding
  for (int iteration = 0; iteration < 40; ++iteration) {
    Eigen::Matrix<double, 3, 2> J;
    for (int axis = 0; axis < 2; ++axis) {
      Vector2d back = X;
      Vector2d forth = X;
      back[axis] = std::max(sheet.min()[axis], X[axis] - kDifference);
      forth[axis] = std::min(sheet.max()[axis], X[axis] + kDifference);
      J.col(axis) = (at(forth) - at(back)) / (forth[axis] - back[axis]);
    }
    const Vector2d d = -(J.transpose() * J).ldlt().solve(J.transpose() * miss);
    double step = 1;
    bool moved = false;
    for (int halving = 0; halving < 20 && !moved; ++halving, step *= 0.5) {
      const Vector2d next = (X + step * d).cwiseMax(sheet.min()).cwiseMin(sheet.max());
      const Vector3d next_miss = at(next) - tip;
      if (!(next_miss.squaredNorm() < miss.squaredNorm())) continue;
      moved = (next - X).norm() > 1e-12;
      X = next;
      miss = next_miss;
    }
    if (!moved) break;
  }
  return {X, miss.norm()};
}

}  // namespace omentum
