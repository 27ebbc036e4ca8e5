#include "mismatch/seen/repeats.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "mismatch/seen/seen_surface.h"

namespace omentum {

using Eigen::Vector2d;
using Eigen::Vector3d;

Series residuals_of_surfaces(const Observation& seen, const Scene& made,
                             std::span<const std::vector<Vector3d>> surfaces) {
  constexpr int kSide = 4;
  constexpr double kReach = 0.025;  // [m]
  constexpr std::size_t kFewest = 5;
  const TissueBody& body = made.tissue;
  const std::size_t count = body.particles.size();
  Eigen::AlignedBox3d box;
  for (const Vector3d& p : body.particles) box.extend(p);
  std::vector<Vector3d> rest;
  for (const double side : {0.5, -0.5}) {
    for (const Vector3d& p : body.particles)
      rest.push_back(body.X_WB * (p + side * body.thickness * Vector3d::UnitZ()));
  }
  SeenSurface surface(close_sheet(body.surface_triangles, static_cast<int>(count)), rest);
  const Vector2d size = box.sizes().head<2>();
  const auto cell_of = [&](const TrianglePoint& at) {
    const Eigen::Vector3i& corners = surface.triangles()[static_cast<std::size_t>(at.triangle)];
    Vector2d place = Vector2d::Zero();
    for (int k = 0; k < 3; ++k) {
      const std::size_t particle = static_cast<std::size_t>(corners[k]) % count;
      place += at.share[k] * (body.particles[particle] - box.min()).head<2>();
    }
    const Eigen::Vector2i cell = (kSide * place.cwiseQuotient(size)).cast<int>();
    const Eigen::Vector2i inside = cell.cwiseMax(0).cwiseMin(kSide - 1);
    return static_cast<std::size_t>(kSide * inside.y() + inside.x());
  };
  Series residuals;
  for (int k = 0; k < kSide * kSide; ++k) residuals.columns.push_back(fmt::format("cell{}_m", k));
  const std::size_t upper = body.surface_triangles.size();
  for (std::size_t f = 0; f < seen.frames.size(); ++f) {
    if (surfaces[f].empty()) continue;
    surface.fit(surfaces[f], seen.p_WC, seen.R_WC);
    std::vector<double> sum(residuals.columns.size(), 0);
    std::vector<std::size_t> points(sum.size(), 0);
    for (const Vector3d& p : seen.frames[f].points) {
      const TrianglePoint at = surface.nearest(p, kReach);
      // What lies nearest to the rim or the lower face tells nothing of heights.
      if (at.triangle < 0 || static_cast<std::size_t>(at.triangle) >= upper) continue;
      const std::size_t cell = cell_of(at);
      sum[cell] += (p - surface.at(at.triangle, at.share)).dot(surface.normal(at.triangle));
      ++points[cell];
    }
    residuals.time_ns.push_back(static_cast<std::int64_t>(std::llround(1e9 * seen.frames[f].t)));
    for (std::size_t k = 0; k < sum.size(); ++k) {
      residuals.values.push_back(points[k] < kFewest ? std::numeric_limits<double>::quiet_NaN()
                                                     : sum[k] / static_cast<double>(points[k]));
    }
  }
  return residuals;
}

}  // namespace omentum
