// Whether bodies, camera and the points of the task are where they can be meant.
#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/constants.h"
#include "core/trig.h"
#include "sim_worker/scene/scene_parts.h"

namespace omentum {
namespace {

using Eigen::AlignedBox3d;
using Eigen::Vector3d;
using Points = std::vector<Vector3d>;  ///< p_W [m]

AlignedBox3d box_of(std::span<const Vector3d> points) {
  AlignedBox3d box;
  for (const Vector3d& p : points) box.extend(p);
  return box;
}

Points in_world(const Eigen::Isometry3d& X_WB, std::span<const Vector3d> points) {
  Points moved;
  for (const Vector3d& p : points) moved.emplace_back(X_WB * p);
  return moved;
}

std::vector<bool> points_in_body(const RigidShape& body, std::span<const Vector3d> points) {
  const Points p_S = in_world(body.X_WS.inverse(), points);
  if (body.kind == RigidShape::Kind::kMesh) return points_inside(body.surface, p_S);
  std::vector<bool> inside;
  for (const Vector3d& p : p_S) {
    switch (body.kind) {
      case RigidShape::Kind::kBox:
        inside.push_back((p.cwiseAbs().array() < body.size.array()).all());
        break;
      case RigidShape::Kind::kHalfSpace:
        inside.push_back(p.z() < 0);
        break;
      default:
        inside.push_back(p.cwiseQuotient(body.size).squaredNorm() < 1);
    }
  }
  return inside;
}

/// The first body that holds the point; null = it is free.
const RigidShape* body_around(const Scene& scene, const Vector3d& point) {
  for (const RigidShape& body : scene.bodies) {
    if (points_in_body(body, {&point, 1}).front()) return &body;
  }
  return nullptr;
}

void require_free(const Scene& scene, const Vector3d& point, const std::string& knob) {
  if (const RigidShape* body = body_around(scene, point)) {
    throw_error(
        "{}: ({:.6g}, {:.6g}, {:.6g}) m lies inside the body \"{}\", allowed outside every body",
        knob, point.x(), point.y(), point.z(), body->name);
  }
}

/// Share of the tumour that rigid bodies keep from the camera: that lies inside or behind them.
double hidden_share(const Scene& scene, const Points& tumour) {
  constexpr std::size_t kPoints = 200;  // of its surface
  constexpr int kSteps = 128;           // 2 mm at the distance of an endoscope
  const std::size_t stride = tumour.size() / kPoints + 1;
  Points rays;
  for (std::size_t i = 0; i < tumour.size(); i += stride) {
    for (int k = 0; k < kSteps; ++k)
      rays.emplace_back(tumour[i] + (scene.camera.position - tumour[i]) * k / kSteps);
  }
  std::vector<bool> hidden(rays.size() / kSteps, false);
  for (std::size_t b = 0; b < scene.bodies.size(); ++b) {
    if (static_cast<int>(b) == scene.tumour) continue;
    const std::vector<bool> inside = points_in_body(scene.bodies[b], rays);
    for (std::size_t i = 0; i < rays.size(); ++i) {
      if (inside[i]) hidden[i / kSteps] = true;
    }
  }
  return static_cast<double>(std::count(hidden.begin(), hidden.end(), true)) /
         static_cast<double>(hidden.size());
}

/// Distances along the axis of the camera [m], and whether the picture, as wide as it is high,
/// shows any of the points.
struct InCamera {
  double nearest = 0, farthest = 0;
  bool shown = false;
};
InCamera look_at(const CameraPose& camera, std::span<const Vector3d> points) {
  InCamera seen{1e9, -1e9, false};
  const double half = trig::tan(0.5 * camera.vertical_fov_rad);
  for (const Vector3d& p : points) {
    const Vector3d c = camera.R_WC.transpose() * (p - camera.position);
    seen.nearest = std::min(seen.nearest, -c.z());
    seen.farthest = std::max(seen.farthest, -c.z());
    seen.shown = seen.shown || (-c.z() > 0 && c.head<2>().cwiseAbs().maxCoeff() <= -c.z() * half);
  }
  return seen;
}

void check_camera(const Scene& scene, std::span<const Vector3d> points, const std::string& what,
                  std::vector<std::string>& warnings) {
  if (!scene.config.has_camera()) return;
  const CameraPose& camera = scene.camera;
  const InCamera seen = look_at(camera, points);
  const double angle =
      trig::atan2(camera.R_WC.col(2).cross(camera.position - box_of(points).center()).norm(),
                  camera.R_WC.col(2).dot(camera.position - box_of(points).center()));
  if (!seen.shown) {
    warnings.push_back(fmt::format(
        "scene.camera.axis: the picture shows nothing of the {}, {:.3g} deg off the axis, allowed "
        "up to {:.3g} deg (half of vertical_fov_deg)",
        what, angle / kDegree, 0.5 * camera.vertical_fov_rad / kDegree));
  } else if (seen.nearest > camera.far_m || seen.farthest < camera.near_m) {
    warnings.push_back(fmt::format(
        "scene.camera: the {} is {:.3g} ... {:.3g} m away, allowed {} ... {} m (near_m ... far_m)",
        what, seen.nearest, seen.farthest, camera.near_m, camera.far_m));
  }
}

void check_tumour(const Scene& scene, const AlignedBox3d& tissue,
                  std::vector<std::string>& warnings) {
  const RigidShape& body = scene.bodies[static_cast<std::size_t>(scene.tumour)];
  const Points tumour = in_world(body.X_WS, body.surface.vertices);
  const AlignedBox3d box = box_of(tumour);
  const std::string knob = fmt::format("scene.rigid_body[{}].pose", scene.tumour);
  const double gap = tissue.exteriorDistance(box);
  if (const double length = tissue.diagonal().norm(); !(gap <= length)) {
    throw_error(
        "{}: the tumour is {:.3g} m from the tissue at rest, allowed up to its length of "
        "{:.3g} m",
        knob, gap, length);
  }
  if (look_at(scene.camera, tumour).farthest <= 0)
    throw_error("{}: all of the tumour is behind the camera, allowed in front of it", knob);
  const double hidden = hidden_share(scene, tumour);
  if (hidden >= 1) {
    throw_error(
        "{}: all of the tumour lies inside or behind other bodies, as the camera sees it, "
        "allowed up to 90 %",
        knob);
  }
  if (hidden > 0.9) {
    warnings.push_back(
        fmt::format("{}: {:.0f} % of the tumour lies inside or behind other bodies, "
                    "as the camera sees it, allowed up to 90 %",
                    knob, 100 * hidden));
  }
  const auto warn_unless_it_meets = [&](const AlignedBox3d& other, int axes, const char* where,
                                        const char* what) {
    for (int axis = 0; axis < axes; ++axis) {
      if (box.min()[axis] <= other.max()[axis] && box.max()[axis] >= other.min()[axis]) continue;
      warnings.push_back(fmt::format(
          "{}: the tumour lies {}, {} {:.4g} ... {:.4g} m, allowed where it meets the {}, {:.4g} "
          "... {:.4g} m",
          knob, where, "xyz"[axis], box.min()[axis], box.max()[axis], what, other.min()[axis],
          other.max()[axis]));
    }
  };
  warn_unless_it_meets(tissue, 2, "beside the tissue at rest", "tissue");
  warn_unless_it_meets({scene.workspace_min, scene.workspace_max}, 3, "outside the workspace",
                       "workspace");
  if (box.min().z() > tissue.max().z()) {
    warnings.push_back(
        fmt::format("{}: the tumour lies above the tissue at rest, z from {:.4g} m, "
                    "allowed from below {:.4g} m",
                    knob, box.min().z(), tissue.max().z()));
  }
  check_camera(scene, tumour, "tumour", warnings);
  if (!scene.config.has_tumour_point_m()) return;
  const double to_q = box.exteriorDistance(scene.tumour_point);
  if (const double size = box.diagonal().norm(); to_q > size) {
    warnings.push_back(fmt::format(
        "scene.tumour_point_m: {:.3g} m from the tumour, allowed up to its size of {:.3g} m", to_q,
        size));
  }
}

void check_tissue(const Scene& scene, const Points& tissue, std::vector<std::string>& warnings) {
  const AlignedBox3d box = box_of(tissue);
  const AlignedBox3d workspace(scene.workspace_min, scene.workspace_max);
  const bool has_workspace =
      scene.config.has_workspace_min_m() || scene.config.has_workspace_max_m();
  const double gap = has_workspace ? workspace.exteriorDistance(box) : 0;
  if (const double length = box.diagonal().norm(); !(gap <= length)) {
    throw_error(
        "scene.tissue.pose: the tissue at rest is {:.3g} m from the workspace, allowed up "
        "to its length of {:.3g} m",
        gap, length);
  }
  if (gap > 0) {
    warnings.push_back(fmt::format(
        "scene.tissue.pose: the tissue at rest is {:.3g} m from the workspace, allowed 0 m", gap));
  }
  for (const RigidShape& body : scene.bodies) {
    const std::vector<bool> inside = points_in_body(body, tissue);
    const auto count = static_cast<std::size_t>(std::count(inside.begin(), inside.end(), true));
    const std::string text = fmt::format(
        "scene.tissue.pose: {} of {} particles lie inside the body \"{}\", allowed up to half",
        count, tissue.size(), body.name);
    if (count == tissue.size()) throw_error("{}", text);
    if (2 * count > tissue.size()) warnings.push_back(text);
  }
  check_camera(scene, tissue, "tissue at rest", warnings);
}

// Rigid bodies do not stop the tool: a place of it inside one is odd, a grid that is nowhere else
// is a mistake.
void check_tool_places(const Scene& scene, const Points& places, const std::string& knob,
                       std::vector<std::string>& warnings) {
  std::size_t inside = 0;
  const RigidShape* around = nullptr;
  for (const Vector3d& p : places) {
    const RigidShape* body = body_around(scene, p);
    if (body == nullptr) continue;
    around = body;
    ++inside;
  }
  if (inside == 0) return;
  const std::string text =
      fmt::format("{}: {} of {} places lie inside a body (\"{}\"), allowed outside every body",
                  knob, inside, places.size(), around->name);
  if (inside == places.size() && inside > 1) throw_error("{}", text);
  warnings.push_back(text);
}

}  // namespace

void check_places(const Scene& scene, std::vector<std::string>& warnings) {
  const Points tissue = in_world(scene.tissue.X_WB, scene.tissue.particles);
  check_tissue(scene, tissue, warnings);
  const pb::Scene& config = scene.config;
  if (config.has_camera()) require_free(scene, scene.camera.position, "scene.camera.position_m");
  if (config.has_tool_start_m())
    check_tool_places(scene, {scene.tool_start}, "scene.tool_start_m", warnings);
  if (config.has_target_m()) check_tool_places(scene, {scene.target}, "scene.target_m", warnings);
  check_tool_places(scene, scene.grid_starts, "scene.start_grid", warnings);
  check_tool_places(scene, scene.robot_starts, "scene.robot_grid", warnings);
  if (scene.tumour >= 0 && config.has_camera()) check_tumour(scene, box_of(tissue), warnings);
  if (!scene.config.has_tumour_point_m()) return;
  const RigidShape* around = body_around(scene, scene.tumour_point);
  if (around != nullptr && around->role != pb::ROLE_TUMOUR) {
    warnings.push_back(fmt::format(
        "scene.tumour_point_m: lies inside the body \"{}\", allowed outside or inside the tumour",
        around->name));
  }
}

void check_task_parts(const pb::Scene& config, std::vector<std::string>& warnings) {
  const std::pair<bool, const char*> needed[] = {
      {config.has_tissue(), "tissue: missing, the task is about it"},
      {config.has_camera(), "camera: missing, the exposure is what it sees"},
      {config.has_workspace_min_m() && config.has_workspace_max_m(),
       "workspace_min_m: missing or workspace_max_m is, the tool stays within"},
      {config.has_tool_start_m(), "tool_start_m: missing, episodes begin there (p_0)"},
      {config.has_target_m(), "target_m: missing, the reward needs it (p_T)"},
      {config.has_tumour_point_m(), "tumour_point_m: missing, the reward needs it (q)"}};
  for (const auto& [there, message] : needed) {
    if (!there) throw_error("scene.{}", message);
  }
  if (!config.has_start_grid()) {
    warnings.emplace_back(
        "scene.start_grid: missing: no evaluation on the grid, and every episode of the training "
        "starts at tool_start_m");
  }
  const auto& bodies = config.rigid_body();
  if (std::none_of(bodies.begin(), bodies.end(),
                   [](const pb::RigidBody& body) { return body.role() == pb::ROLE_TUMOUR; })) {
    warnings.emplace_back("scene.rigid_body: 0 tumours (ROLE_TUMOUR), needed 1: exposure is 0");
  }
}

}  // namespace omentum
