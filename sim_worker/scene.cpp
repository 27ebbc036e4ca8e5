#include "sim_worker/scene.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/check.h"
#include "core/psm.h"
#include "core/rng.h"
#include "sim_worker/cooker.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kStandardGravity = 9.80665;  // [m/s^2], CGPM 1901
constexpr int kSdfNodes = 64;

Vector3d to_vector(const pb::Vec3& v) { return {v.x(), v.y(), v.z()}; }

Eigen::Isometry3d to_pose(const pb::Pose& pose, const std::string& path) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.translation() = to_vector(pose.translation_m());
  if (!pose.has_x_axis() && !pose.has_y_axis() && !pose.has_z_axis()) return X;
  if (!pose.has_x_axis() || !pose.has_y_axis())
    throw_error("{}: give x_axis and y_axis, or no axis", path);
  const Vector3d x_given = to_vector(pose.x_axis());
  const Vector3d y_given = to_vector(pose.y_axis());
  if (!(x_given.cross(y_given).norm() > 0.1 * x_given.norm() * y_given.norm())) {
    throw_error("{}: x_axis and y_axis are parallel or zero", path);
  }
  const Vector3d z = x_given.cross(y_given).normalized();
  const Vector3d x = x_given.normalized();
  X.linear().col(0) = x;
  X.linear().col(1) = z.cross(x);
  X.linear().col(2) = z;
  return X;
}

/// Path of a mesh file; `knob` names it in the message.
std::string mesh_path(const pb::MeshFile& file, const std::string& directory,
                      const std::string& knob) {
  if (file.path().empty()) throw_error("{}.path: missing", knob);
  if (file.path().front() == '/' || directory.empty()) return file.path();
  return directory + "/" + file.path();
}

TriangleMesh load_scene_mesh(const pb::MeshFile& file, const std::string& directory,
                             const std::string& path) {
  TriangleMesh mesh = load_closed_mesh(mesh_path(file, directory, path), file.unit_m());
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

RigidShape make_body(const pb::RigidBody& config, const std::string& directory,
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

/// Area-weighted random points of a surface, from our counter-based generator (volume maker,
/// surface sampling).
std::vector<Vector3d> sample_surface(const TriangleMesh& mesh, double surface_sampling) {
  std::vector<Vector3d> samples;
  if (!(surface_sampling > 0)) return samples;
  samples = mesh.vertices;
  std::vector<double> cumulative;
  double total = 0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Vector3d& a = mesh.vertices[static_cast<std::size_t>(t[0])];
    const Vector3d& b = mesh.vertices[static_cast<std::size_t>(t[1])];
    const Vector3d& c = mesh.vertices[static_cast<std::size_t>(t[2])];
    total += 0.5 * (b - a).cross(c - a).norm();
    cumulative.push_back(total);
  }
  const auto count = static_cast<std::uint32_t>(50000 * surface_sampling);
  for (std::uint32_t i = 0; i < count; ++i) {
    const PhiloxWords words = philox({i, 0, 0, 0}, {0, 0});
    const double where = static_cast<double>(words[0]) * 0x1p-32 * total;
    const auto k = static_cast<std::size_t>(std::min<std::ptrdiff_t>(
        std::upper_bound(cumulative.begin(), cumulative.end(), where) - cumulative.begin(),
        static_cast<std::ptrdiff_t>(cumulative.size()) - 1));
    double u = static_cast<double>(words[1]) * 0x1p-32;
    double v = static_cast<double>(words[2]) * 0x1p-32;
    if (u + v > 1) {
      u = 1 - u;
      v = 1 - v;
    }
    const Eigen::Vector3i& t = mesh.triangles[k];
    const Vector3d& a = mesh.vertices[static_cast<std::size_t>(t[0])];
    samples.emplace_back(a + u * (mesh.vertices[static_cast<std::size_t>(t[1])] - a) +
                         v * (mesh.vertices[static_cast<std::size_t>(t[2])] - a));
  }
  return samples;
}

void make_grid_tissue(const pb::GridMaker& grid, const pb::Tissue& config, TissueBody& body) {
  body.particles = make_grid_particles(grid);
  body.surface_is_particles = true;
  const auto ny = static_cast<int>(grid.count_y());
  for (int ix = 0; ix + 1 < static_cast<int>(grid.count_x()); ++ix) {
    for (int iy = 0; iy + 1 < ny; ++iy) {
      const int a = ix * ny + iy;
      const int b = a + ny;
      // Alternating diagonals, so that no direction of the sheet is preferred.
      if ((ix + iy) % 2 == 0) {
        body.surface_triangles.emplace_back(a, b, b + 1);
        body.surface_triangles.emplace_back(a, b + 1, a + 1);
      } else {
        body.surface_triangles.emplace_back(a, b, a + 1);
        body.surface_triangles.emplace_back(b, b + 1, a + 1);
      }
    }
  }
  const double area = static_cast<double>((grid.count_x() - 1) * (grid.count_y() - 1)) *
                      grid.pitch_m() * grid.pitch_m();
  body.particle_mass = config.density_kg_per_m3() * config.thickness_m() * area /
                       static_cast<double>(body.particles.size());
}

void make_sheet_tissue(const pb::SheetMaker& maker, const std::string& directory,
                       const pb::Tissue& config, TissueBody& body, SheetGeometry& sheet) {
  const std::string path = mesh_path(maker.mesh(), directory, "scene.tissue.sheet.mesh");
  const TriangleMesh mesh = load_mesh(path, maker.mesh().unit_m());
  require_sheet(path, mesh);
  body.particles = mesh.vertices;
  body.surface_triangles = mesh.triangles;
  body.surface_is_particles = true;
  sheet = measure_sheet(path, mesh.vertices, mesh.triangles);
  double area = 0;
  for (const SheetTriangle& triangle : sheet.triangles) area += triangle.area;
  body.particle_mass = config.density_kg_per_m3() * config.thickness_m() * area /
                       static_cast<double>(body.particles.size());
}

ThicknessMap make_thickness_map(const pb::ThicknessMap& config, const TissueBody& body) {
  ThicknessMap map;
  map.count_x = static_cast<int>(config.count_x());
  map.count_y = static_cast<int>(config.count_y());
  map.ratio.assign(config.ratio().begin(), config.ratio().end());
  if (config.ratio_size() != map.count_x * map.count_y) {
    throw_error("scene.tissue.thickness_map.ratio: {} values, allowed count_x count_y = {}",
                config.ratio_size(), map.count_x * map.count_y);
  }
  for (std::size_t k = 0; k < map.ratio.size(); ++k) {
    if (map.ratio[k] >= 0.2 && map.ratio[k] <= 5) continue;
    throw_error("scene.tissue.thickness_map.ratio[{}]: {}, allowed 0.2 ... 5", k, map.ratio[k]);
  }
  map.low = map.high = body.particles.front().head<2>();
  for (const Vector3d& p : body.particles) {
    map.low = map.low.cwiseMin(p.head<2>());
    map.high = map.high.cwiseMax(p.head<2>());
  }
  return map;
}

void make_volume_tissue(const pb::VolumeMaker& maker, const std::string& directory,
                        const pb::Tissue& config, TissueBody& body, SolidMesh& solid) {
  TriangleMesh mesh;
  Vector3d min;
  Vector3d max;
  std::function<std::vector<bool>(std::span<const Vector3d>)> inside;
  if (maker.has_mesh()) {
    mesh = load_scene_mesh(maker.mesh(), directory, "scene.tissue.volume.mesh");
    min = max = mesh.vertices.front();
    for (const Vector3d& v : mesh.vertices) {
      min = min.cwiseMin(v);
      max = max.cwiseMax(v);
    }
    inside = [&mesh](std::span<const Vector3d> points) { return points_inside(mesh, points); };
  } else if (maker.has_box_m()) {
    const Vector3d half = 0.5 * to_vector(maker.box_m());
    if (!(half.minCoeff() >= 1e-4))
      throw_error("scene.tissue.volume.box_m: an edge below 0.0002 m");
    mesh = make_box_mesh(half);
    min = -half;
    max = half;
    inside = [half](std::span<const Vector3d> points) {
      std::vector<bool> result;
      for (const Vector3d& p : points)
        result.push_back((p.cwiseAbs().array() < half.array()).all());
      return result;
    };
  } else {
    throw_error("scene.tissue.volume: give box_m or mesh");
  }
  if (config.model() == pb::TISSUE_ELASTIC) {
    solid = fill_mesh(mesh, "scene.tissue.volume", maker.edge_length_m());
    body.particles = solid.nodes;
    body.surface_triangles = solid.surface;
    body.particle_mass = config.density_kg_per_m3() * signed_volume(mesh) /
                         static_cast<double>(body.particles.size());
    return;
  }
  body.particles = make_volume_particles(maker, min, max, inside,
                                         sample_surface(mesh, maker.surface_sampling()));
  if (body.particles.size() < 4) {
    throw_error("scene.tissue.volume.particle_spacing_m: {} makes {} particles, allowed at least 4",
                maker.particle_spacing_m(), body.particles.size());
  }
  body.surface_is_particles = false;
  body.surface_vertices = mesh.vertices;
  body.surface_triangles = mesh.triangles;
  body.particle_mass =
      config.density_kg_per_m3() * signed_volume(mesh) / static_cast<double>(body.particles.size());
}

TissueBody make_tissue_body(const pb::Tissue& config, const std::string& directory, bool supported,
                            SolidMesh& solid, SheetGeometry& sheet) {
  TissueBody body;
  body.X_WB = to_pose(config.pose(), "scene.tissue.pose");
  body.particle_radius = config.particle_radius_m();
  body.thickness = config.thickness_m();
  if (config.has_grid()) {
    make_grid_tissue(config.grid(), config, body);
  } else if (config.has_volume()) {
    make_volume_tissue(config.volume(), directory, config, body, solid);
  } else if (config.has_sheet()) {
    make_sheet_tissue(config.sheet(), directory, config, body, sheet);
  } else {
    throw_error("scene.tissue: give grid, sheet or volume");
  }
  if (config.has_thickness_map()) {
    if (config.has_volume() || config.model() == pb::TISSUE_CLUSTER) {
      throw_error(
          "scene.tissue.thickness_map: allowed for a sheet of the models elastic and reference");
    }
    body.thickness_map = make_thickness_map(config.thickness_map(), body);
  }
  std::size_t fixed = 0;
  for (const Vector3d& p : body.particles) {
    // 1e-9 m: a row that lies exactly on the bound is anchored whatever its rounding.
    body.fixed.push_back(p.y() <= config.anchor_max_y_m() + 1e-9 ? 1 : 0);
    fixed += body.fixed.back();
  }
  // An elastic solid may lie on something instead.
  const std::size_t least = supported && !solid.nodes.empty() ? 0 : 1;
  if (fixed < least || fixed == body.particles.size()) {
    throw_error("scene.tissue.anchor_max_y_m: {} fixes {} of {} particles, allowed {} ... {}",
                config.anchor_max_y_m(), fixed, body.particles.size(), least,
                body.particles.size() - 1);
  }
  return body;
}

/// Ellipsoid whose facets are half an edge length, but at least 8 degrees, long: the mesher, which
/// draws its own on top, follows finer ones whatever edge it is asked for. Of the volume of the
/// ellipsoid, which facets inside of it would not have.
TriangleMesh soft_ellipsoid(const Vector3d& semi_axes, double edge_length) {
  constexpr double kPi = std::numbers::pi;
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

std::vector<Vector3d> make_starts(const pb::StartGrid& grid) {
  std::vector<Vector3d> starts;
  const Vector3d centre = to_vector(grid.centre_m());
  for (unsigned row = 0; row < grid.rows(); ++row) {
    for (unsigned column = 0; column < grid.columns(); ++column) {
      starts.push_back(centre +
                       Vector3d((column - 0.5 * (grid.columns() - 1)) * grid.column_pitch_m(),
                                (row - 0.5 * (grid.rows() - 1)) * grid.row_pitch_m(), 0));
    }
  }
  return starts;
}

/// The units guard (seed_task.md 12 row 1): a scale declared once, everything checked against it.
void check_units(const Scene& scene, std::vector<std::string>& warnings) {
  const double g = scene.config.gravity_m_per_s2();
  // 5 %: gravity on Earth varies by 0.5 %; anything farther off is meant otherwise or in another
  // unit.
  if (std::fabs(g - kStandardGravity) > 0.05 * kStandardGravity) {
    warnings.push_back(
        fmt::format("scene.gravity_m_per_s2: {} is not {} m/s^2; name a wanted deviation with "
                    "gravity_scale",
                    g, kStandardGravity));
  }
  const Vector3d extent = scene.workspace_max - scene.workspace_min;
  if (!(extent.minCoeff() >= 0.001 && extent.maxCoeff() <= 1.0)) {
    throw_error(
        "scene.workspace_m: extent {:.4g} ... {:.4g} m, allowed 0.001 ... 1 m: are the lengths in "
        "metres?",
        extent.minCoeff(), extent.maxCoeff());
  }
  Vector3d min = scene.tissue.particles.front();
  Vector3d max = min;
  for (const Vector3d& p : scene.tissue.particles) {
    min = min.cwiseMin(p);
    max = max.cwiseMax(p);
  }
  const double size = (max - min).maxCoeff();
  if (!(size >= 0.002 && size <= 1.0)) {
    throw_error("scene.tissue: {:.4g} m across, allowed 0.002 ... 1 m: are the lengths in metres?",
                size);
  }
}

}  // namespace

Scene make_scene(const pb::Scene& config, const std::string& directory) {
  Scene scene;
  scene.config = config;
  scene.gravity = Vector3d(0, 0, -config.gravity_m_per_s2() * config.gravity_scale());
  scene.tissue = make_tissue_body(config.tissue(), directory, config.rigid_body_size() > 0,
                                  scene.solid, scene.sheet);
  for (int i = 0; i < config.rigid_body_size(); ++i) {
    scene.bodies.push_back(
        make_body(config.rigid_body(i), directory, fmt::format("scene.rigid_body[{}]", i)));
    if (scene.bodies.back().role == pb::ROLE_TUMOUR) {
      if (scene.tumour >= 0)
        throw_error("scene.rigid_body[{}].role: a second tumour, allowed one", i);
      scene.tumour = i;
    }
  }
  const pb::Obstacle& obstacle = config.tissue().effects().obstacle();
  if (obstacle.radius_m() > 0) {
    pb::RigidBody sphere;
    sphere.set_name("obstacle");
    sphere.set_role(pb::ROLE_OBSTACLE);
    sphere.mutable_pose()->mutable_translation_m()->set_x(obstacle.x_m());
    sphere.mutable_pose()->mutable_translation_m()->set_y(obstacle.y_m());
    sphere.mutable_pose()->mutable_translation_m()->set_z(obstacle.z_m());
    sphere.set_sphere_radius_m(obstacle.radius_m());
    scene.bodies.push_back(make_body(sphere, directory, "scene.tissue.effects.obstacle"));
  }
  if (config.body_size() > 1) {
    throw_error(
        "scene.body: {} bodies, allowed at most 1: deformable bodies do not feel each other",
        config.body_size());
  }
  if (config.body_size() == 1)
    scene.soft_body = make_soft_body(config.body(0), directory, !scene.bodies.empty());
  const pb::Camera& camera = config.camera();
  scene.camera.position = to_vector(camera.position_m());
  const Vector3d axis = to_vector(camera.axis());
  const Vector3d up = to_vector(camera.up());
  if (!(axis.cross(up).norm() > 1e-3))
    throw_error("scene.camera: axis and up are parallel or zero");
  scene.camera.R_WC.col(2) = -axis.normalized();
  scene.camera.R_WC.col(0) = axis.cross(up).normalized();
  scene.camera.R_WC.col(1) = scene.camera.R_WC.col(2).cross(scene.camera.R_WC.col(0));
  constexpr double kDegree = 3.14159265358979323846 / 180;
  scene.camera.vertical_fov_rad = camera.vertical_fov_deg() * kDegree;
  scene.camera.near_m = camera.near_m();
  scene.camera.far_m = camera.far_m();
  if (!(camera.near_m() < camera.far_m())) {
    throw_error("scene.camera.near_m: {}, allowed below far_m {}", camera.near_m(), camera.far_m());
  }
  scene.exposure_fov_rad = camera.exposure_fov_deg() * kDegree;
  scene.exposure_pixels = static_cast<int>(camera.exposure_pixels());
  scene.workspace_min = to_vector(config.workspace_min_m());
  scene.workspace_max = to_vector(config.workspace_max_m());
  scene.tool_start = to_vector(config.tool_start_m());
  scene.target = to_vector(config.target_m());
  scene.tumour_point = to_vector(config.tumour_point_m());
  if (config.has_start_grid()) scene.grid_starts = make_starts(config.start_grid());
  if (config.has_robot_grid()) scene.robot_starts = make_starts(config.robot_grid());
  check_units(scene, scene.warnings);
  const ToolMount mount = scene_tool_mount(scene);
  const auto require_reachable = [&](const Vector3d& p, const std::string& name) {
    for (int k = 0; k < 3; ++k) {
      if (!(p[k] >= scene.workspace_min[k] && p[k] <= scene.workspace_max[k])) {
        throw_error("{}: coordinate {} is {} m, allowed {} ... {} m (workspace)", name, "xyz"[k],
                    p[k], scene.workspace_min[k], scene.workspace_max[k]);
      }
    }
    const Result<PsmJoints> joints = joints_for_tip(mount, p);
    if (!joints)
      throw_error("{}: ({}, {}, {}) m is out of reach: {}", name, p.x(), p.y(), p.z(),
                  joints.error());
  };
  require_reachable(scene.tool_start, "scene.tool_start_m");
  require_reachable(scene.target, "scene.target_m");
  for (const Vector3d& p : scene.grid_starts) require_reachable(p, "scene.start_grid");
  for (const Vector3d& p : scene.robot_starts) require_reachable(p, "scene.robot_grid");
  return scene;
}

ToolMount scene_tool_mount(const Scene& scene) {
  const pb::Tool& tool = scene.config.tool();
  constexpr double kDegree = 3.14159265358979323846 / 180;
  return make_tool_mount(to_pose(tool.base(), "scene.tool.base"), tool.roll_deg() * kDegree,
                         tool.tip_offset_m(), scene.workspace_min, scene.workspace_max);
}

}  // namespace omentum
