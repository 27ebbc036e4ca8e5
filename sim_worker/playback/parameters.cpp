#include "sim_worker/playback/parameters.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <google/protobuf/message.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <optional>
#include <span>
#include <sstream>

#include "core/check.h"
#include "sim_worker/scene/scene_parts.h"

namespace omentum {
namespace {

namespace protobuf = google::protobuf;
using Eigen::Vector3d;
using Kind = Parameter::Kind;

constexpr double kDegrees = 180 / std::numbers::pi;  // per radian

struct Setting {
  const char* key;
  double value;  ///< where none is given
  bool stated = false;
};

/// A row of the table of names. `change` is what a scene is given, assignments separated by ';':
/// $v is the changed value of the first field and $key a setting. Of a message in braces that the
/// scene has switched on only what was stated is changed; a repeated one is added.
struct Row {
  const char* name;
  const char* unit;
  Kind kind;
  const char* change;
  double step;        ///< in `unit`
  double factor = 1;  ///< units of the field per `unit`
  std::vector<Setting> settings = {};
};

const std::vector<Row>& rows() {
  static const std::vector<Row> table = {
      {"young_modulus", "Pa", Kind::kScene, "tissue.material.young_modulus_pa=$v", 0.1},
      {"poisson.nu", "1", Kind::kScene, "tissue.material.poisson_ratio=$v", 1e-6},
      {"damping", "1/s", Kind::kScene, "tissue.material.damping_per_s=$v", 1e-4},
      {"density.factor", "1", Kind::kScene, "tissue.effects.density_change=$v", 1e-6},
      {"gravity_tilt.tilt_x", "rad", Kind::kScene, "tissue.effects.gravity_tilt_x_deg=$v", 1e-6,
       kDegrees},
      {"gravity_tilt.tilt_y", "rad", Kind::kScene, "tissue.effects.gravity_tilt_y_deg=$v", 1e-6,
       kDegrees},
      {"bending_stiffness.factor", "1", Kind::kScene, "tissue.effects.bending_change=$v", 1e-6},
      {"thickness", "m", Kind::kScene, "tissue.thickness_m=$v", 1e-8},
      {"thickness.a_x", "1/m", Kind::kScene, "tissue.effects.thickness.x_per_m=$v", 1e-5},
      {"thickness.a_y", "1/m", Kind::kScene, "tissue.effects.thickness.y_per_m=$v", 1e-5},
      {"rest_shape.kappa_x", "1/m", Kind::kScene, "tissue.effects.rest_shape.curvature_x_per_m=$v",
       1e-5},
      {"rest_shape.kappa_y", "1/m", Kind::kScene, "tissue.effects.rest_shape.curvature_y_per_m=$v",
       1e-5},
      {"rest_shape.twist", "1/m", Kind::kScene, "tissue.effects.rest_shape.twist_per_m=$v", 1e-5},
      {"rest_shape.stretch", "1", Kind::kScene, "tissue.effects.rest_shape.stretch=$v", 1e-7},
      {"strain_stiffening.c2_over_mu", "1", Kind::kScene, "tissue.effects.strain_stiffening=$v",
       1e-5},
      {"strain_stiffening.b", "1", Kind::kScene, "tissue.effects.exponential_stiffening=$v", 1e-5},
      {"anisotropy.Ef_over_E",
       "1",
       Kind::kScene,
       "tissue.effects.anisotropy={ fibre_ratio: $v angle_deg: $angle_deg }",
       1e-6,
       1,
       {{"angle_deg", 0}}},
      {"viscoelastic.g",
       "1",
       Kind::kScene,
       "tissue.effects.viscoelastic={ share: $v time_s: $tau }",
       1e-6,
       1,
       {{"tau", 1}}},
      {"structural_damping.eta", "1", Kind::kScene, "tissue.effects.structural_damping=$v", 1e-6},
      {"plastic_set.Ep_over_E",
       "1",
       Kind::kScene,
       "tissue.effects.plastic_set={ modulus_ratio: $v yield_strain: $ey }",
       1e-6,
       1,
       {{"ey", 0.05}}},
      {"mullins.softening",
       "1",
       Kind::kScene,
       "tissue.effects.mullins={ softening: $v strain: $strain }",
       1e-6,
       1,
       {{"strain", 0.05}}},
      {"adhesion.k",
       "N/m3",
       Kind::kScene,
       "tissue.effects.adhesion={ stiffness_pa_per_m: $v break_m: $break_m x_m: $x y_m: $y "
       "half_x_m: $half_x half_y_m: $half_y }",
       1,
       1,
       {{"break_m", 0.002}, {"x", 0}, {"y", 0}, {"half_x", 0}, {"half_y", 0}}},
      {"suction.c",
       "N s/m3",
       Kind::kScene,
       "tissue.effects.suction={ drag_pa_s_per_m: $v reach_m: $reach_m }",
       0.1,
       1,
       {{"reach_m", 0.001}}},
      {"board_friction.factor", "1", Kind::kScene, "tissue.effects.friction_change=$v", 1e-6},
      {"grasp_offset.x", "m", Kind::kScene, "tissue.effects.grasp_offset.x_m=$v", 1e-7},
      {"grasp_offset.y", "m", Kind::kScene, "tissue.effects.grasp_offset.y_m=$v", 1e-7},
      {"grasp_offset.radius", "m", Kind::kScene, "tissue.effects.grasp_offset.radius_m=$v", 1e-7},
      {"grasp_slip.v0",
       "m/s",
       Kind::kScene,
       "tissue.effects.grasp_slip={ speed_m_per_s: $v force_n: $Fs total_m: $total }",
       1e-8,
       1,
       {{"Fs", 0.1}, {"total", 0}}},
      {"grasp_compliance.C", "m/N", Kind::kScene, "tissue.effects.grasp_compliance_m_per_n=$v",
       1e-8},
      {"grasp_compliance.C_turn", "rad/(N m)", Kind::kScene,
       "tissue.effects.grasp_turn_rad_per_n_m=$v", 1e-3},
      {"added_mass.m",
       "kg",
       Kind::kScene,
       "tissue.effects.added_mass={ mass_kg: $v x_m: $x y_m: $y radius_m: $r }",
       1e-9,
       1,
       {{"x", 0}, {"y", 0}, {"r", 0.005}}},
      {"unknown_force.strength", "1", Kind::kScene, "tissue.effects.local_force.strength=$v", 1e-6},
      {"unknown_force.stiffness", "N/m", Kind::kScene,
       "tissue.effects.local_force={ stiffness_n_per_m: $v }", 1e-6},
      {"unknown_force.damper", "N s/m", Kind::kScene,
       "tissue.effects.local_force={ damper_n_s_per_m: $v }", 1e-6},
      {"jaw_orientation.roll", "rad", Kind::kScene, "tissue.effects.jaw_roll_deg=$v", 1e-6,
       kDegrees},
      {"jaw_orientation.tilt", "rad", Kind::kScene, "tissue.effects.jaw_tilt_deg=$v", 1e-6,
       kDegrees},
      {"jaw_orientation.lean", "rad", Kind::kScene, "tissue.effects.jaw_lean_deg=$v", 1e-6,
       kDegrees},
      {"air_drag.Cd", "1", Kind::kScene, "tissue.effects.air_drag=$v", 1e-5},
      {"law.corotated", "1", Kind::kScene, "tissue.material.law=LAW_COROTATED", 1},
      {"law.neo_hooke", "1", Kind::kScene, "tissue.material.law=LAW_NEO_HOOKE", 1},
      {"law.st_venant_kirchhoff", "1", Kind::kScene, "tissue.material.law=LAW_ST_VENANT_KIRCHHOFF",
       1},
      {"contact_stiffness", "Pa/m", Kind::kScene, "tissue.reference.contact_stiffness_pa_per_m=$v",
       200},
      {"slip_speed", "m/s", Kind::kScene, "tissue.reference.friction_slip_speed_m_per_s=$v", 1e-11},
      {"actuation_delay.tau", "s", Kind::kArm, "arm.transport_delay_s=$v", 1e-5},
      {"servo_droop.tau", "s", Kind::kArm,
       "arm.droop_s={ yaw: $v pitch: $v insertion: $v roll: $v wrist_pitch: $v wrist_yaw: $v }",
       1e-5},
      {"bandwidth.tau", "s", Kind::kArm, "arm.bandwidth_s=$v", 1e-5, 0.5},
      {"tool_compliance.C_x", "m/N", Kind::kArm, "arm.tip_compliance.x=$v", 1e-8},
      {"tool_compliance.C_y", "m/N", Kind::kArm, "arm.tip_compliance.y=$v", 1e-8},
      {"tool_compliance.C_z", "m/N", Kind::kArm, "arm.tip_compliance.z=$v", 1e-8},
      {"tool_backlash.b_x", "m", Kind::kArm, "arm.tip_backlash.x=$v", 1e-8},
      {"tool_backlash.b_y", "m", Kind::kArm, "arm.tip_backlash.y=$v", 1e-8},
      {"tool_backlash.b_z", "m", Kind::kArm, "arm.tip_backlash.z=$v", 1e-8},
      {"tool_backlash.b_yaw", "rad", Kind::kArm, "arm.backlash.yaw=$v", 1e-7},
      {"tool_backlash.b_pitch", "rad", Kind::kArm, "arm.backlash.pitch=$v", 1e-7},
      {"tool_backlash.b_insertion", "m", Kind::kArm, "arm.backlash.insertion=$v", 1e-8},
      {"tool_offset.x", "m", Kind::kToolOffset, "", 1},
      {"tool_offset.y", "m", Kind::kToolOffset, "", 1},
      {"tool_offset.z", "m", Kind::kToolOffset, "", 1},
      {"inclusion.k", "1", Kind::kSite, "", 1, 1, {{"x", 0}, {"y", 0}, {"r", 0.01}}},
      {"density_site", "1", Kind::kSite, "", 1, 1, {{"x", 0}, {"y", 0}, {"r", 0.01}}},
      {"obstacle.radius", "m", Kind::kScene, "tissue.effects.obstacle.radius_m=$v", 1e-9},
      {"obstacle.centre_x", "m", Kind::kScene, "tissue.effects.obstacle.x_m=$v", 1e-9},
      {"obstacle.centre_y", "m", Kind::kScene, "tissue.effects.obstacle.y_m=$v", 1e-9},
      {"obstacle.centre_z", "m", Kind::kScene, "tissue.effects.obstacle.z_m=$v", 1e-9},
      {"obstacle.stiffness",
       "Pa/m",
       Kind::kSite,
       "",
       1,
       1,
       {{"x", 0}, {"y", 0}, {"z", 0.02}, {"r", 0.008}}},
      {"held_start.x", "m", Kind::kHeldPlace, "", 1},
      {"held_start.y", "m", Kind::kHeldPlace, "", 1},
      {"held_start.z", "m", Kind::kHeldPlace, "", 1},
      {"start_velocity.x", "m/s", Kind::kSite, "", 1},
      {"start_velocity.y", "m/s", Kind::kSite, "", 1},
      {"start_velocity.z", "m/s", Kind::kSite, "", 1},
      {"force_site.x", "N", Kind::kSite, "", 1, 1, {{"x", 0}, {"y", 0}, {"r", 0.01}}},
      {"force_site.y", "N", Kind::kSite, "", 1, 1, {{"x", 0}, {"y", 0}, {"r", 0.01}}},
      {"force_site.z", "N", Kind::kSite, "", 1, 1, {{"x", 0}, {"y", 0}, {"r", 0.01}}},
      {"anchor_compliance.inverse_K", "m2/N", Kind::kSite, "", 1},
      {"anchor_detachment.length", "m", Kind::kSite, "", 1, 1, {{"x", 0}}},
      {"registration.x", "m", Kind::kSensor, "", 1},
      {"registration.y", "m", Kind::kSensor, "", 1},
      {"registration.z", "m", Kind::kSensor, "", 1},
      {"registration.turn_x", "rad", Kind::kSensor, "", 1},
      {"registration.turn_y", "rad", Kind::kSensor, "", 1},
      {"registration.turn_z", "rad", Kind::kSensor, "", 1},
      {"camera_time_offset.dt", "s", Kind::kSensor, "", 1},
      {"camera_bias.offset", "m", Kind::kSensor, "", 1},
      {"camera_bias.scale", "1", Kind::kSensor, "", 1},
      {"camera_bias.quadratic", "1/m", Kind::kSensor, "", 1},
  };
  return table;
}

/// What a scene or a verdict can name and no column has.
struct Without {
  const char* name;
  const char* reason;
};
constexpr Without kWithout[] = {
    {"numerics.mesh", "a difference of two runs: give --tolerance-mm"},
};

Vector3d ray(const SeenPoint& p) { return (p.p_W - p.p_WC).normalized(); }

/// Change of a point of the surface, as the camera gives it, per unit.
using Sensor = Vector3d (*)(const SeenPoint&);
Sensor sensor_of(const std::string& name) {
  if (name == "registration.x") return [](const SeenPoint&) { return Vector3d(1, 0, 0); };
  if (name == "registration.y") return [](const SeenPoint&) { return Vector3d(0, 1, 0); };
  if (name == "registration.z") return [](const SeenPoint&) { return Vector3d(0, 0, 1); };
  if (name == "registration.turn_x")
    return [](const SeenPoint& p) { return Vector3d(Vector3d::UnitX().cross(p.p_W)); };
  if (name == "registration.turn_y")
    return [](const SeenPoint& p) { return Vector3d(Vector3d::UnitY().cross(p.p_W)); };
  if (name == "registration.turn_z")
    return [](const SeenPoint& p) { return Vector3d(Vector3d::UnitZ().cross(p.p_W)); };
  if (name == "camera_time_offset.dt") return [](const SeenPoint& p) { return Vector3d(-p.v_W); };
  if (name == "camera_bias.offset") return [](const SeenPoint& p) { return ray(p); };
  if (name == "camera_bias.scale")
    return [](const SeenPoint& p) { return Vector3d(p.p_W - p.p_WC); };
  OMENTUM_CHECK(name == "camera_bias.quadratic", "sensor {}", name);
  return [](const SeenPoint& p) { return Vector3d((p.p_W - p.p_WC).norm() * (p.p_W - p.p_WC)); };
}

/// Number of a field of the scene, by its path.
double field_value(const pb::Scene& scene, const std::string& path) {
  const protobuf::Message* message = &scene;
  std::string_view rest = path;
  while (true) {
    const std::size_t dot = rest.find('.');
    const auto* field = message->GetDescriptor()->FindFieldByName(std::string(rest.substr(0, dot)));
    OMENTUM_CHECK(field != nullptr, "no field {} in a scene", path);
    if (dot == std::string_view::npos) return message->GetReflection()->GetDouble(*message, field);
    message = &message->GetReflection()->GetMessage(*message, field);
    rest.remove_prefix(dot + 1);
  }
}

/// Whether a scene has a message, not one of several, with a number that is not 0.
bool is_on(const pb::Scene& scene, const std::string& path, const std::string& number) {
  const protobuf::Message* message = &scene;
  std::string_view rest = path;
  while (!rest.empty()) {
    const std::size_t dot = rest.find('.');
    const auto* field = message->GetDescriptor()->FindFieldByName(std::string(rest.substr(0, dot)));
    OMENTUM_CHECK(field != nullptr, "no field {} in a scene", path);
    if (field->is_repeated()) return false;
    message = &message->GetReflection()->GetMessage(*message, field);
    rest.remove_prefix(dot == std::string_view::npos ? rest.size() : dot + 1);
  }
  return message->GetReflection()->GetDouble(
             *message, message->GetDescriptor()->FindFieldByName(number)) != 0;
}

void replace_all(std::string& text, const std::string& what, const std::string& by) {
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at))
    text.replace(at, what.size(), by);
}

std::vector<std::string> overrides_of(const Row& row, const std::vector<Setting>& settings,
                                      const pb::Scene& scene) {
  std::string change = row.change;
  const std::string path = change.substr(0, change.find('='));
  const std::size_t number = change.find("={ ");
  if (number != std::string::npos) {
    const std::string name = change.substr(number + 3, change.find(':') - number - 3);
    if (is_on(scene, path, name)) {
      std::vector<std::string> all = {
          fmt::format("scene.{}.{}={:.17g}", path, name,
                      row.factor * row.step + field_value(scene, path + "." + name))};
      for (const Setting& setting : settings) {
        const std::size_t at = change.find(std::string(": $") + setting.key);
        const std::size_t begin = change.rfind(' ', at - 1) + 1;
        if (setting.stated)
          all.push_back(fmt::format("scene.{}.{}={:.17g}", path, change.substr(begin, at - begin),
                                    setting.value));
      }
      return all;
    }
  }
  const bool field = change.find("=$v") != std::string::npos;
  const double value = row.factor * row.step + (field ? field_value(scene, path) : 0);
  replace_all(change, "$v", fmt::format("{:.17g}", value));
  for (const Setting& setting : settings)
    replace_all(change, std::string("$") + setting.key, fmt::format("{:.17g}", setting.value));
  return {"scene." + change};
}

/// A sheet that may lie on something thickens upwards: so much higher its middle is.
void add_rise(const pb::Scene& scene, double thicker, std::vector<std::string>& overrides) {
  if (scene.rigid_body_size() == 0) return;
  const Eigen::Isometry3d X_WB = to_pose(scene.tissue().pose(), "scene.tissue.pose");
  const Vector3d p_WB = X_WB.translation() + 0.5 * thicker * X_WB.linear().col(2);
  for (int axis = 0; axis < 3; ++axis) {
    overrides.push_back(
        fmt::format("scene.tissue.pose.translation_m.{}={:.17g}", "xyz"[axis], p_WB[axis]));
  }
}

/// Parts between separators; at least one.
std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::istringstream stream(text);
  for (std::string part; std::getline(stream, part, separator);) parts.push_back(part);
  if (parts.empty()) parts.emplace_back();
  return parts;
}

/// A number of an inclusion that the scene has: "inclusion[0].x". Nothing where the name is none.
std::optional<Parameter> parse_inclusion(const std::string& name, const pb::Scene& scene) {
  struct Number {
    const char* name;
    const char* field;
    const char* unit;
    double step;
    double (pb::Inclusion::*value)() const;
  };
  static const Number numbers[] = {
      {"k", "stiffness_change", "1", 1e-6, &pb::Inclusion::stiffness_change},
      {"r", "radius_m", "m", 1e-8, &pb::Inclusion::radius_m},
      {"x", "x_m", "m", 1e-8, &pb::Inclusion::x_m},
      {"y", "y_m", "m", 1e-8, &pb::Inclusion::y_m}};
  const auto& all = scene.tissue().effects().inclusion();
  for (int index = 0; index < all.size(); ++index) {
    for (const Number& number : numbers) {
      if (name != fmt::format("inclusion[{}].{}", index, number.name)) continue;
      Parameter p;
      p.name = name;
      p.unit = number.unit;
      p.step = number.step;
      p.effect = fmt::format("inclusion[{}].{}", index, number.field);
      p.value = (all[index].*number.value)() + number.step;
      return p;
    }
  }
  return std::nullopt;
}

/// Numbers of a sphere that a scene may not have: where nothing touches it yet nothing changes.
bool is_of_obstacle(const Row& row) {
  return row.kind == Kind::kScene && std::string_view(row.name).starts_with("obstacle.");
}

bool has_obstacle(const pb::Scene& scene) {
  return scene.tissue().effects().obstacle().radius_m() > 0;
}

/// "name@key=value:key=value"
Parameter parse_one(const std::string& text, const pb::Scene& scene) {
  if (std::optional<Parameter> p = parse_inclusion(text, scene)) return *std::move(p);
  const std::string name = split(text, '@')[0];
  for (const Without& w : kWithout) {
    if (name.starts_with(w.name)) throw_error("--columns: {} has no column: {}", name, w.reason);
  }
  const auto row = std::ranges::find(rows(), name, &Row::name);
  if (row == rows().end()) throw_error("--columns: {}: no parameter of that name", name);
  if (is_of_obstacle(*row) && !has_obstacle(scene)) {
    throw_error(
        "--columns: {} has no column: the scene has no obstacle; obstacle.stiffness@x=...:y=...:"
        "z=...:r=... is that of one that begins to press",
        name);
  }
  std::vector<Setting> settings = row->settings;
  const std::vector<std::string> parts = split(text, '@');
  for (const std::string& pair : split(parts.size() > 1 ? parts[1] : "", ':')) {
    if (parts.size() == 1) break;
    const std::vector<std::string> sides = split(pair, '=');
    const auto setting = std::ranges::find(settings, sides[0], &Setting::key);
    const std::string number = sides.size() == 2 ? sides[1] : "";
    char* end = nullptr;
    const double value = std::strtod(number.c_str(), &end);
    if (setting == settings.end() || number.empty() || *end != '\0' || !std::isfinite(value)) {
      std::vector<std::string> keys;
      for (const Setting& s : settings) keys.emplace_back(s.key);
      throw_error("--columns: {}: \"{}\", allowed key=value with a number and a key of: {}", name,
                  pair, fmt::join(keys, ", "));
    }
    setting->value = value;
    setting->stated = true;
  }
  Parameter p;
  p.name = text;
  p.unit = row->unit;
  p.kind = row->kind;
  p.step = row->step;
  switch (p.kind) {
    case Kind::kScene:
    case Kind::kArm:
      p.overrides = overrides_of(*row, settings, scene);
      if (name == "thickness") add_rise(scene, row->step, p.overrides);
      break;
    case Kind::kToolOffset:
    case Kind::kHeldPlace:
      p.axis = name.back() - 'x';
      break;
    case Kind::kSite:
      if (name.starts_with("anchor_")) {
        const bool piece = name == "anchor_detachment.length";
        p.site.kind = piece ? ColumnKind::kClampFree : ColumnKind::kClampGive;
        if (piece) p.site.place.x() = settings[0].value;
        break;
      }
      if (name.starts_with("start_velocity.")) {
        p.site.kind = ColumnKind::kStartVelocity;
        p.site.axis = name.back() - 'x';
        break;
      }
      if (name == "obstacle.stiffness") {
        p.site.kind = ColumnKind::kObstacle;
        p.site.centre = {settings[0].value, settings[1].value, settings[2].value};
        p.site.radius = settings[3].value;
        if (!(p.site.radius > 0)) throw_error("--columns: {}: r must be above 0", text);
        break;
      }
      p.site.kind = name == "inclusion.k"    ? ColumnKind::kStiffnessSite
                    : name == "density_site" ? ColumnKind::kDensitySite
                                             : ColumnKind::kForceSite;
      p.site.axis = p.site.kind == ColumnKind::kForceSite ? name.back() - 'x' : 0;
      p.site.place = {settings[0].value, settings[1].value};
      p.site.radius = settings[2].value;
      if (!(p.site.radius > 0)) throw_error("--columns: {}: r must be above 0", text);
      break;
    case Kind::kSensor:
      p.sensor = sensor_of(name);
      break;
  }
  return p;
}

bool is_own_law(const Row& row, const pb::Scene& scene) {
  return std::string(row.change) ==
         "tissue.material.law=" + pb::ElasticLaw_Name(scene.tissue().material().law());
}

std::vector<std::string> site_names(const pb::Scene& scene) {
  const pb::GridMaker& grid = scene.tissue().grid();
  const double half_x = 0.5 * (grid.count_x() - 1) * grid.pitch_m();
  const double half_y = 0.5 * (grid.count_y() - 1) * grid.pitch_m();
  const double low = std::max(-half_y, scene.tissue().anchor_max_y_m());
  constexpr int kPlaces = 7;
  std::vector<std::string> names;
  for (const char* kind : {"inclusion.k", "density_site", "force_site.z"}) {
    for (int k = 0; k < kPlaces * kPlaces; ++k) {
      const double x = half_x * (2 * (k % kPlaces + 0.5) / kPlaces - 1);
      const double y = low + (half_y - low) * (k / kPlaces + 0.5) / kPlaces;
      names.push_back(fmt::format("{}@x={:.6g}:y={:.6g}:r={:.6g}", kind, x, y, half_x / kPlaces));
    }
  }
  return names;
}

}  // namespace

std::vector<Parameter> parse_parameters(const std::string& list, const pb::Scene& scene) {
  std::vector<Parameter> parameters;
  const auto add = [&](const std::string& text) {
    if (std::ranges::any_of(parameters, [&](const Parameter& p) { return p.name == text; }))
      throw_error("--columns: {} is named twice", text);
    parameters.push_back(parse_one(text, scene));
  };
  for (const std::string& text : split(list, ',')) {
    if (text == "all") {
      for (const Row& row : rows()) {
        if (is_own_law(row, scene) || (is_of_obstacle(row) && !has_obstacle(scene))) continue;
        // Of a sphere somewhere, which may cut the resting tissue.
        if (std::string_view(row.name) == "obstacle.stiffness") continue;
        add(row.name);
        parameters.back().from_all = true;
      }
    } else if (text == "sites") {
      for (const std::string& name : site_names(scene)) add(name);
    } else {
      add(text);
    }
  }
  return parameters;
}

std::string describe_parameters() {
  std::string text;
  for (const Row& row : rows()) {
    text += fmt::format("{} [{}]", row.name, row.unit);
    for (std::size_t k = 0; k < row.settings.size(); ++k)
      text +=
          fmt::format("{}{}={}", k == 0 ? "@" : ":", row.settings[k].key, row.settings[k].value);
    text += '\n';
  }
  text += "inclusion[i].k [1], .r, .x, .y [m] of inclusions that the scene has\n";
  for (const Without& w : kWithout) text += fmt::format("{}: no column, {}\n", w.name, w.reason);
  return text;
}

}  // namespace omentum
