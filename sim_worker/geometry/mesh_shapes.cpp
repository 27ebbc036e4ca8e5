#include <Eigen/Geometry>
#include <algorithm>

#include "core/check.h"
#include "core/constants.h"
#include "core/trig.h"
#include "sim_worker/geometry/mesh.h"

namespace omentum {
namespace {

/// Triangles of a surface of revolution: pole, `rings` rings of `sectors` vertices each, pole.
///
///   0            pole, top (+z)
///   1 .. S       ring 0, counter-clockwise seen from +z
///   ...
///   1 + R S      pole, bottom
void add_revolution_triangles(int rings, int sectors, TriangleMesh& mesh) {
  const auto at = [&](int ring, int sector) { return 1 + ring * sectors + sector % sectors; };
  const int bottom = 1 + rings * sectors;
  for (int k = 0; k < sectors; ++k) {
    mesh.triangles.emplace_back(0, at(0, k), at(0, k + 1));
    for (int ring = 0; ring + 1 < rings; ++ring) {
      mesh.triangles.emplace_back(at(ring, k), at(ring + 1, k), at(ring + 1, k + 1));
      mesh.triangles.emplace_back(at(ring, k), at(ring + 1, k + 1), at(ring, k + 1));
    }
    mesh.triangles.emplace_back(bottom, at(rings - 1, k + 1), at(rings - 1, k));
  }
}

}  // namespace

TriangleMesh make_ellipsoid_mesh(const Eigen::Vector3d& semi_axes, int rings, int sectors) {
  OMENTUM_CHECK(rings >= 1 && sectors >= 3, "{} rings, {} sectors", rings, sectors);
  TriangleMesh mesh;
  mesh.vertices.emplace_back(0, 0, semi_axes.z());
  for (int ring = 0; ring < rings; ++ring) {
    const trig::SinCos polar = trig::sin_cos(kPi * (ring + 1) / (rings + 1));
    for (int k = 0; k < sectors; ++k) {
      const trig::SinCos around = trig::sin_cos(2 * kPi * k / sectors);
      mesh.vertices.emplace_back(semi_axes.x() * polar.sin * around.cos,
                                 semi_axes.y() * polar.sin * around.sin, semi_axes.z() * polar.cos);
    }
  }
  mesh.vertices.emplace_back(0, 0, -semi_axes.z());
  add_revolution_triangles(rings, sectors, mesh);
  return mesh;
}

TriangleMesh make_box_mesh(const Eigen::Vector3d& half_extents) {
  TriangleMesh mesh;
  for (int corner = 0; corner < 8; ++corner) {  // bit 0, 1, 2 = upper side in x, y, z
    mesh.vertices.emplace_back((corner & 1 ? 1 : -1) * half_extents.x(),
                               (corner & 2 ? 1 : -1) * half_extents.y(),
                               (corner & 4 ? 1 : -1) * half_extents.z());
  }
  for (int axis = 0; axis < 3; ++axis) {
    const int u = 1 << axis;
    const int v = 1 << ((axis + 1) % 3);
    const int w = 1 << ((axis + 2) % 3);
    mesh.triangles.emplace_back(u, u + v, u + v + w);  // face on the upper side of `axis`
    mesh.triangles.emplace_back(u, u + v + w, u + w);
    mesh.triangles.emplace_back(0, v + w, v);  // and on the lower side
    mesh.triangles.emplace_back(0, w, v + w);
  }
  return mesh;
}

TriangleMesh make_capsule_mesh(const Eigen::Vector3d& p0, const Eigen::Vector3d& p1, double radius,
                               int sectors) {
  OMENTUM_CHECK(sectors >= 3 && radius > 0, "{} sectors, radius {}", sectors, radius);
  const Eigen::Vector3d along = p1 - p0;
  const Eigen::Vector3d z =
      along.norm() > 1e-12 ? Eigen::Vector3d(along.normalized()) : Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d x = z.unitOrthogonal();
  const Eigen::Vector3d y = z.cross(x);
  const int half = std::max(1, sectors / 4);  // rings per cap, the equator included
  TriangleMesh mesh;
  mesh.vertices.push_back(p1 + radius * z);
  for (int ring = 0; ring < 2 * half; ++ring) {
    const bool upper = ring < half;
    const trig::SinCos polar = trig::sin_cos(kPi / 2 * (upper ? ring + 1 : ring) / half);
    const Eigen::Vector3d& centre = upper ? p1 : p0;
    for (int k = 0; k < sectors; ++k) {
      const trig::SinCos around = trig::sin_cos(2 * kPi * k / sectors);
      mesh.vertices.push_back(centre + radius * (polar.sin * around.cos * x +
                                                 polar.sin * around.sin * y + polar.cos * z));
    }
  }
  mesh.vertices.push_back(p0 - radius * z);
  add_revolution_triangles(2 * half, sectors, mesh);
  return mesh;
}

}  // namespace omentum
