#include "sim_worker/tissue/surroundings.h"

#include "core/check.h"
#include "sim_worker/lanes/lane_kernel.h"

namespace omentum {

namespace {

Grip make_grip(const Scene& scene) {
  const pb::Grip& config = scene.config.tool().grip();
  Grip grip;
  grip.pad = config.hold() == pb::HOLD_PAD;
  grip.rectangle = config.shape() == pb::GRIP_RECTANGLE;
  if (grip.pad &&
      (scene.config.tissue().model() == pb::TISSUE_CLUSTER || !scene.config.tissue().has_grid())) {
    throw_error("scene.tool.grip.hold: HOLD_PAD with {}{}, allowed there: HOLD_MEAN",
                pb::TissueModelKind_Name(scene.config.tissue().model()),
                scene.config.tissue().has_grid() ? "" : " and no scene.tissue.grid");
  }
  if (grip.rectangle && !grip.pad)
    throw_error("scene.tool.grip.shape: GRIP_RECTANGLE with HOLD_MEAN, allowed there: GRIP_DISC");
  if (!grip.pad && (config.stiffness_n_per_m3() > 0 || config.turn_compliance_rad_per_n_m() > 0)) {
    throw_error(
        "scene.tool.grip: stiffness {} N/m^3, turn compliance {} rad/(N m), allowed 0 but for "
        "HOLD_PAD",
        config.stiffness_n_per_m3(), config.turn_compliance_rad_per_n_m());
  }
  grip.half = {config.half_x_m(), config.half_y_m()};
  grip.stiffness = config.stiffness_n_per_m3();
  grip.turn_compliance = config.turn_compliance_rad_per_n_m();
  if (!grip.rectangle) return grip;
  const Eigen::Matrix3d R_BC =
      scene.tissue.X_WB.linear().transpose() * scene_tool_mount(scene).R_WC;
  const Eigen::Vector2d x = R_BC.col(0).head<2>();
  const Eigen::Vector2d y = R_BC.col(1).head<2>();
  // One of the two lies well in the sheet; a jaw that looks down on it turns y_C to its left or
  // right.
  const double side = R_BC(2, 2) < 0 ? -1 : 1;
  grip.axis =
      (x.norm() > 0.5 ? x : Eigen::Vector2d(side * Eigen::Vector2d(y.y(), -y.x()))).normalized();
  return grip;
}

}  // namespace

Surroundings make_surroundings(const Scene& scene) {
  if (scene.bodies.size() + 1 > kMaxShapes) {
    throw_error("scene.rigid_body: {} bodies, allowed at most {}", scene.bodies.size(),
                kMaxShapes - 1);
  }
  const pb::Tool& tool = scene.config.tool();
  Surroundings around;
  around.gravity = scene.gravity;
  around.static_friction = scene.config.tissue().static_friction();
  around.dynamic_friction = scene.config.tissue().dynamic_friction();
  around.bodies = scene.bodies;
  around.tool_contact = tool.contact();
  around.tool_radius = tool.shaft_radius_m();
  around.tool_start = tool.shaft_start_m() + tool.shaft_radius_m();
  around.tool_length = tool.shaft_length_m();
  around.shaft_axis = -scene_tool_mount(scene).jaw_direction();
  around.grip = make_grip(scene);
  return around;
}

}  // namespace omentum
