#include "sim_worker/geometry/surface_search.h"

#include <algorithm>

#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3i;

constexpr int kMaxWalk = 64;  // bounds the walk on a surface that folds onto itself

}  // namespace

// By the region of the plane that q projects into [Ericson05, section 5.1.5].
TrianglePoint nearest_on_triangle(const Vector3d& q, const Vector3d& a, const Vector3d& b,
                                  const Vector3d& c) {
  const Vector3d ab = b - a;
  const Vector3d ac = c - a;
  const Vector3d aq = q - a;
  TrianglePoint best;
  const auto take = [&](double v, double w) {
    best.share = {1 - v - w, v, w};
    best.squared = (aq - v * ab - w * ac).squaredNorm();
    return best;
  };
  const double ab_aq = ab.dot(aq);
  const double ac_aq = ac.dot(aq);
  if (ab_aq <= 0 && ac_aq <= 0) return take(0, 0);
  const double ab_ab = ab.squaredNorm();
  const double ab_ac = ab.dot(ac);
  const double ab_bq = ab_aq - ab_ab;
  const double ac_bq = ac_aq - ab_ac;
  if (ab_bq >= 0 && ac_bq <= ab_bq) return take(1, 0);
  const double area_c = ab_aq * ac_bq - ab_bq * ac_aq;
  if (area_c <= 0 && ab_aq >= 0 && ab_bq <= 0) return take(ab_aq / ab_ab, 0);
  const double ab_cq = ab_aq - ab_ac;
  const double ac_cq = ac_aq - ac.squaredNorm();
  if (ac_cq >= 0 && ab_cq <= ac_cq) return take(0, 1);
  const double area_b = ab_cq * ac_aq - ab_aq * ac_cq;
  if (area_b <= 0 && ac_aq >= 0 && ac_cq <= 0) return take(0, ac_aq / (ac_aq - ac_cq));
  const double area_a = ab_bq * ac_cq - ab_cq * ac_bq;
  const double to_b = ac_bq - ab_bq;
  const double to_c = ab_cq - ac_cq;
  if (area_a <= 0 && to_b >= 0 && to_c >= 0) {
    const double w = to_b / (to_b + to_c);
    take(1 - w, w);
    best.share[0] = 0;  // exactly: marks an edge point
    return best;
  }
  const double area = area_a + area_b + area_c;
  if (!(area > 0)) return take(0, 0);  // degenerate triangle
  return take(area_b / area, area_c / area);
}

SurfaceSearch::SurfaceSearch(std::span<const Vector3i> triangles, std::span<const Vector3d> rest)
    : tree_(triangles, rest) {
  const int count = static_cast<int>(triangles.size());
  std::vector<std::vector<std::int32_t>> around(rest.size());
  for (int t = 0; t < count; ++t) {
    for (const int corner : triangles[t]) around[corner].push_back(t);
  }
  neighbour_begin_.push_back(0);
  for (int t = 0; t < count; ++t) {
    std::vector<std::int32_t> near;
    for (const int corner : triangles[t])
      near.insert(near.end(), around[corner].begin(), around[corner].end());
    std::sort(near.begin(), near.end());
    near.erase(std::unique(near.begin(), near.end()), near.end());
    std::erase(near, t);
    neighbour_.insert(neighbour_.end(), near.begin(), near.end());
    neighbour_begin_.push_back(static_cast<std::int32_t>(neighbour_.size()));
  }
}

TrianglePoint SurfaceSearch::nearest(const Vector3d& q, std::span<const Vector3d> vertices,
                                     int t) const {
  const Vector3i& c = triangle(t);
  TrianglePoint point = nearest_on_triangle(q, vertices[c[0]], vertices[c[1]], vertices[c[2]]);
  point.triangle = t;
  return point;
}

/// Replaces `best` where triangle `t` is nearer.
void SurfaceSearch::improve(const Vector3d& q, std::span<const Vector3d> vertices, int t,
                            TrianglePoint& best) const {
  const TrianglePoint point = nearest(q, vertices, t);
  if (point.squared < best.squared) best = point;
}

TrianglePoint SurfaceSearch::find(const Vector3d& q, std::span<const Vector3d> vertices,
                                  double reach, int guess) const {
  TrianglePoint best;
  best.squared = reach * reach;
  if (guess >= 0) improve(q, vertices, guess, best);
  tree_.for_each_near(q, best.squared, [&](int t) { improve(q, vertices, t, best); });
  return best;
}

Vector3d SurfaceSearch::normal(int t, std::span<const Vector3d> vertices) const {
  const Vector3i& c = triangle(t);
  const Vector3d& a = vertices[c[0]];
  return (vertices[c[1]] - a).cross(vertices[c[2]] - a).normalized();
}

/// Calls `use` for the other triangles of the edge or corner that the point lies on, if any.
template <typename Use>
void SurfaceSearch::for_each_meeting(const TrianglePoint& point, const Use& use) const {
  if (point.share.minCoeff() > 0) return;
  const Vector3i& corner = triangle(point.triangle);
  for (int k = neighbour_begin_[point.triangle]; k < neighbour_begin_[point.triangle + 1]; ++k) {
    const int t = neighbour_[k];
    bool meets = true;
    for (int c = 0; c < 3; ++c)
      meets = meets && (point.share[c] == 0 || (triangle(t).array() == corner[c]).any());
    if (meets) use(t);
  }
}

bool SurfaceSearch::is_behind(const Vector3d& q, std::span<const Vector3d> vertices,
                              const TrianglePoint& point) const {
  const Vector3i& corner = triangle(point.triangle);
  Vector3d offset = q;
  for (int c = 0; c < 3; ++c) offset -= point.share[c] * vertices[corner[c]];
  Vector3d normal = Vector3d::Zero();
  const auto add = [&](int t) {
    const Vector3i& k = triangle(t);
    // Weights: at an edge equal, at a corner the triangle's angle there.
    int at = 0;
    bool is_corner = false;
    for (int c = 0; c < 3; ++c) {
      if (point.share[c] != 1) continue;
      is_corner = true;
      while (k[at] != corner[c]) ++at;
    }
    const Vector3d& a = vertices[k[at]];
    const Vector3d u = vertices[k[(at + 1) % 3]] - a;
    const Vector3d v = vertices[k[(at + 2) % 3]] - a;
    const Vector3d area = u.cross(v);
    const double size = area.norm();
    if (!(size > 0)) return;
    normal += (is_corner ? trig::atan2(size, u.dot(v)) : 1) / size * area;
  };
  add(point.triangle);
  for_each_meeting(point, add);
  return offset.dot(normal) < 0;
}

TrianglePoint SurfaceSearch::walk(const Vector3d& q, std::span<const Vector3d> vertices,
                                  int start) const {
  TrianglePoint best = nearest(q, vertices, start);
  for (int step = 0; step < kMaxWalk; ++step) {
    const TrianglePoint from = best;
    for_each_meeting(from, [&](int t) { improve(q, vertices, t, best); });
    if (best.triangle == from.triangle) break;
  }
  return best;
}

}  // namespace omentum
