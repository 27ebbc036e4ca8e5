#include "mismatch/catalogue/effect_table.h"

#include <numbers>

namespace omentum {
namespace {

constexpr double kRadians = std::numbers::pi / 180;  // per degree
const double kHalfRoot = 1 / std::numbers::sqrt2;
const char* const kEffects = "tissue.effects.";

EffectField row(const char* effect, const char* parameter, const char* unit,
                const std::string& path) {
  return {.effect = effect, .parameter = parameter, .unit = unit, .path = path};
}
EffectField tissue(const char* effect, const char* parameter, const char* unit, const char* path) {
  return row(effect, parameter, unit, std::string(kEffects) + path);
}
EffectField on(EffectField field) {
  field.on = true;
  return field;
}
EffectField place(EffectField field) {
  field.of_place = true;
  return field;
}
EffectField scaled(EffectField field, double scale, double shift = 0) {
  field.scale = scale;
  field.shift = shift;
  return field;
}
EffectField mapped(EffectField field, FieldMap map, const char* base = "") {
  field.map = map;
  field.base = base;
  return field;
}

/// A number per joint of the arm; `unit` of revolute joints, `unit_insertion` of the insertion.
void add_joints(std::vector<EffectField>& table, const char* effect, const std::string& prefix,
                const char* unit, const char* unit_insertion, const std::string& path) {
  for (const char* joint : {"yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"}) {
    const std::string name = joint;
    table.push_back(on({.effect = effect,
                        .parameter = prefix + name,
                        .unit = name == "insertion" ? unit_insertion : unit,
                        .path = path + "." + name}));
  }
}

void add_material(std::vector<EffectField>& t) {
  t.push_back(on(tissue("strain_stiffening", "b", "1", "exponential_stiffening")));
  t.push_back(on(tissue("strain_stiffening", "c2_over_mu", "1", "strain_stiffening")));
  t.push_back(on(tissue("anisotropy", "Ef_over_E", "1", "anisotropy.fibre_ratio")));
  t.push_back(scaled(tissue("anisotropy", "angle", "rad", "anisotropy.angle_deg"), kRadians));
  t.push_back(on(tissue("viscoelastic", "g", "1", "viscoelastic[].share")));
  t.push_back(tissue("viscoelastic", "tau", "s", "viscoelastic[].time_s"));
  t.push_back(on(tissue("structural_damping", "eta", "1", "structural_damping")));
  t.push_back(on(tissue("plastic_set", "Ep_over_E", "1", "plastic_set.modulus_ratio")));
  t.push_back(tissue("plastic_set", "ey", "1", "plastic_set.yield_strain"));
  t.push_back(on(tissue("mullins", "softening", "1", "mullins.softening")));
  t.push_back(tissue("mullins", "strain", "1", "mullins.strain"));
  t.push_back(on(scaled(tissue("inclusion", "k", "1", "inclusion[].stiffness_change"), 1, 1)));
  t.push_back(tissue("inclusion", "r", "m", "inclusion[].radius_m"));
  t.push_back(place(tissue("inclusion", "centre_x", "m", "inclusion[].x_m")));
  t.push_back(place(tissue("inclusion", "centre_y", "m", "inclusion[].y_m")));
  t.push_back(on(scaled(tissue("density", "factor", "1", "density_change"), 1, 1)));
  t.push_back(on(scaled(tissue("gravity_tilt", "tilt_x", "rad", "gravity_tilt_x_deg"), kRadians)));
  t.push_back(on(scaled(tissue("gravity_tilt", "tilt_y", "rad", "gravity_tilt_y_deg"), kRadians)));
  t.push_back(on(mapped(tissue("poisson", "nu", "1", "poisson_change"), FieldMap::kSum,
                        "tissue.material.poisson_ratio")));
  t.push_back(on(scaled(tissue("bending_stiffness", "factor", "1", "bending_change"), 1, 1)));
  t.push_back(on(tissue("rest_shape", "kappa_x", "1/m", "rest_shape.curvature_x_per_m")));
  t.push_back(on(tissue("rest_shape", "kappa_y", "1/m", "rest_shape.curvature_y_per_m")));
  t.push_back(on(tissue("rest_shape", "twist", "1/m", "rest_shape.twist_per_m")));
  t.push_back(on(tissue("rest_shape", "stretch", "1", "rest_shape.stretch")));
  t.push_back(on(tissue("thickness", "a_x", "1/m", "thickness.x_per_m")));
  t.push_back(on(tissue("thickness", "a_y", "1/m", "thickness.y_per_m")));
}

void add_boundary(std::vector<EffectField>& t) {
  t.push_back(on(tissue("adhesion", "k", "N/m3", "adhesion.stiffness_pa_per_m")));
  t.push_back(scaled(tissue("adhesion", "delta_c", "m", "adhesion.break_m"), kHalfRoot));
  t.push_back(place(tissue("adhesion", "centre_x", "m", "adhesion.x_m")));
  t.push_back(place(tissue("adhesion", "centre_y", "m", "adhesion.y_m")));
  t.push_back(place(tissue("adhesion", "half_x", "m", "adhesion.half_x_m")));
  t.push_back(place(tissue("adhesion", "half_y", "m", "adhesion.half_y_m")));
  t.push_back(on(tissue("suction", "c", "N s/m3", "suction.drag_pa_s_per_m")));
  t.push_back(tissue("suction", "reach", "m", "suction.reach_m"));
  t.push_back(on(tissue("obstacle", "radius", "m", "obstacle.radius_m")));
  t.push_back(place(tissue("obstacle", "centre_x", "m", "obstacle.x_m")));
  t.push_back(place(tissue("obstacle", "centre_y", "m", "obstacle.y_m")));
  t.push_back(place(tissue("obstacle", "centre_z", "m", "obstacle.z_m")));
  t.push_back(on(mapped(tissue("board_friction", "mu", "1", "friction_change"), FieldMap::kRatio,
                        "tissue.static_friction")));
  t.push_back(
      on(mapped(tissue("anchor_compliance", "K_per_length", "N/m2", "anchor.compliance_m2_per_n"),
                FieldMap::kReciprocal)));
  t.push_back(tissue("anchor_compliance", "break", "m", "anchor.break_m"));
  t.push_back(on(place(tissue("anchor_detachment", "from", "m", "anchor.free_from_m"))));
  t.push_back(on(place(tissue("anchor_detachment", "to", "m", "anchor.free_to_m"))));
  t.push_back(on(tissue("air_drag", "Cd", "1", "air_drag")));
}

void add_grasp(std::vector<EffectField>& t) {
  t.push_back(on(tissue("grasp_offset", "x", "m", "grasp_offset.x_m")));
  t.push_back(on(tissue("grasp_offset", "y", "m", "grasp_offset.y_m")));
  t.push_back(on(tissue("grasp_offset", "radius", "m", "grasp_offset.radius_m")));
  t.push_back(on(tissue("grasp_slip", "v0", "m/s", "grasp_slip.speed_m_per_s")));
  t.push_back(tissue("grasp_slip", "Fs", "N", "grasp_slip.force_n"));
  t.push_back(tissue("grasp_slip", "total", "m", "grasp_slip.total_m"));
  t.push_back(tissue("grasp_slip", "loss", "m", "grasp_slip.loss_m"));
  t.push_back(on(tissue("grasp_compliance", "C", "m/N", "grasp_compliance_m_per_n")));
  t.push_back(on(tissue("grasp_compliance", "C_turn", "rad/(N m)", "grasp_turn_rad_per_n_m")));
  t.push_back(on(scaled(tissue("jaw_orientation", "roll", "rad", "jaw_roll_deg"), kRadians)));
  t.push_back(on(scaled(tissue("jaw_orientation", "tilt", "rad", "jaw_tilt_deg"), kRadians)));
  t.push_back(on(scaled(tissue("jaw_orientation", "lean", "rad", "jaw_lean_deg"), kRadians)));
}

void add_force(std::vector<EffectField>& t) {
  const char* const name = "unknown_force";
  t.push_back(on(tissue(name, "strength", "1", "local_force.strength")));
  t.push_back(tissue(name, "stiffness", "N/m", "local_force.stiffness_n_per_m"));
  t.push_back(tissue(name, "slack", "m", "local_force.slack_m"));
  t.push_back(tissue(name, "anchor_x", "m", "local_force.anchor_x_m"));
  t.push_back(tissue(name, "anchor_y", "m", "local_force.anchor_y_m"));
  t.push_back(tissue(name, "anchor_z", "m", "local_force.anchor_z_m"));
  t.push_back(tissue(name, "damper", "N s/m", "local_force.damper_n_s_per_m"));
  t.push_back(tissue(name, "push_x", "N", "local_force.push_x_n"));
  t.push_back(tissue(name, "push_y", "N", "local_force.push_y_n"));
  t.push_back(tissue(name, "push_z", "N", "local_force.push_z_n"));
  t.push_back(tissue(name, "decay", "s", "local_force.decay_s"));
  t.push_back(tissue(name, "radius", "m", "local_force.radius_m"));
  t.push_back(place(tissue(name, "centre_x", "m", "local_force.x_m")));
  t.push_back(place(tissue(name, "centre_y", "m", "local_force.y_m")));
}

void add_arm(std::vector<EffectField>& t) {
  t.push_back(on(row("actuation_delay", "tau", "s", "arm.transport_delay_s")));
  add_joints(t, "servo_droop", "tau_", "s", "s", "arm.droop_s");
  t.push_back(on(scaled(row("bandwidth", "tau", "s", "arm.bandwidth_s"), 2)));
  add_joints(t, "joint_friction", "Fc_", "N m", "N", "arm.coulomb_friction");
  add_joints(t, "joint_friction", "Fv_", "N m s/rad", "N s/m", "arm.viscous_friction");
  t.push_back(on(row("load_friction", "mu_c", "1", "arm.load_friction")));
  for (const char* axis : {"x", "y", "z"}) {
    t.push_back(on({.effect = "tool_backlash",
                    .parameter = std::string("b_") + axis,
                    .unit = "m",
                    .path = std::string("arm.tip_backlash.") + axis}));
  }
  add_joints(t, "tool_backlash", "b_", "rad", "m", "arm.backlash");
  for (const char* disc : {"roll", "pitch", "yaw", "jaw"}) {
    t.push_back(on({.effect = "tool_backlash",
                    .parameter = std::string("b_disc_") + disc,
                    .unit = "rad",
                    .path = std::string("arm.disc_backlash.") + disc}));
  }
  for (const char* axis : {"x", "y", "z"}) {
    t.push_back(on({.effect = "tool_compliance",
                    .parameter = std::string("C_") + axis,
                    .unit = "m/N",
                    .path = std::string("arm.tip_compliance.") + axis}));
  }
  t.push_back(on(row("tool_compliance", "depth_slope", "1/m", "arm.compliance_depth_slope")));
  add_joints(t, "cable_compliance", "C_", "rad/(N m)", "m/N", "arm.joint_compliance");
  t.push_back(on(row("servo_compliance", "factor", "1", "arm.servo_compliance")));
  add_joints(t, "kinematic_offset", "", "rad", "m", "arm.joint_offset");
  t.push_back(on(row("kinematic_offset", "tool_length", "m", "arm.tool_length_offset_m")));
  t.push_back(on(row("payload", "m", "kg", "arm.payload_kg")));
}

void add_sensors(std::vector<EffectField>& t) {
  for (const char* axis : {"x", "y", "z"}) {
    t.push_back(on({.effect = "registration",
                    .parameter = axis,
                    .unit = "m",
                    .path = std::string("depth_sensor.registration_m.") + axis}));
  }
  for (const char* axis : {"x", "y", "z"}) {
    t.push_back(on({.effect = "registration",
                    .parameter = std::string("turn_") + axis,
                    .unit = "rad",
                    .path = std::string("depth_sensor.registration_deg.") + axis,
                    .scale = kRadians}));
  }
  t.push_back(on(row("camera_time_offset", "dt", "s", "depth_sensor.time_offset_s")));
  t.push_back(on(row("camera_bias", "offset", "m", "depth_sensor.bias_m")));
  t.push_back(on(row("camera_bias", "scale", "1", "depth_sensor.scale_change")));
  t.push_back(on(row("camera_bias", "quadratic", "1/m", "depth_sensor.bias_per_m")));
  t.push_back(row("camera_bias", "z0", "m", "depth_sensor.bias_range_m"));
  for (const char* stream : {"joints", "force", "markers"}) {
    t.push_back(on({.effect = "clock_offset",
                    .parameter = stream,
                    .unit = "s",
                    .path = std::string("clocks.") + stream + "_s"}));
  }
}

}  // namespace

const std::vector<EffectField>& effect_table() {
  static const std::vector<EffectField> table = [] {
    std::vector<EffectField> made;
    add_material(made);
    add_boundary(made);
    add_grasp(made);
    add_force(made);
    add_arm(made);
    add_sensors(made);
    return made;
  }();
  return table;
}

}  // namespace omentum
