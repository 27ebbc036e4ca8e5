#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/psm.h"
#include "core/task.h"
#include "proto/scene.pb.h"
#include "sim_worker/geometry/rigid_shape.h"
#include "sim_worker/geometry/sheet_mesh.h"
#include "sim_worker/geometry/solid_mesh.h"

namespace omentum {

/// The deformable body before cooking: rest particles in B, which of them are fixed, and the
/// surface to draw.
struct TissueBody {
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  std::vector<Eigen::Vector3d> particles;  ///< p_B at rest [m]
  std::vector<std::uint8_t> fixed;         ///< 1 = anchored
  bool two_clamps = false;                 ///< some of them by anchor_min_y_m
  double particle_mass = 0;                ///< [kg]
  double particle_radius = 0;              ///< collision distance [m]
  double thickness = 0;                    ///< of a single layer [m]
  ThicknessMap thickness_map;
  /// Triangles of the surface. With `surface_is_particles` the vertex indices are particle indices
  /// (a grid sheet); otherwise `surface_vertices` (in B at rest) are skinned to clusters
  /// (sim_worker/tissue/tissue.h).
  bool surface_is_particles = true;
  std::vector<Eigen::Vector3d> surface_vertices;
  std::vector<Eigen::Vector3i> surface_triangles;
};

/// A deformable body beside the sheet, filled with tetrahedra: `body.particles` are the nodes of
/// `mesh`, `body.surface_triangles` its skin.
struct SoftBody {
  std::string name;
  pb::BodyRole role = pb::ROLE_ORGAN;
  TissueBody body;
  SolidMesh mesh;
};

/// A camera of the scene: pinhole at `position`, looking along -z of R_WC (x right, y up).
struct CameraPose {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< p_WC [m]
  Eigen::Matrix3d R_WC = Eigen::Matrix3d::Identity();
  double vertical_fov_rad = 1;
  double near_m = 0.03, far_m = 0.4;
};

/// The scene, resolved to plain numbers. Immutable after load and shared by all environments of a
/// process.
struct Scene {
  pb::Scene config;                                   ///< what it was made from
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();  ///< in W [m/s^2]
  TissueBody tissue;
  SolidMesh solid;      ///< of an elastic volume: its nodes are the particles; else empty
  SheetGeometry sheet;  ///< of scene.tissue.sheet: its nodes are the particles; else empty
  std::vector<RigidShape> bodies;
  /// Its nodes follow the particles of `tissue` wherever positions of a state are listed.
  std::optional<SoftBody> soft_body;
  int tumour = -1;              ///< index into bodies
  CameraPose camera;            ///< the endoscope
  double exposure_fov_rad = 0;  ///< zoom view of the exposure image
  int exposure_pixels = 0;
  Eigen::Vector3d workspace_min, workspace_max;
  Eigen::Vector3d tool_start, target, tumour_point;  ///< p_0, p_T, q in W [m]
  std::vector<TumourPlace> tumour_places;            ///< of which an episode has its q
  std::vector<Eigen::Vector3d> grid_starts, robot_starts;
  std::vector<std::string> warnings;  ///< units guard and cooker warnings, one line each

  bool is_clamped() const;
  /// Nothing holds the tissue, nothing lies under it, and there is gravity.
  bool falls() const;
  /// Points of a state: particles of the tissue, then nodes of the soft body.
  std::size_t points() const {
    return tissue.particles.size() + (soft_body ? soft_body->body.particles.size() : 0);
  }
};

/// Resolves a scene; what a task alone needs (camera, workspace, starts, target) may be missing,
/// and so may the tissue of a scene of an arm. Relative mesh paths start at `directory`. Throws
/// Error (one line) for anything that cannot be simulated: open mesh, lengths or gravity that do
/// not fit metres, unreachable starts, no particles, a tumour that no motion of the tissue can
/// show.
Scene make_scene(const pb::Scene& config, const std::string& directory);

/// What a task needs of a scene beyond what a simulation does: throws Error without camera,
/// workspace, p_0, p_T or q, warns without a tumour or start grid.
void check_task_parts(const pb::Scene& config, std::vector<std::string>& warnings);

/// A message about a scene made of this file, with its place there: line and column of the knob it
/// begins with, else the file. As it is without a file, or where it begins with no knob of a scene.
std::string with_place(const std::string& file, const std::string& message);

/// Arm base, tool orientation and workspace of the scene, for limit_command().
ToolMount scene_tool_mount(const Scene& scene);

}  // namespace omentum
