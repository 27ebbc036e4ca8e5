#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "mismatch/fit/frame_rows.h"
#include "mismatch/fit/likelihood.h"
#include "mismatch/seen/picture_index.h"

// Points of a cloud along the rays of the camera that saw them (docs/calibrate.md 4).
namespace omentum {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

constexpr double kMostGap = 0.008;  // [m] from the next point: farther off nothing was looked at
constexpr double kShaftShadow = 0.012;  // [m] around the shaft no gap counts
constexpr double kCropped = 0.25;       // share of places without any point nearby
constexpr double kSlack = 1;            // [spacings] that an edge is not known to

/// Distance of a point from the shaft, which stands up from the tip.
double shaft_distance(const Vector3d& p, const Vector3d& tip, const Vector3d& p_WC) {
  // Of the ray to the point, where it passes the line over the tip.
  const Vector3d d = (p - p_WC).normalized();
  const Vector3d w = p_WC - tip;
  const double b = d.z(), bottom = 1 - b * b;
  if (bottom < 1e-9) return (p - tip).head<2>().norm();
  double height = (w.z() - b * d.dot(w)) / bottom;
  height = std::clamp(height, 0.0, 0.3);
  const double s = height * b - d.dot(w);
  if (s > (p - p_WC).norm()) return std::numeric_limits<double>::infinity();
  return (w + s * d - height * Vector3d::UnitZ()).norm();
}

}  // namespace

void FrameRows::add_rays(const SeenFrame& frame, const PredictedFrame& predicted,
                         const NoiseModel& noise, NormalEquations& made) {
  const Observation& seen = what_.seen;
  constexpr double kEdgeOn = 0.15;  // cosine between ray and normal: flatter counts as this
  std::vector<Vector2d> picture;
  for (const Vector3d& p : frame.points) {
    if (const std::optional<Vector2d> place = surface_.project(p)) picture.push_back(*place);
  }
  const double depth = (of_.middle_ - seen.p_WC).norm();
  const PictureIndex index(std::move(picture), 2 * kMostGap / depth);
  // Which rays met nothing no cloud says: an edge is known to a spacing only, and the body that was
  // seen may lack points within 1.4 spacings of a corner. So much more, on either side, does not
  // count: rows that pull one way where nothing is wrong would, in many frames, make another body.
  const double spacing = index.spacing();
  for (const Vector3d& p : frame.points) {
    SeenRow row;
    const Vector3d d = (p - seen.p_WC).normalized();
    const std::optional<RayHit> hit = surface_.cast(p);
    const double range = (p - seen.p_WC).norm();
    // A ray that meets the surface within reach says where it is; else it is looked for.
    TrianglePoint near;
    if (!hit || !(std::fabs(range - hit->range) < noise.reach)) {
      near = surface_.nearest(p, noise.reach);
      if (near.triangle < 0) {
        ++made.no_tissue;
        const double far = noise.reach / noise.sigma;
        made.cost += cost_of(far * far, noise.freedom);
        continue;
      }
    }
    // A ray that passes the surface counts by its range against the face at the edge, continued, as
    // one that just meets it does, and by how far it passes: a body too small must not look better.
    RayHit met;
    Vector3d off = Vector3d::Zero();
    if (hit) {
      met = *hit;
    } else {
      constexpr double kInside = 1e-5;  // [m] of the edge: which of its faces the camera sees
      const TrianglePoint miss = surface_.nearest_to_ray(p, noise.reach);
      const TrianglePoint& edge = miss.triangle < 0 ? near : miss;
      met = {edge.triangle, edge.share};
      row.place = surface_.at(met);
      off = p - row.place;
      const Vector3d w = (off - off.dot(d) * d).normalized();
      if (const auto face = surface_.cast(row.place - kInside * w)) met = *face;
    }
    row.triangle = met.triangle;
    row.share = met.share;
    row.normal = surface_.normal(row.triangle);
    const double cosine = row.normal.dot(d);
    const double flat = std::copysign(std::max(std::fabs(cosine), kEdgeOn), cosine);
    const double slope = 1 / (flat * flat) - 1;  // tan^2
    row.sd_factor =
        std::sqrt(1 + slope * noise.lateral * noise.lateral / (noise.sigma * noise.sigma));
    // In front of another part of the body: then it is that part's edge that was seen.
    const double limit = noise.reach / std::max(std::fabs(cosine), kEdgeOn);
    if (hit) {
      row.e = std::clamp(range - hit->range - hit->bulge / flat, -limit, limit);
      row.along = row.normal / flat;
      row.place = surface_.at(met);
      made.deviation.push_back(row.e / row.sd_factor);
      ++made.hits;
      add_row(row, predicted, noise, made);
      continue;
    }
    row.e = std::clamp((off.dot(row.normal) - met.bulge) / flat, -limit, limit);
    row.along = row.normal / flat;
    ++made.passing;
    add_row(row, predicted, noise, made);
    const Vector3d w = off - off.dot(d) * d;
    row.e = w.norm() - kSlack * spacing * range;
    if (!(row.e > 1e-9)) continue;
    row.along = w.normalized();
    row.sd_factor = std::hypot(1, noise.lateral / noise.sigma);
    add_row(row, predicted, noise, made);
  }
  add_gaps(predicted, index, spacing, noise, made);
}

/// Places that should be seen and were not. Clouds often hold the upper face alone: its rim and the
/// lower face say nothing where they have no points.
void FrameRows::add_gaps(const PredictedFrame& predicted, const PictureIndex& index, double spacing,
                         const NoiseModel& noise, NormalEquations& made) {
  const Observation& seen = what_.seen;
  const double depth = (of_.middle_ - seen.p_WC).norm();
  constexpr std::size_t kLeast = 20;
  if (index.size() < kLeast || !(spacing > 0)) return;
  const Vector3d tip =
      of_.pivot_ + turned_ * (predicted.tip - of_.pivot_) + what_.registration.shift;
  const double allowed = (1 + kSlack) * spacing;
  struct Gap {
    int vertex;
    double distance;
    Vector2d towards;
  };
  std::vector<Gap> gaps;
  std::size_t looked_at = 0, nothing_near = 0;
  for (int v = 0; v < static_cast<int>(of_.uv_.size()); ++v) {
    if (of_.covered_[static_cast<std::size_t>(v)]) continue;
    const Vector3d& p = surface_.vertices()[static_cast<std::size_t>(v)];
    if (shaft_distance(p, tip, seen.p_WC) < kShaftShadow || !surface_.sees(v)) continue;
    ++looked_at;
    const Vector2d place = *surface_.project(p);
    const auto near = index.nearest(place, index.size());
    if (!near || (index.at(*near) - place).norm() > kMostGap / depth) {
      ++nothing_near;
      continue;
    }
    const Vector2d w = index.at(*near) - place;
    if (w.norm() > allowed) gaps.push_back({v, w.norm() - allowed, w.normalized()});
  }
  // Where much is missing the cloud was cut, by whatever: its edge is not that of the tissue.
  if (static_cast<double>(nothing_near) > kCropped * static_cast<double>(looked_at)) return;
  for (const Gap& gap : gaps) {
    SeenRow row;
    const Vector3d& p = surface_.vertices()[static_cast<std::size_t>(gap.vertex)];
    const double z = -(seen.R_WC.transpose() * (p - seen.p_WC)).z();
    row.e = gap.distance * z;
    row.along = seen.R_WC.col(0) * gap.towards.x() + seen.R_WC.col(1) * gap.towards.y();
    row.sd_factor = std::hypot(1, 0.5 * allowed * z / noise.sigma);
    // A triangle with that corner.
    const TrianglePoint at = surface_.nearest(p, noise.reach);
    if (at.triangle < 0) continue;
    row.triangle = at.triangle;
    row.share = at.share;
    row.normal = surface_.normal(at.triangle);
    row.place = p;
    ++made.gaps;
    add_row(row, predicted, noise, made);
  }
}

}  // namespace omentum
