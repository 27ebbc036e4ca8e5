#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "mismatch/fit/frame_rows.h"
#include "mismatch/fit/likelihood.h"

// Points of a cloud whose camera is not known, as a fused one has none: distances both ways
// (docs/calibrate.md 9).
namespace omentum {

using Eigen::Vector3d;

namespace {

/// The nearest of some points but for one, and its distance [m].
std::pair<std::size_t, double> nearest_of(const std::vector<Vector3d>& points, const Vector3d& p,
                                          std::size_t skip) {
  std::pair<std::size_t, double> best{points.size(), std::numeric_limits<double>::infinity()};
  for (std::size_t k = 0; k < points.size(); ++k) {
    const double squared = (points[k] - p).squaredNorm();
    if (k != skip && squared < best.second) best = {k, squared};
  }
  best.second = std::sqrt(best.second);
  return best;
}

/// Median distance from a point to the next one [m]; 0 where there is none.
double spacing_of(const std::vector<Vector3d>& points) {
  if (points.size() < 2) return 0;
  constexpr std::size_t kEvery = 7;
  std::vector<double> spacing;
  for (std::size_t k = 0; k < points.size(); k += kEvery)
    spacing.push_back(nearest_of(points, points[k], k).second);
  const auto middle = spacing.begin() + static_cast<std::ptrdiff_t>(spacing.size() / 2);
  std::nth_element(spacing.begin(), middle, spacing.end());
  return *middle;
}

/// Of the face that a triangle is part of; of the rim, which joins two places of one number, the
/// upper face's.
Vector3d face_normal(const SeenSurface& surface, int triangle, int places) {
  const Eigen::Vector3i& corner = surface.triangles()[static_cast<std::size_t>(triangle)];
  for (const int upper : corner) {
    for (const int lower : corner) {
      if (lower != upper + places) continue;
      return (surface.vertices()[static_cast<std::size_t>(upper)] -
              surface.vertices()[static_cast<std::size_t>(lower)])
          .normalized();
    }
  }
  return surface.normal(triangle);
}

}  // namespace

void FrameRows::add_nearest(const SeenFrame& frame, const PredictedFrame& predicted,
                            const NoiseModel& noise, NormalEquations& made) {
  const Observation& seen = what_.seen;
  const double far = noise.reach / noise.sigma;
  const double spacing = spacing_of(frame.points);
  const auto places = static_cast<int>(of_.uv_.size());
  for (const Vector3d& p : frame.points) {
    const TrianglePoint near = surface_.nearest(p, noise.reach);
    if (near.triangle < 0) {
      ++made.no_tissue;
      made.cost += cost_of(far * far, noise.freedom);
      continue;
    }
    SeenRow row;
    row.triangle = near.triangle;
    row.share = near.share;
    row.normal = face_normal(surface_, near.triangle, places);
    row.place = surface_.at(near.triangle, near.share);
    const Vector3d off = p - row.place;
    row.along = row.normal;
    row.e = off.dot(row.normal);
    made.deviation.push_back(row.e);
    ++made.hits;
    add_row(row, predicted, noise, made);
    // Beside the edge, too.
    const Vector3d beside = off - row.e * row.normal;
    row.e = beside.norm() - spacing;
    if (!(row.e > 0)) continue;
    ++made.passing;
    row.along = beside.normalized();
    row.sd_factor = std::hypot(1, 0.5 * spacing / noise.sigma);
    add_row(row, predicted, noise, made);
  }
  // Places without a point nearby, of one face: the other is as near. What is within three spacings
  // does not count, nor what is so near to where the cloud was cut: rows that pull one way where
  // nothing is wrong would make a smaller body.
  const double allowed = 3 * spacing;
  for (int v = 0; v < places; ++v) {
    if (of_.covered_[static_cast<std::size_t>(v)]) continue;
    const Vector3d& place = surface_.vertices()[static_cast<std::size_t>(v)];
    if (seen.lowest && seen.lowest->signedDistance(place) < allowed) continue;
    const auto [point, distance] = nearest_of(frame.points, place, frame.points.size());
    if (!(distance > allowed)) continue;
    if (!(distance - allowed < noise.reach)) {
      made.cost += cost_of(far * far, noise.freedom);
      continue;
    }
    // A triangle with that corner.
    const TrianglePoint at = surface_.nearest(place, noise.reach);
    if (at.triangle < 0) continue;
    SeenRow row;
    row.triangle = at.triangle;
    row.share = at.share;
    row.normal = surface_.normal(at.triangle);
    row.place = place;
    row.along = (frame.points[point] - place) / distance;
    row.e = distance - allowed;
    row.sd_factor = std::hypot(1, 0.5 * allowed / noise.sigma);
    ++made.gaps;
    add_row(row, predicted, noise, made);
  }
}

}  // namespace omentum
