#include "sim_worker/scene/scene.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/config.h"
#include "core/constants.h"
#include "core/psm.h"
#include "sim_worker/scene/scene_parts.h"

namespace omentum {

using Eigen::Vector3d;

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

namespace {

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

std::vector<TumourPlace> make_tumour_places(const pb::Scene& config) {
  std::vector<TumourPlace> places;
  for (const pb::TumourPlace& place : config.tumour_place()) {
    const Vector3d normal = to_vector(place.normal());
    // Its length is that of rounded numbers, or it is something else.
    if (!(std::fabs(normal.norm() - 1) <= 0.01)) {
      throw_error(
          "scene.tumour_place[{}].normal: ({}, {}, {}) of length {:.4g}, allowed 0.99 ... 1.01",
          places.size(), normal.x(), normal.y(), normal.z(), normal.norm());
    }
    places.push_back({to_vector(place.position_m()), normal.normalized()});
  }
  return places;
}

bool has_workspace(const pb::Scene& config) {
  return config.has_workspace_min_m() || config.has_workspace_max_m();
}

/// The endoscope.
void make_camera(const pb::Camera& camera, CameraPose& pose) {
  pose.position = to_vector(camera.position_m());
  const Vector3d axis = to_vector(camera.axis());
  const Vector3d up = to_vector(camera.up());
  if (!(axis.cross(up).norm() > 1e-3))
    throw_error("scene.camera: axis and up are parallel or zero");
  pose.R_WC.col(2) = -axis.normalized();
  pose.R_WC.col(0) = axis.cross(up).normalized();
  pose.R_WC.col(1) = pose.R_WC.col(2).cross(pose.R_WC.col(0));
  pose.vertical_fov_rad = camera.vertical_fov_deg() * kDegree;
  pose.near_m = camera.near_m();
  pose.far_m = camera.far_m();
  if (!(camera.near_m() < camera.far_m())) {
    throw_error("scene.camera.near_m: {}, allowed below far_m {}", camera.near_m(), camera.far_m());
  }
}

/// The units guard (docs/task.md 10 row 1): a scale declared once, everything checked against it.
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
  if (has_workspace(scene.config) && !(extent.minCoeff() >= 0.001 && extent.maxCoeff() <= 1.0)) {
    throw_error(
        "scene.workspace_m: extent {:.4g} ... {:.4g} m, allowed 0.001 ... 1 m: are the lengths in "
        "metres?",
        extent.minCoeff(), extent.maxCoeff());
  }
  if (scene.tissue.particles.empty()) return;
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

/// Tissue that no clamp holds may lie on something, and in a recording without a task also fall.
void check_support(const Scene& scene, std::vector<std::string>& warnings) {
  if (scene.is_clamped()) return;
  if (!scene.falls()) {
    warnings.push_back("scene.tissue.anchor_max_y_m: fixes nothing, the tissue lies free");
  } else if (scene.config.has_target_m()) {
    throw_error(
        "scene.tissue.anchor_max_y_m: {} fixes no particle and nothing lies under the tissue, "
        "allowed where the scene has no target_m",
        scene.config.tissue().anchor_max_y_m());
  } else {
    warnings.push_back("scene.tissue: nothing holds it and nothing lies under it, so it falls");
  }
}

}  // namespace

bool Scene::is_clamped() const {
  return std::ranges::any_of(tissue.fixed, [](std::uint8_t fixed) { return fixed != 0; });
}

bool Scene::falls() const {
  return !is_clamped() && bodies.empty() && !soft_body && !gravity.isZero(0);
}

Scene make_scene(const pb::Scene& config, const std::string& directory) {
  Scene scene;
  scene.config = config;
  scene.gravity = Vector3d(0, 0, -config.gravity_m_per_s2() * config.gravity_scale());
  if (config.has_tissue()) {
    scene.tissue = make_tissue_body(config.tissue(), directory, scene.solid, scene.sheet);
  }
  for (int i = 0; i < config.rigid_body_size(); ++i) {
    scene.bodies.push_back(
        make_rigid_body(config.rigid_body(i), directory, fmt::format("scene.rigid_body[{}]", i)));
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
    scene.bodies.push_back(make_rigid_body(sphere, directory, "scene.tissue.effects.obstacle"));
  }
  if (config.body_size() > 1) {
    throw_error(
        "scene.body: {} bodies, allowed at most 1: deformable bodies do not feel each other",
        config.body_size());
  }
  if (config.body_size() == 1)
    scene.soft_body = make_soft_body(config.body(0), directory, !scene.bodies.empty());
  const pb::Camera& camera = config.camera();
  if (config.has_camera()) make_camera(camera, scene.camera);
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
  const auto require_in_workspace = [&](const Vector3d& p, const std::string& name) {
    for (int k = 0; k < 3 && has_workspace(config); ++k) {
      if (p[k] >= scene.workspace_min[k] && p[k] <= scene.workspace_max[k]) continue;
      throw_error("{}: coordinate {} is {} m, allowed {} ... {} m (workspace)", name, "xyz"[k],
                  p[k], scene.workspace_min[k], scene.workspace_max[k]);
    }
  };
  const auto require_reachable = [&](const Vector3d& p, const std::string& name) {
    require_in_workspace(p, name);
    const Result<PsmJoints> joints = joints_for_tip(mount, p);
    if (!joints)
      throw_error("{}: ({}, {}, {}) m is out of reach: {}", name, p.x(), p.y(), p.z(),
                  joints.error());
  };
  if (config.has_tool_start_m()) require_reachable(scene.tool_start, "scene.tool_start_m");
  if (config.has_target_m()) require_reachable(scene.target, "scene.target_m");
  for (const Vector3d& p : scene.grid_starts) require_reachable(p, "scene.start_grid");
  for (const Vector3d& p : scene.robot_starts) require_reachable(p, "scene.robot_grid");
  scene.tumour_places = make_tumour_places(config);
  for (std::size_t i = 0; i < scene.tumour_places.size(); ++i)
    require_in_workspace(scene.tumour_places[i].p,
                         fmt::format("scene.tumour_place[{}].position_m", i));
  if (config.has_tumour_point_m()) require_in_workspace(scene.tumour_point, "scene.tumour_point_m");
  if (config.has_tissue()) {
    check_support(scene, scene.warnings);
    check_places(scene, scene.warnings);
  }
  return scene;
}

std::string with_place(const std::string& file, const std::string& message) {
  const bool of_knob = message.starts_with("scene.") || message.starts_with("tissue.");
  if (file.empty() || !of_knob) return message;
  const std::string place = place_in_scene(file, message);
  return (place.empty() ? file + ": " : place) + message;
}

ToolMount scene_tool_mount(const Scene& scene) {
  const pb::Tool& tool = scene.config.tool();
  ToolMount mount =
      make_tool_mount(to_pose(tool.base(), "scene.tool.base"), tool.roll_deg() * kDegree,
                      tool.tip_offset_m(), scene.workspace_min, scene.workspace_max);
  if (!tool.has_shaft_direction()) return mount;
  const Vector3d direction = to_vector(tool.shaft_direction());
  if (!(direction.norm() > 1e-3) || !(direction.z() <= 0)) {
    throw_error(
        "scene.tool.shaft_direction: ({}, {}, {}), allowed: not zero, and not upwards (it points "
        "to the tip)",
        direction.x(), direction.y(), direction.z());
  }
  // The least turn that takes -z_W there: the roll about the shaft stays what it is.
  mount.R_WC =
      Eigen::Quaterniond::FromTwoVectors(-Vector3d::UnitZ(), direction).toRotationMatrix() *
      mount.R_WC;
  return mount;
}

}  // namespace omentum
