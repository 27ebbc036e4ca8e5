#include "mismatch/seen/seen_surface.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

namespace omentum {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3i;

std::vector<Vector3i> close_sheet(std::span<const Vector3i> upper, int count) {
  std::vector<Vector3i> all(upper.begin(), upper.end());
  std::map<std::pair<int, int>, int> edges;  // of one triangle only: the rim
  for (const Vector3i& t : upper) {
    all.emplace_back(t[0] + count, t[2] + count, t[1] + count);
    for (int k = 0; k < 3; ++k) {
      const int a = t[k], b = t[(k + 1) % 3];
      if (const auto other = edges.find({b, a}); other != edges.end()) {
        edges.erase(other);
      } else {
        edges[{a, b}] = 1;
      }
    }
  }
  for (const auto& [edge, unused] : edges) {
    const auto [a, b] = edge;
    all.emplace_back(a, a + count, b + count);
    all.emplace_back(a, b + count, b);
  }
  return all;
}

SeenSurface::SeenSurface(std::vector<Vector3i> triangles, std::span<const Vector3d> rest)
    : triangles_(std::move(triangles)),
      vertices_(rest.begin(), rest.end()),
      search_(triangles_, rest),
      cells_(static_cast<std::size_t>(kCells) * kCells) {}

std::optional<Vector2d> SeenSurface::project(const Vector3d& p_W) const {
  const Vector3d p = R_WC_.transpose() * (p_W - p_WC_);
  constexpr double kNearest = 1e-3;  // [m] before the camera
  if (!(p.z() < -kNearest)) return std::nullopt;
  return Vector2d(p.x() / -p.z(), p.y() / -p.z());
}

int SeenSurface::cell_of(double x, int axis) const {
  const double cell = std::floor((x - low_[axis]) / step_[axis]);
  return static_cast<int>(std::clamp(cell, 0.0, kCells - 1.0));
}

namespace {

/// Triangles of the rim join both faces.
bool on_rim(const Vector3i& corners, int places) {
  return corners.minCoeff() < places && corners.maxCoeff() >= places;
}

}  // namespace

/// The middle of a chord between two places of a curve lies below it by an eighth of the chord
/// times how far the normals at its ends part along it; a quadratic face through the middles so
/// found.
double SeenSurface::bulge(int triangle, const Vector3d& share) const {
  const Vector3i& corner = triangles_[static_cast<std::size_t>(triangle)];
  if (on_rim(corner, static_cast<int>(vertices_.size() / 2))) return 0;
  double height = 0;
  for (int k = 0; k < 3; ++k) {
    const auto a = static_cast<std::size_t>(corner[k]);
    const auto b = static_cast<std::size_t>(corner[(k + 1) % 3]);
    height += 0.5 * share[k] * share[(k + 1) % 3] *
              (normals_[b] - normals_[a]).dot(vertices_[b] - vertices_[a]);
  }
  return height;
}

void SeenSurface::fit(std::span<const Vector3d> vertices, const Vector3d& p_WC,
                      const Eigen::Matrix3d& R_WC) {
  vertices_.assign(vertices.begin(), vertices.end());
  search_.fit(vertices_);
  normals_.assign(vertices_.size(), Vector3d::Zero());
  for (const Vector3i& t : triangles_) {
    if (on_rim(t, static_cast<int>(vertices_.size() / 2))) continue;
    const Vector3d& a = vertices_[static_cast<std::size_t>(t[0])];
    const Vector3d n = (vertices_[static_cast<std::size_t>(t[1])] - a)
                           .cross(vertices_[static_cast<std::size_t>(t[2])] - a);
    for (const int v : t) normals_[static_cast<std::size_t>(v)] += n;
  }
  for (Vector3d& n : normals_) n.normalize();
  p_WC_ = p_WC;
  R_WC_ = R_WC;
  std::vector<std::optional<Vector2d>> places;
  Eigen::AlignedBox2d box;
  for (const Vector3d& p : vertices_) {
    places.push_back(project(p));
    if (places.back()) box.extend(*places.back());
  }
  for (std::vector<int>& cell : cells_) cell.clear();
  if (box.isEmpty()) return;
  low_ = box.min();
  step_ = (box.sizes() / kCells).cwiseMax(1e-12);
  for (int t = 0; t < static_cast<int>(triangles_.size()); ++t) {
    Eigen::AlignedBox2d seen;
    bool whole = true;
    for (const int v : triangles_[static_cast<std::size_t>(t)]) {
      const auto& place = places[static_cast<std::size_t>(v)];
      whole = whole && place.has_value();
      if (place) seen.extend(*place);
    }
    if (!whole) continue;
    for (int y = cell_of(seen.min().y(), 1); y <= cell_of(seen.max().y(), 1); ++y) {
      for (int x = cell_of(seen.min().x(), 0); x <= cell_of(seen.max().x(), 0); ++x)
        cells_[static_cast<std::size_t>(y * kCells + x)].push_back(t);
    }
  }
}

std::optional<RayHit> SeenSurface::cast_along(const Vector3d& direction, const Vector2d& place,
                                              double nearer_than) const {
  RayHit best;
  best.range = nearer_than;
  const double outside = 1e-9;
  for (int axis = 0; axis < 2; ++axis) {
    if (place[axis] < low_[axis] - outside ||
        place[axis] > low_[axis] + kCells * step_[axis] + outside)
      return std::nullopt;
  }
  const auto cell =
      static_cast<std::size_t>(cell_of(place.y(), 1) * kCells + cell_of(place.x(), 0));
  for (const int t : cells_[cell]) {
    // Moeller and Trumbore 1997.
    const Vector3i& corner = triangles_[static_cast<std::size_t>(t)];
    const Vector3d& a = vertices_[static_cast<std::size_t>(corner[0])];
    const Vector3d e1 = vertices_[static_cast<std::size_t>(corner[1])] - a;
    const Vector3d e2 = vertices_[static_cast<std::size_t>(corner[2])] - a;
    const Vector3d h = direction.cross(e2);
    const double det = e1.dot(h);
    if (std::fabs(det) < 1e-18) continue;
    constexpr double kEdge = 1e-9;
    const Vector3d s = p_WC_ - a;
    const double u = s.dot(h) / det;
    if (u < -kEdge || u > 1 + 2 * kEdge) continue;
    const Vector3d q = s.cross(e1);
    const double v = direction.dot(q) / det;
    if (u < -kEdge || v < -kEdge || u + v > 1 + kEdge) continue;
    const double range = e2.dot(q) / det;
    if (range > 0 && range < best.range) best = {t, {1 - u - v, u, v}, range};
  }
  if (best.triangle < 0) return std::nullopt;
  return best;
}

std::optional<RayHit> SeenSurface::cast(const Vector3d& p_W) const {
  const std::optional<Vector2d> place = project(p_W);
  if (!place) return std::nullopt;
  std::optional<RayHit> hit = cast_along((p_W - p_WC_).normalized(), *place, 1e9);
  if (hit) hit->bulge = bulge(hit->triangle, hit->share);
  return hit;
}

bool SeenSurface::sees(int vertex) const {
  constexpr double kItself = 2e-4;  // [m]
  const Vector3d& p = vertices_[static_cast<std::size_t>(vertex)];
  const std::optional<Vector2d> place = project(p);
  if (!place) return false;
  const Vector3d d = p - p_WC_;
  return !cast_along(d.normalized(), *place, d.norm() - kItself);
}

TrianglePoint SeenSurface::nearest(const Vector3d& q, double reach) const {
  return search_.find(q, vertices_, reach);
}

TrianglePoint SeenSurface::nearest_to_ray(const Vector3d& q, double reach) const {
  TrianglePoint best;
  const std::optional<Vector2d> place = project(q);
  if (!place || nearest(q, reach).triangle < 0) return best;
  const int x = cell_of(place->x(), 0), y = cell_of(place->y(), 1);
  double least = std::numeric_limits<double>::infinity();  // in the picture
  const auto look = [&](int column, int row) {
    if (column < 0 || row < 0 || column >= kCells || row >= kCells) return;
    for (const int t : cells_[static_cast<std::size_t>(row * kCells + column)]) {
      const Vector3i& corner = triangles_[static_cast<std::size_t>(t)];
      for (int k = 0; k < 3; ++k) {
        const int from = k, to = (k + 1) % 3;
        const Vector2d a = *project(vertices_[static_cast<std::size_t>(corner[from])]);
        const Vector2d b = *project(vertices_[static_cast<std::size_t>(corner[to])]);
        const Vector2d ab = b - a;
        const double share =
            std::clamp((*place - a).dot(ab) / std::max(ab.squaredNorm(), 1e-30), 0.0, 1.0);
        const double distance = (*place - a - share * ab).norm();
        if (!(distance < least)) continue;
        least = distance;
        best.triangle = t;
        best.share = Vector3d::Zero();
        best.share[from] = 1 - share;
        best.share[to] = share;
      }
    }
  };
  // Rings of cells until no nearer edge can come.
  for (int ring = 0; ring < kCells && least > (ring - 1) * step_.minCoeff(); ++ring) {
    for (int i = -ring; i <= ring; ++i) {
      look(x + i, y - ring);
      if (ring > 0) look(x + i, y + ring);
      if (std::abs(i) == ring) continue;
      look(x - ring, y + i);
      look(x + ring, y + i);
    }
  }
  if (best.triangle >= 0) best.squared = (q - at(best.triangle, best.share)).squaredNorm();
  return best;
}

Vector3d SeenSurface::at(int triangle, const Vector3d& share) const {
  const Vector3i& corner = triangles_[static_cast<std::size_t>(triangle)];
  Vector3d p = Vector3d::Zero();
  for (int k = 0; k < 3; ++k) p += share[k] * vertices_[static_cast<std::size_t>(corner[k])];
  return p;
}

Vector3d SeenSurface::normal(int triangle) const { return search_.normal(triangle, vertices_); }

}  // namespace omentum
