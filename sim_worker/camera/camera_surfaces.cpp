#include "sim_worker/camera/camera_surfaces.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "core/check.h"

namespace omentum {
namespace {

constexpr int kRings = 63;
constexpr int kSectors = 128;
constexpr double kSmoothAngleCosine = 0.766;  // 40 deg
constexpr double kBoardMargin = 0.02;         // [m] of a half space drawn beyond the workspace
constexpr double kJawLength = 0.0102;         // [m] needle driver: wrist yaw axis to tip

/// Appends a mesh in W with one normal per corner: the area-weighted mean over the triangles of the
/// corner that meet under less than 40 deg.
void append_mesh(const TriangleMesh& mesh, const Eigen::Isometry3d& X_WS, DrawSurface& surface) {
  std::vector<Eigen::Vector3d> normals;
  std::vector<std::vector<std::size_t>> touching(mesh.vertices.size());
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Eigen::Vector3i& c = mesh.triangles[t];
    const Eigen::Vector3d& a = mesh.vertices[c[0]];
    normals.push_back((mesh.vertices[c[1]] - a).cross(mesh.vertices[c[2]] - a));
    for (const int k : c) touching[k].push_back(t);
  }
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Eigen::Vector3d own = normals[t].normalized();
    for (const int k : mesh.triangles[t]) {
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (const std::size_t other : touching[k]) {
        if (normals[other].normalized().dot(own) > kSmoothAngleCosine) sum += normals[other];
      }
      const Eigen::Vector3d normal = sum.norm() > 0 ? Eigen::Vector3d(sum.normalized()) : own;
      surface.indices.push_back(static_cast<std::uint32_t>(surface.vertices.size()));
      surface.vertices.push_back({(X_WS * mesh.vertices[k]).cast<float>(),
                                  (X_WS.linear() * normal).cast<float>(),
                                  mesh.vertices[k].cast<float>()});
    }
  }
}

/// The same triangles with every vertex once: the rasteriser shades each of them.
DrawSurface weld(const DrawSurface& surface) {
  using Key = std::array<float, 9>;
  std::map<Key, std::uint32_t> known;
  DrawSurface welded;
  for (const std::uint32_t index : surface.indices) {
    const DrawSurface::Vertex& v = surface.vertices[index];
    Key key;
    Eigen::Vector3f::Map(key.data()) = v.position;
    Eigen::Vector3f::Map(key.data() + 3) = v.normal;
    Eigen::Vector3f::Map(key.data() + 6) = v.texture;
    const auto [place, added] =
        known.try_emplace(key, static_cast<std::uint32_t>(welded.vertices.size()));
    if (added) welded.vertices.push_back(v);
    welded.indices.push_back(place->second);
  }
  return welded;
}

/// The plane z = 0 of a half space, over the workspace.
TriangleMesh make_plane_mesh(const Eigen::Isometry3d& X_WS, const Eigen::AlignedBox3d& workspace) {
  Eigen::AlignedBox3d box;
  for (int corner = 0; corner < 8; ++corner)
    box.extend(X_WS.inverse() * workspace.corner(Eigen::AlignedBox3d::CornerType(corner)));
  const Eigen::Vector3d low = box.min() - Eigen::Vector3d::Constant(kBoardMargin);
  const Eigen::Vector3d high = box.max() + Eigen::Vector3d::Constant(kBoardMargin);
  TriangleMesh mesh;
  mesh.vertices = {{low.x(), low.y(), 0},
                   {high.x(), low.y(), 0},
                   {high.x(), high.y(), 0},
                   {low.x(), high.y(), 0}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  return mesh;
}

/// A tapered jaw with a flat inner face. Axes of R: x across, y towards the outside of the jaw, z
/// along the jaw to the tip.
TriangleMesh make_jaw_mesh(const Eigen::Matrix3d& R, const Eigen::Vector3d& pivot) {
  const double back = 0.0028;   // [m] half width and thickness at the pivot
  const double front = 0.0012;  // and at the tip
  TriangleMesh mesh;
  for (const auto& [z, size] : {std::pair{0.0, back}, std::pair{kJawLength, front}}) {
    mesh.vertices.push_back(pivot + R * Eigen::Vector3d(-size, 0, z));
    mesh.vertices.push_back(pivot + R * Eigen::Vector3d(size, 0, z));
    mesh.vertices.push_back(pivot + R * Eigen::Vector3d(0.6 * size, 0.8 * size, z));
    mesh.vertices.push_back(pivot + R * Eigen::Vector3d(-0.6 * size, 0.8 * size, z));
  }
  for (int k = 0; k < 4; ++k) {
    const int next = (k + 1) % 4;
    mesh.triangles.emplace_back(k, next, 4 + next);
    mesh.triangles.emplace_back(k, 4 + next, 4 + k);
  }
  mesh.triangles.emplace_back(0, 2, 1);
  mesh.triangles.emplace_back(0, 3, 2);
  mesh.triangles.emplace_back(4, 5, 6);
  mesh.triangles.emplace_back(4, 6, 7);
  return mesh;
}

}  // namespace

DrawSurface make_body_surface(const RigidShape& body, const Eigen::AlignedBox3d& workspace) {
  DrawSurface surface;
  TriangleMesh mesh;
  switch (body.kind) {
    case RigidShape::Kind::kSphere:
    case RigidShape::Kind::kEllipsoid:
      mesh = make_ellipsoid_mesh(body.size, kRings, kSectors);
      break;
    case RigidShape::Kind::kBox:
      mesh = make_box_mesh(body.size);
      break;
    case RigidShape::Kind::kHalfSpace:
      mesh = make_plane_mesh(body.X_WS, workspace);
      break;
    case RigidShape::Kind::kMesh:
      mesh = body.surface;
      break;
  }
  append_mesh(mesh, body.X_WS, surface);
  return surface;
}

std::vector<Edge> find_rim(const std::vector<Eigen::Vector3i>& triangles) {
  std::map<std::pair<int, int>, int> uses;
  for (const Eigen::Vector3i& t : triangles) {
    for (int k = 0; k < 3; ++k) ++uses[std::minmax({t[k], t[(k + 1) % 3]})];
  }
  std::vector<Edge> rim;
  for (const Eigen::Vector3i& t : triangles) {
    for (int k = 0; k < 3; ++k) {
      const Edge edge = {t[k], t[(k + 1) % 3]};
      if (uses[std::minmax({edge[0], edge[1]})] == 1) rim.push_back(edge);
    }
  }
  return rim;
}

DrawSurface make_tissue_surface(std::span<const float> vertices_W,
                                const std::vector<Eigen::Vector3d>& rest,
                                const std::vector<Eigen::Vector3i>& triangles,
                                const std::vector<Edge>& rim, double thickness,
                                std::span<const float> lower) {
  DrawSurface surface;
  const int count = static_cast<int>(vertices_W.size() / 3);
  OMENTUM_CHECK(static_cast<int>(rest.size()) == count, "{} vertices at rest, {} drawn",
                rest.size(), count);
  std::vector<Eigen::Vector3f> normal(count, Eigen::Vector3f::Zero());
  OMENTUM_CHECK(lower.empty() || lower.size() == vertices_W.size());
  const auto point = [&](int k) -> Eigen::Vector3f {  // of the mid-surface
    const Eigen::Vector3f given = Eigen::Vector3f::Map(&vertices_W[3 * k]);
    return lower.empty() ? given
                         : Eigen::Vector3f(0.5F * (given + Eigen::Vector3f::Map(&lower[3 * k])));
  };
  for (const Eigen::Vector3i& t : triangles) {
    OMENTUM_CHECK(t.minCoeff() >= 0 && t.maxCoeff() < count, "triangle refers to vertex {} of {}",
                  t.maxCoeff(), count);
    const Eigen::Vector3f area = (point(t[1]) - point(t[0])).cross(point(t[2]) - point(t[0]));
    for (const int k : t) normal[k] += area;
  }
  for (Eigen::Vector3f& n : normal)
    n = n.norm() > 0 ? Eigen::Vector3f(n.normalized()) : Eigen::Vector3f::UnitZ();
  const float half = static_cast<float>(thickness / 2);
  const auto face_point = [&](int k, float side) -> Eigen::Vector3f {
    if (lower.empty() || half <= 0) return point(k) + side * half * normal[k];
    return Eigen::Vector3f::Map(side > 0 ? &vertices_W[3 * k] : &lower[3 * k]);
  };
  const auto add_face = [&](float side) {
    const auto first = static_cast<std::uint32_t>(surface.vertices.size());
    for (int k = 0; k < count; ++k) {
      surface.vertices.push_back({face_point(k, side), side * normal[k], rest[k].cast<float>()});
    }
    for (const Eigen::Vector3i& t : triangles) {
      surface.indices.push_back(first + static_cast<std::uint32_t>(t[0]));
      surface.indices.push_back(first + static_cast<std::uint32_t>(side > 0 ? t[1] : t[2]));
      surface.indices.push_back(first + static_cast<std::uint32_t>(side > 0 ? t[2] : t[1]));
    }
  };
  add_face(1);
  if (half <= 0) return surface;
  add_face(-1);
  for (const auto& [a, b] : rim) {
    const Eigen::Vector3f outside = (point(b) - point(a)).cross(normal[a]).normalized();
    const auto first = static_cast<std::uint32_t>(surface.vertices.size());
    const Eigen::Vector3f ra = rest[a].cast<float>();
    const Eigen::Vector3f rb = rest[b].cast<float>();
    surface.vertices.push_back({face_point(a, 1), outside, ra});
    surface.vertices.push_back({face_point(b, 1), outside, rb});
    surface.vertices.push_back({face_point(b, -1), outside, rb});
    surface.vertices.push_back({face_point(a, -1), outside, ra});
    for (const std::uint32_t corner : {0U, 3U, 2U, 0U, 2U, 1U})
      surface.indices.push_back(first + corner);
  }
  return surface;
}

DrawSurface make_tool_surface(const ToolPose& pose, double shaft_radius, double shaft_start,
                              double shaft_length) {
  DrawSurface surface;
  const Eigen::Isometry3d identity = Eigen::Isometry3d::Identity();
  const Eigen::Vector3d z = pose.shaft_axis_W.normalized();
  const Eigen::Vector3d reference =
      std::abs(z.x()) < 0.9 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY();
  const Eigen::Vector3d x0 = (reference - reference.dot(z) * z).normalized();
  const Eigen::Matrix3d roll = Eigen::AngleAxisd(pose.roll_rad, z).toRotationMatrix();
  Eigen::Matrix3d R;
  R.col(0) = roll * x0;
  R.col(2) = z;
  R.col(1) = z.cross(R.col(0));
  const Eigen::Vector3d pivot = pose.p_WT - kJawLength * z;
  const double begin = std::max(shaft_start, kJawLength + shaft_radius);
  append_mesh(make_capsule_mesh(pose.p_WT - (begin + shaft_length) * z, pose.p_WT - begin * z,
                                shaft_radius, 32),
              identity, surface);
  append_mesh(make_capsule_mesh(pivot, pivot - 0.004 * z, 0.7 * shaft_radius, 24), identity,
              surface);
  for (const int side : {1, -1}) {
    // Each jaw rotates by half the angle about the x axis of the tool; side -1 is mirrored.
    Eigen::Matrix3d jaw =
        R *
        Eigen::AngleAxisd(-side * pose.jaw_rad / 2, Eigen::Vector3d::UnitX()).toRotationMatrix();
    if (side < 0)
      jaw = jaw * Eigen::AngleAxisd(std::acos(-1.0), Eigen::Vector3d::UnitZ()).toRotationMatrix();
    append_mesh(make_jaw_mesh(jaw, pivot), identity, surface);
  }
  return weld(surface);
}

}  // namespace omentum
