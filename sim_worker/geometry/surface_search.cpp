#include "sim_worker/geometry/surface_search.h"

#include <algorithm>
#include <numeric>

#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3i;

constexpr std::int32_t kLeafSize = 4;
constexpr int kMaxWalk = 64;  // a surface that folds onto itself must not keep the walk going

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
    best.share[0] = 0;  // exactly: it tells an edge from the inside
    return best;
  }
  const double area = area_a + area_b + area_c;
  if (!(area > 0)) return take(0, 0);  // no triangle
  return take(area_b / area, area_c / area);
}

SurfaceSearch::SurfaceSearch(std::span<const Vector3i> triangles, std::span<const Vector3d> rest)
    : triangles_(triangles.begin(), triangles.end()), order_(triangles.size()) {
  std::iota(order_.begin(), order_.end(), 0);
  split(0, static_cast<std::int32_t>(order_.size()), rest);
  std::vector<std::vector<std::int32_t>> around(rest.size());
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    for (const int corner : triangles_[t])
      around[static_cast<std::size_t>(corner)].push_back(static_cast<std::int32_t>(t));
  }
  neighbour_begin_.push_back(0);
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    std::vector<std::int32_t> near;
    for (const int corner : triangles_[t]) {
      const auto& more = around[static_cast<std::size_t>(corner)];
      near.insert(near.end(), more.begin(), more.end());
    }
    std::sort(near.begin(), near.end());
    near.erase(std::unique(near.begin(), near.end()), near.end());
    near.erase(std::find(near.begin(), near.end(), static_cast<std::int32_t>(t)));
    neighbour_.insert(neighbour_.end(), near.begin(), near.end());
    neighbour_begin_.push_back(static_cast<std::int32_t>(neighbour_.size()));
  }
}

std::int32_t SurfaceSearch::split(std::int32_t first, std::int32_t last,
                                  std::span<const Vector3d> rest) {
  const auto index = static_cast<std::int32_t>(boxes_.size());
  boxes_.emplace_back();
  boxes_.back().first = first;
  boxes_.back().last = last;
  if (last - first <= kLeafSize) return index;
  const auto centre = [&](std::int32_t t) -> Vector3d {
    const Vector3i& corner = triangles_[static_cast<std::size_t>(t)];
    return rest[static_cast<std::size_t>(corner[0])] + rest[static_cast<std::size_t>(corner[1])] +
           rest[static_cast<std::size_t>(corner[2])];
  };
  Eigen::AlignedBox3d box;
  for (std::int32_t k = first; k < last; ++k)
    box.extend(centre(order_[static_cast<std::size_t>(k)]));
  int axis = 0;
  box.sizes().maxCoeff(&axis);
  const std::int32_t middle = (first + last) / 2;
  // Equal centres in the order of the mesh: the tree is the same on every machine.
  std::nth_element(order_.begin() + first, order_.begin() + middle, order_.begin() + last,
                   [&](std::int32_t a, std::int32_t b) {
                     return std::pair(centre(a)[axis], a) < std::pair(centre(b)[axis], b);
                   });
  split(first, middle, rest);
  boxes_[static_cast<std::size_t>(index)].right = split(middle, last, rest);
  return index;
}

void SurfaceSearch::fit(std::span<const Vector3d> vertices) {
  for (std::size_t k = boxes_.size(); k-- > 0;) {
    Box& box = boxes_[k];
    box.box.setEmpty();
    if (box.right != 0) {
      box.box.extend(boxes_[k + 1].box);
      box.box.extend(boxes_[static_cast<std::size_t>(box.right)].box);
      continue;
    }
    for (std::int32_t n = box.first; n < box.last; ++n) {
      for (const int corner : triangle(order_[static_cast<std::size_t>(n)]))
        box.box.extend(vertices[static_cast<std::size_t>(corner)]);
    }
  }
}

TrianglePoint SurfaceSearch::nearest(const Vector3d& q, std::span<const Vector3d> vertices,
                                     int t) const {
  const Vector3i& corner = triangle(t);
  TrianglePoint point = nearest_on_triangle(q, vertices[static_cast<std::size_t>(corner[0])],
                                            vertices[static_cast<std::size_t>(corner[1])],
                                            vertices[static_cast<std::size_t>(corner[2])]);
  point.triangle = t;
  return point;
}

void SurfaceSearch::search(std::size_t index, const Vector3d& q, std::span<const Vector3d> vertices,
                           TrianglePoint& best) const {
  const Box& box = boxes_[index];
  if (box.right == 0) {
    for (std::int32_t n = box.first; n < box.last; ++n) {
      const TrianglePoint point = nearest(q, vertices, order_[static_cast<std::size_t>(n)]);
      if (point.squared < best.squared) best = point;
    }
    return;
  }
  std::array<std::size_t, 2> child = {index + 1, static_cast<std::size_t>(box.right)};
  std::array<double, 2> gap = {boxes_[child[0]].box.squaredExteriorDistance(q),
                               boxes_[child[1]].box.squaredExteriorDistance(q)};
  if (gap[1] < gap[0]) {
    std::swap(child[0], child[1]);
    std::swap(gap[0], gap[1]);
  }
  for (std::size_t k = 0; k < 2; ++k) {
    if (gap[k] < best.squared) search(child[k], q, vertices, best);
  }
}

TrianglePoint SurfaceSearch::find(const Vector3d& q, std::span<const Vector3d> vertices,
                                  double reach, int guess) const {
  TrianglePoint best;
  best.squared = reach * reach;
  if (guess >= 0) {
    const TrianglePoint point = nearest(q, vertices, guess);
    if (point.squared < best.squared) best = point;
  }
  if (boxes_.front().box.squaredExteriorDistance(q) < best.squared) search(0, q, vertices, best);
  return best;
}

Vector3d SurfaceSearch::normal(int t, std::span<const Vector3d> vertices) const {
  const Vector3i& corner = triangle(t);
  const Vector3d& a = vertices[static_cast<std::size_t>(corner[0])];
  return (vertices[static_cast<std::size_t>(corner[1])] - a)
      .cross(vertices[static_cast<std::size_t>(corner[2])] - a)
      .normalized();
}

/// Calls `use` for the other triangles of the edge or corner that the point lies on, if any.
template <typename Use>
void SurfaceSearch::for_each_meeting(const TrianglePoint& point, const Use& use) const {
  if (point.share.minCoeff() > 0) return;
  const Vector3i& corner = triangle(point.triangle);
  const auto begin = neighbour_begin_[static_cast<std::size_t>(point.triangle)];
  const auto end = neighbour_begin_[static_cast<std::size_t>(point.triangle) + 1];
  for (std::int32_t k = begin; k < end; ++k) {
    const int t = neighbour_[static_cast<std::size_t>(k)];
    bool meets = true;
    for (int c = 0; c < 3; ++c)
      meets = meets && (point.share[c] == 0 || (triangle(t).array() == corner[c]).any());
    if (meets) use(t);
  }
}

bool SurfaceSearch::is_behind(const Vector3d& q, std::span<const Vector3d> vertices,
                              const TrianglePoint& point) const {
  const Vector3i& corner = triangle(point.triangle);
  Vector3d way = q;
  for (int c = 0; c < 3; ++c) way -= point.share[c] * vertices[static_cast<std::size_t>(corner[c])];
  Vector3d normal = Vector3d::Zero();
  const auto add = [&](int t) {
    const Vector3i& k = triangle(t);
    // An edge: both triangles alike. A corner: by their angles there.
    int at = 0;
    bool is_corner = false;
    for (int c = 0; c < 3; ++c) {
      if (point.share[c] != 1) continue;
      is_corner = true;
      while (k[at] != corner[c]) ++at;
    }
    const Vector3d& a = vertices[static_cast<std::size_t>(k[at])];
    const Vector3d u = vertices[static_cast<std::size_t>(k[(at + 1) % 3])] - a;
    const Vector3d v = vertices[static_cast<std::size_t>(k[(at + 2) % 3])] - a;
    const Vector3d area = u.cross(v);
    const double size = area.norm();
    if (!(size > 0)) return;
    normal += (is_corner ? trig::atan2(size, u.dot(v)) : 1) / size * area;
  };
  add(point.triangle);
  for_each_meeting(point, add);
  return way.dot(normal) < 0;
}

TrianglePoint SurfaceSearch::walk(const Vector3d& q, std::span<const Vector3d> vertices,
                                  int start) const {
  TrianglePoint best = nearest(q, vertices, start);
  for (int step = 0; step < kMaxWalk; ++step) {
    const TrianglePoint from = best;
    for_each_meeting(from, [&](int t) {
      const TrianglePoint point = nearest(q, vertices, t);
      if (point.squared < best.squared) best = point;
    });
    if (best.triangle == from.triangle) break;
  }
  return best;
}

}  // namespace omentum
