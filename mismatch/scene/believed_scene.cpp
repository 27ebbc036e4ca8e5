#include "mismatch/scene/believed_scene.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "core/check.h"
#include "core/constants.h"
#include "core/table.h"
#include "core/trig.h"
#include "mismatch/scene/belief.h"
#include "mismatch/scene/believed_parts.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

void set(pb::Vec3& to, const Vector3d& v) {
  to.set_x(v.x());
  to.set_y(v.y());
  to.set_z(v.z());
}

void add_prior(pb::Priors& priors, const std::string& path, double factor, double sd,
               const std::string& source) {
  pb::Prior& prior = *priors.add_prior();
  prior.set_path(path);
  if (factor > 1) prior.set_factor(factor);
  if (sd > 0) prior.set_sd(sd);
  prior.set_source(source);
}

/// X_WB of a sheet: origin in a corner of the clamped edge, x away from the clamp, y along it.
Result<Eigen::Isometry3d> sheet_pose(const Belief& belief, double size_x, double size_y,
                                     double thickness, std::vector<std::string>& warnings) {
  const bool stated = belief.has("sheet_origin_x_m") || belief.has("sheet_origin_y_m");
  // Unstated, W has its origin in the middle of the sheet and its axes are those of B.
  const Vector3d x = belief.vector("sheet_axis_x_in_W").value_or(Vector3d(0, 1, 0));
  const Vector3d y = belief.vector("sheet_axis_y_in_W").value_or(Vector3d(-1, 0, 0));
  if (!(x.cross(y).norm() > 0.1 * x.norm() * y.norm())) {
    return Failure{fmt::format("{}: parallel to sheet_axis_x_in_W, or one of them is zero",
                               belief.place("sheet_axis_y_in_W"))};
  }
  Eigen::Matrix3d R_WS;
  R_WS.col(0) = x.normalized();
  R_WS.col(2) = x.cross(y).normalized();
  R_WS.col(1) = R_WS.col(2).cross(R_WS.col(0));
  const double board = belief.number("board_plane_z_m", 0);
  Vector3d origin(belief.number("sheet_origin_x_m", 0), belief.number("sheet_origin_y_m", 0),
                  belief.number("sheet_origin_z_m", board));
  if (!stated) {
    origin -= R_WS * Vector3d(0.5 * size_x, 0.5 * size_y, 0);
    warnings.emplace_back(
        "sheet_origin_x_m, sheet_origin_y_m: not stated: the middle of the sheet is taken to be at "
        "x = y = 0");
  }
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  X_WB.linear().col(0) = -R_WS.col(1);
  X_WB.linear().col(1) = R_WS.col(0);
  X_WB.linear().col(2) = R_WS.col(2);
  X_WB.translation() = origin + R_WS * Vector3d(0.5 * size_x, 0.5 * size_y, 0.5 * thickness);
  return X_WB;
}

void set_camera(const Belief& belief, const Vector3d& looks_at, pb::Scene& scene) {
  pb::Camera& camera = *scene.mutable_camera();
  const Vector3d position =
      belief.vector("camera_position_W_m").value_or(looks_at + Vector3d(0, 0, 0.3));
  const Vector3d toward = looks_at - position;
  Vector3d axis = belief.vector("camera_view_direction_W")
                      .value_or(toward.norm() > 1e-6 ? toward : Vector3d(0, 0, -1));
  if (!(axis.norm() > 0)) axis = Vector3d(0, 0, -1);
  axis.normalize();
  const Vector3d up = std::fabs(axis.z()) < 0.9 ? Vector3d(0, 0, 1) : Vector3d(0, 1, 0);
  set(*camera.mutable_position_m(), position);
  set(*camera.mutable_axis(), axis);
  set(*camera.mutable_up(), up);
  camera.set_near_m(std::max(1e-3, std::min(0.03, 0.1 * toward.norm())));
  camera.set_far_m(std::clamp(3 * toward.norm(), 0.1, 10.0));
}

void set_material(const Belief& belief, BelievedScene& made) {
  pb::Scene& scene = made.scene;
  std::vector<std::string>& warnings = made.warnings;
  pb::Tissue& tissue = *scene.mutable_tissue();
  pb::Material& material = *tissue.mutable_material();
  tissue.set_model(pb::TISSUE_ELASTIC);
  if (belief.has("young_modulus_nominal_Pa"))
    material.set_young_modulus_pa(belief.number("young_modulus_nominal_Pa", 0));
  if (belief.has("poisson_ratio_nominal")) {
    constexpr double kHighest = 0.49;  // of Material.poisson_ratio
    const double nu = belief.number("poisson_ratio_nominal", 0);
    if (nu > kHighest) {
      warnings.push_back(fmt::format("{}: {} is taken as {}, the highest that is simulated",
                                     belief.place("poisson_ratio_nominal"), nu, kHighest));
    }
    material.set_poisson_ratio(std::min(nu, kHighest));
  }
  if (belief.has("density_nominal_kg_per_m3"))
    tissue.set_density_kg_per_m3(belief.number("density_nominal_kg_per_m3", 0));
  const double factor = belief.number("young_modulus_uncertainty_factor", 0);
  if (factor > 1) {
    add_prior(made.priors, "scene.tissue.material.young_modulus_pa", factor, 0,
              "young_modulus_uncertainty_factor");
  }
}

/// Uncertainties of camera and clock; the texts that hold no number are told.
void set_sensor(const Belief& belief, BelievedScene& made) {
  pb::Scene& scene = made.scene;
  std::vector<std::string>& warnings = made.warnings;
  const StatedUncertainty registration =
      uncertainty_in(belief.text("camera_registration_uncertainty"));
  if (registration.metres > 0)
    add_prior(made.priors, "scene.depth_sensor.registration_m", 0, registration.metres,
              "camera_registration_uncertainty");
  if (registration.radians > 0)
    add_prior(made.priors, "scene.depth_sensor.registration_deg", 0, registration.radians / kDegree,
              "camera_registration_uncertainty");
  if (belief.has("camera_registration_uncertainty") && registration.metres == 0)
    warnings.push_back(belief.place("camera_registration_uncertainty") +
                       ": no number with mm or m in it: not used");
  const double noise = uncertainty_in(belief.text("sensor_noise_class")).metres;
  if (noise > 0 && noise <= 0.1) scene.mutable_depth_sensor()->set_noise_m(noise);
  if (belief.has("sensor_noise_class") && !(noise > 0 && noise <= 0.1))
    warnings.push_back(belief.place("sensor_noise_class") +
                       ": no number with mm or m in it: not used");
  if (belief.has("sensor_depth_step_m"))
    scene.mutable_depth_sensor()->set_depth_step_m(belief.number("sensor_depth_step_m", 0));
  if (const double clock = belief.number("clock_offset_uncertainty_s", 0); clock > 0)
    add_prior(made.priors, "scene.depth_sensor.time_offset_s", 0, clock,
              "clock_offset_uncertainty_s");
}

void set_board(const Belief& belief, pb::Scene& scene) {
  if (!belief.has("board_plane_z_m") && !belief.has("board_plane_normal")) return;
  pb::RigidBody& board = *scene.add_rigid_body();
  board.set_name("board");
  board.set_role(pb::ROLE_BOARD);
  board.set_half_space(true);
  board.mutable_pose()->mutable_translation_m()->set_z(belief.number("board_plane_z_m", 0));
  const Vector3d z = belief.vector("board_plane_normal").value_or(Vector3d(0, 0, 1));
  if (!(z.norm() > 0)) return;
  const Vector3d n = z.normalized();
  if ((n - Vector3d::UnitZ()).norm() < 1e-9) return;
  const Vector3d aside = std::fabs(n.x()) < 0.9 ? Vector3d(1, 0, 0) : Vector3d(0, 1, 0);
  const Vector3d x = (aside - aside.dot(n) * n).normalized();
  set(*board.mutable_pose()->mutable_x_axis(), x);
  set(*board.mutable_pose()->mutable_y_axis(), n.cross(x));
}

/// What the simulation has no place for.
void tell_unused(const Belief& belief, SetUp kind, std::vector<std::string>& warnings) {
  for (const std::string key :
       {"material", "clamped_edge", "tip_reference", "cloud_content", "force_sensor"}) {
    if (belief.has(key)) warnings.push_back(belief.place(key) + ": words, kept and not used");
  }
  for (const std::string& key : belief.unknown())
    warnings.push_back(belief.place(key) + ": no such key: not used");
  if (kind == SetUp::kArm || kind == SetUp::kCoupon) return;
  for (const char* key :
       {"young_modulus_nominal_Pa", "density_nominal_kg_per_m3", "sheet_thickness_m"}) {
    if (!belief.has(key))
      warnings.push_back(fmt::format("{}: not stated: that of the schema is taken", key));
  }
}

}  // namespace

void place_sheet(const SheetPlace& place, pb::Scene& scene, std::vector<std::string>& warnings) {
  constexpr double kWanted = 0.003;  // [m] from particle to particle
  constexpr double kTold = 5e-4;     // [m] of an edge
  const double shorter = std::min(place.size_x, place.size_y);
  double best = 1e9, pitch = shorter / 2;
  const int usual = static_cast<int>(std::clamp(std::round(shorter / kWanted), 4.0, 60.0));
  for (int n = std::max(4, usual - usual / 4); n <= usual + usual / 4; ++n) {
    const double p = shorter / n;
    const double longer = std::max(place.size_x, place.size_y);
    const double miss = std::fabs(std::clamp(std::round(longer / p), 1.0, 199.0) * p - longer);
    const double cost = miss + 1e-4 * std::fabs(n - usual);
    if (cost < best) {
      best = cost;
      pitch = p;
    }
  }
  const auto count = [&](double size) {
    return static_cast<std::uint32_t>(std::clamp(std::round(size / pitch), 1.0, 199.0)) + 1;
  };
  pb::Tissue& tissue = *scene.mutable_tissue();
  pb::GridMaker& grid = *tissue.mutable_grid();
  grid.set_pitch_m(pitch);
  grid.set_count_x(count(place.size_x));
  grid.set_count_y(count(place.size_y));
  const double made_y = (grid.count_y() - 1) * pitch;
  for (const auto& [name, size, made] :
       {std::tuple{"x_B", place.size_x, (grid.count_x() - 1) * pitch},
        {"y_B", place.size_y, made_y}}) {
    if (std::fabs(made - size) > kTold) {
      warnings.push_back(fmt::format("the sheet is {:.2f} mm long along {}, its grid {:.2f} mm",
                                     1e3 * size, name, 1e3 * made));
    }
  }
  tissue.set_thickness_m(place.thickness);
  tissue.set_particle_radius_m(0.5 * place.thickness);
  tissue.set_anchor_max_y_m(-0.5 * made_y + place.clamp + 1e-6);
  pb::Pose& pose = *tissue.mutable_pose();
  set(*pose.mutable_translation_m(), place.X_WB.translation());
  set(*pose.mutable_x_axis(), place.X_WB.linear().col(0));
  set(*pose.mutable_y_axis(), place.X_WB.linear().col(1));
  const Vector3d centre = place.X_WB.translation();
  const double half = 0.5 * std::hypot(place.size_x, place.size_y);
  // The arm stands to the sheet as in the scene omentum; the tip starts above its middle.
  set(*scene.mutable_tool()->mutable_base()->mutable_translation_m(),
      centre + Vector3d(0.1599, -0.0536, 0.1244));
  set(*scene.mutable_workspace_min_m(),
      centre - Vector3d(half + 0.02, half + 0.02, 0.5 * place.thickness - 5e-4));
  set(*scene.mutable_workspace_max_m(), centre + Vector3d(half + 0.02, half + 0.02, 0.085));
  set(*scene.mutable_tool_start_m(), centre + Vector3d(0, 0, 0.05));
  set(*scene.mutable_target_m(), centre + Vector3d(-0.02, 0, 0.07));
  // What a policy is sent to: the sheet halfway to its free edge.
  set(*scene.mutable_tumour_point_m(),
      place.X_WB * Vector3d(0, 0.25 * place.size_y, 0.5 * place.thickness));
}

Result<BelievedScene> parse_believed_scene(const std::string& name, std::string_view text) {
  Belief belief(name);
  if (Result<void> read = belief.read(text); !read) return Failure{read.error()};
  BelievedScene made;
  pb::Scene& scene = made.scene;
  const std::string kind = belief.has("kind") ? belief.text("kind") : "sheet";
  constexpr std::array<std::string_view, 4> kKinds = {"sheet", "solid", "arm", "coupon"};
  const auto found = std::find(kKinds.begin(), kKinds.end(), kind);
  if (found == kKinds.end()) {
    return Failure{fmt::format("{}: \"{}\", allowed sheet, solid, arm, coupon",
                               belief.place("kind"), shown(kind))};
  }
  made.kind = static_cast<SetUp>(found - kKinds.begin());
  scene.set_format_version(1);
  scene.set_name(belief.has("name") ? belief.text("name") : "believed");
  scene.set_source("scene_believed.txt");
  if (Result<void> gravity = set_believed_gravity(belief, made); !gravity)
    return Failure{gravity.error()};
  made.rest_cloud_file = belief.text("rest_cloud_file");
  tell_unused(belief, made.kind, made.warnings);
  if (made.kind != SetUp::kArm) set_material(belief, made);
  if (made.kind == SetUp::kCoupon) return made;
  set_sensor(belief, made);
  if (made.kind == SetUp::kArm) {
    set_camera(belief, Vector3d::Zero(), scene);
    return made;
  }
  SheetPlace place;
  place.size_x = belief.number("sheet_size_y_m", 0.09);  // along the clamp: x_B
  place.size_y = belief.number("sheet_size_x_m", 0.09);
  place.thickness = belief.number("sheet_thickness_m", 0.003);
  place.clamp = belief.number("clamp_strip_width_m", 0.003);
  if (!(place.clamp < place.size_y)) {
    return Failure{fmt::format("{}: {} m of a sheet of {} m, allowed less than all of it",
                               belief.place("clamp_strip_width_m"), place.clamp, place.size_y)};
  }
  const Result<Eigen::Isometry3d> pose =
      sheet_pose(belief, place.size_y, place.size_x, place.thickness, made.warnings);
  if (!pose) return Failure{pose.error()};
  place.X_WB = pose.value();
  place_sheet(place, scene, made.warnings);
  pb::Tissue& tissue = *scene.mutable_tissue();
  if (belief.has("board_friction_nominal")) {
    tissue.set_static_friction(belief.number("board_friction_nominal", 0));
    tissue.set_dynamic_friction(belief.number("board_friction_nominal", 0));
  }
  if (made.kind == SetUp::kSolid) {
    pb::VolumeMaker& volume = *tissue.mutable_volume();  // ends the grid
    tissue.mutable_material()->set_law(pb::LAW_STABLE_NEO_HOOKE);
    if (belief.has("mesh_file")) {
      volume.mutable_mesh()->set_path(belief.text("mesh_file"));
    } else {
      set(*volume.mutable_box_m(), Vector3d(place.size_x, place.size_y, place.thickness));
    }
    const double thinnest = std::min({place.size_x, place.size_y, place.thickness});
    volume.set_edge_length_m(std::clamp(0.4 * thinnest, 2e-4, 1.0));
    volume.set_particle_spacing_m(std::clamp(0.25 * thinnest, 2e-4, 0.1));
  } else if (belief.has("mesh_file")) {
    tissue.mutable_sheet()->mutable_mesh()->set_path(belief.text("mesh_file"));
  }
  set_believed_mass(belief, made);
  set_board(belief, scene);
  set_camera(belief, place.X_WB.translation(), scene);
  set_believed_tool(belief, place.X_WB, made);
  for (const auto& [number, p] : belief.pinch_W()) made.pinch_W.push_back(p);
  for (const auto& [number, p] : belief.pinch_sheet()) {
    if (belief.pinch_W().count(number) > 0) continue;
    const Vector3d p_B(0.5 * place.size_x - p.y(), p.x() - 0.5 * place.size_y, p.z());
    made.pinch_W.push_back(place.X_WB * p_B);
  }
  return made;
}

}  // namespace omentum
