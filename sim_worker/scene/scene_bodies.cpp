// Rigid and soft bodies of a scene, and the meshes of both.
#include <algorithm>
#include <cmath>
#include <filesystem>

#include "core/check.h"
#include "core/constants.h"
#include "core/scene_files.h"
#include "sim_worker/scene/scene_parts.h"

namespace omentum {

using Eigen::Vector3d;

namespace {

constexpr int kSdfNodes = 64;

}  // namespace

/// Path of a mesh file; `knob` names it in the message.
std::string mesh_path(const pb::MeshFile& file, const std::string& directory,
                      const std::string& knob) {
  if (file.path().empty()) throw_error("{}.path: missing", knob);
  const std::string path = scene_file_path(file.path(), directory);
  std::error_code ignored;  // what is not there or must not be read is told where it is opened
  const std::filesystem::file_status status = std::filesystem::status(path, ignored);
  if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status))
    throw_error("{}.path: {} is no regular file", knob, path);
  return path;
}

TriangleMesh load_scene_mesh(const pb::MeshFile& file, const std::string& directory,
                             const std::string& path) {
  const std::string name = mesh_path(file, directory, path);
  TriangleMesh mesh = load_mesh(name, file.unit_m(), file.sha256());
  const double volume = signed_volume(mesh);
  require_closed(name, mesh);
  if (volume < 0) {
    throw_error("{}: the mesh is inside out, volume {:.3g} m^3, allowed faces that look outside",
                name, volume);
  }
  Vector3d min = mesh.vertices.front();
  Vector3d max = min;
  for (const Vector3d& v : mesh.vertices) {
    min = min.cwiseMin(v);
    max = max.cwiseMax(v);
  }
  const double extent = (max - min).maxCoeff();
  // Organs and tissue patches: 2 mm to 1 m. Outside it the unit of the file is wrong by a power of
  // ten.
  if (!(extent >= 0.002 && extent <= 1.0)) {
    throw_error("{}.unit_m: {} makes {} m of {}, allowed 0.002 ... 1 m", path, file.unit_m(),
                extent, file.path());
  }
  return mesh;
}

RigidShape make_rigid_body(const pb::RigidBody& config, const std::string& directory,
                           const std::string& path) {
  RigidShape body;
  body.name = config.name();
  body.role = config.role();
  body.X_WS = to_pose(config.pose(), path + ".pose");
  switch (config.shape_case()) {
    case pb::RigidBody::kSphereRadiusM:
      body.kind = RigidShape::Kind::kSphere;
      body.size = Vector3d::Constant(config.sphere_radius_m());
      body.surface = make_ellipsoid_mesh(body.size, 48, 96);
      break;
    case pb::RigidBody::kEllipsoidSemiAxesM:
      body.kind = RigidShape::Kind::kEllipsoid;
      body.size = to_vector(config.ellipsoid_semi_axes_m());
      if (!(body.size.minCoeff() >= 1e-4 && body.size.maxCoeff() <= 10)) {
        throw_error("{}.ellipsoid_semi_axes_m: {} ... {} m, allowed 0.0001 ... 10 m", path,
                    body.size.minCoeff(), body.size.maxCoeff());
      }
      body.surface = make_ellipsoid_mesh(body.size, 48, 96);
      break;
    case pb::RigidBody::kBoxHalfExtentsM:
      body.kind = RigidShape::Kind::kBox;
      body.size = to_vector(config.box_half_extents_m());
      if (!(body.size.minCoeff() >= 1e-4)) {
        throw_error("{}.box_half_extents_m: {} m, allowed at least 0.0001 m", path,
                    body.size.minCoeff());
      }
      body.surface = make_box_mesh(body.size);
      break;
    case pb::RigidBody::kHalfSpace: {
      body.kind = RigidShape::Kind::kHalfSpace;
      body.size = Vector3d(0.15, 0.15, 0);  // drawn as a board of this half extent
      body.surface.vertices = {
          {-0.15, -0.15, 0}, {0.15, -0.15, 0}, {0.15, 0.15, 0}, {-0.15, 0.15, 0}};
      body.surface.triangles = {{0, 1, 2}, {0, 2, 3}};
      break;
    }
    case pb::RigidBody::kMesh: {
      body.kind = RigidShape::Kind::kMesh;
      body.surface = load_scene_mesh(config.mesh(), directory, path + ".mesh");
      body.sdf = std::make_shared<SdfGrid>(make_sdf_grid(body.surface, kSdfNodes, 0.01));
      break;
    }
    case pb::RigidBody::SHAPE_NOT_SET:
      throw_error(
          "{}: no shape, allowed one of sphere_radius_m, ellipsoid_semi_axes_m, "
          "box_half_extents_m, "
          "half_space, mesh",
          path);
  }
  return body;
}

namespace {

/// Ellipsoid whose facets are half an edge length, but at least 8 degrees, long: the mesher, which
/// draws its own on top, follows finer ones whatever edge it is asked for. Of the volume of the
/// ellipsoid, which facets inside of it would not have.
TriangleMesh soft_ellipsoid(const Vector3d& semi_axes, double edge_length) {
  const double facets = 2 * kPi * semi_axes.maxCoeff() / edge_length;  // from pole to pole
  const int rings = std::clamp(static_cast<int>(facets), 8, 24) - 1;
  TriangleMesh mesh = make_ellipsoid_mesh(semi_axes, rings, 2 * rings + 2);
  const double scale = std::cbrt(4.0 / 3 * kPi * semi_axes.prod() / signed_volume(mesh));
  for (Vector3d& vertex : mesh.vertices) vertex *= scale;
  return mesh;
}

TriangleMesh soft_body_surface(const pb::DeformableBody& config, const std::string& directory,
                               const std::string& path) {
  switch (config.shape_case()) {
    case pb::DeformableBody::kMesh:
      return load_scene_mesh(config.mesh(), directory, path + ".mesh");
    case pb::DeformableBody::kEllipsoidSemiAxesM:
    case pb::DeformableBody::kBoxHalfExtentsM: {
      const bool is_box = config.has_box_half_extents_m();
      const Vector3d size =
          to_vector(is_box ? config.box_half_extents_m() : config.ellipsoid_semi_axes_m());
      if (!(size.minCoeff() >= 1e-3 && size.maxCoeff() <= 1)) {
        throw_error("{}.{}: {} ... {} m, allowed 0.001 ... 1 m", path,
                    is_box ? "box_half_extents_m" : "ellipsoid_semi_axes_m", size.minCoeff(),
                    size.maxCoeff());
      }
      return is_box ? make_box_mesh(size) : soft_ellipsoid(size, config.edge_length_m());
    }
    case pb::DeformableBody::SHAPE_NOT_SET:
      break;
  }
  throw_error("{}: no shape, allowed one of mesh, ellipsoid_semi_axes_m, box_half_extents_m", path);
}

}  // namespace

SoftBody make_soft_body(const pb::DeformableBody& config, const std::string& directory,
                        bool supported) {
  const std::string path = "scene.body[0]";
  if (config.role() == pb::ROLE_TUMOUR) {
    throw_error(
        "{}.role: ROLE_TUMOUR, allowed ROLE_ORGAN, ROLE_OBSTACLE: the exposure counts a tumour "
        "that does not move (scene.rigid_body)",
        path);
  }
  SoftBody soft;
  soft.name = config.name();
  soft.role = config.role();
  TissueBody& body = soft.body;
  body.X_WB = to_pose(config.pose(), path + ".pose");
  body.particle_radius = config.particle_radius_m();
  soft.mesh = fill_mesh(soft_body_surface(config, directory, path), path, config.edge_length_m());
  body.particles = soft.mesh.nodes;
  body.surface_triangles = soft.mesh.surface;
  std::size_t fixed = 0;
  for (const Vector3d& p : body.particles) {
    body.fixed.push_back((body.X_WB * p).z() <= config.anchor_max_z_m() + 1e-9 ? 1 : 0);
    fixed += body.fixed.back();
  }
  const std::size_t least = supported ? 0 : 1;
  if (fixed < least || fixed == body.particles.size()) {
    throw_error("{}.anchor_max_z_m: {} fixes {} of {} nodes, allowed {} ... {}", path,
                config.anchor_max_z_m(), fixed, body.particles.size(), least,
                body.particles.size() - 1);
  }
  return soft;
}

}  // namespace omentum
