#include "mismatch/scene/believed_parts.h"

#include <fmt/format.h>

#include <cmath>
#include <optional>

#include "core/constants.h"
#include "core/trig.h"

namespace omentum {

using Eigen::Vector3d;

namespace {

void set(pb::Vec3& to, const Vector3d& v) {
  to.set_x(v.x());
  to.set_y(v.y());
  to.set_z(v.z());
}

/// Direction of the shaft towards the tip: the instrument comes from above, so that a belief may
/// state it either way.
std::optional<Vector3d> shaft_down(const Belief& belief) {
  const auto stated = belief.vector("shaft_direction_W");
  if (!stated || !(stated->norm() > 1e-3)) return std::nullopt;
  return stated->z() > 0 ? Vector3d(-stated->normalized()) : Vector3d(stated->normalized());
}

/// Roll of a tool [deg] whose pad lies on the sheet with x_C along `x_S`: x_C of a tool that is not
/// rolled is y_W, and the least turn from -z_W to `shaft` comes after the roll.
double roll_along(const Vector3d& x_S, const Vector3d& normal, const Vector3d& shaft) {
  const double steep = normal.dot(shaft);
  // Across the shaft, and x_S where one looks along the normal of the sheet.
  const Vector3d across =
      std::fabs(steep) > 0.1 ? Vector3d(x_S - x_S.dot(shaft) / steep * normal) : x_S;
  const Vector3d x_C =
      Eigen::Quaterniond::FromTwoVectors(-Vector3d::UnitZ(), shaft).conjugate() * across;
  return std::remainder(trig::atan2(x_C.y(), x_C.x()) / kDegree - 90, 360);
}

/// The arm stands up the shaft: a remote centre elsewhere could hold the tool so by its wrist
/// alone, which has limits. Its axes are those of W, turned by the least turn from z_W to the
/// shaft.
void place_arm(const Vector3d& shaft, pb::Scene& scene) {
  constexpr double kAbove = 0.15;  // [m] from where the tip starts: half of the insertion is left
  const pb::Vec3& start = scene.tool_start_m();
  pb::Pose& base = *scene.mutable_tool()->mutable_base();
  set(*base.mutable_translation_m(), Vector3d(start.x(), start.y(), start.z()) - kAbove * shaft);
  const auto turn = Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), -shaft);
  set(*base.mutable_x_axis(), turn * Vector3d::UnitX());
  set(*base.mutable_y_axis(), turn * Vector3d::UnitY());
}

}  // namespace

Result<void> set_believed_gravity(const Belief& belief, BelievedScene& made) {
  constexpr double kMost = 20;      // [m/s^2] of Scene.gravity_m_per_s2
  constexpr double kNoTilt = 1e-6;  // [rad]: rounding of the stated numbers
  if (!belief.has("gravity_m_per_s2")) return {};
  const double single = belief.number("gravity_m_per_s2", 0);
  const Vector3d g = belief.vector("gravity_m_per_s2").value_or(Vector3d(0, 0, -single));
  if (!(g.norm() <= kMost) || (!belief.vector("gravity_m_per_s2") && single < 0)) {
    return Failure{fmt::format("{}: {:.6g} m/s^2, allowed a size of 0 ... {:g}",
                               belief.place("gravity_m_per_s2"), single < 0 ? single : g.norm(),
                               kMost)};
  }
  made.scene.set_gravity_m_per_s2(g.norm());
  if (!(g.norm() > 0)) return {};
  const Vector3d down = g.normalized();
  const double about_x = trig::atan2(down.y(), std::hypot(down.x(), down.z()));
  const double about_y = trig::atan2(-down.x(), -down.z());
  if (std::fabs(about_x) <= kNoTilt && std::fabs(about_y) <= kNoTilt) return {};
  if (made.kind != SetUp::kSheet && made.kind != SetUp::kSolid) {
    made.warnings.push_back(belief.place("gravity_m_per_s2") +
                            ": without tissue it points along -z_W: its size is used");
    return {};
  }
  pb::TissueEffects& effects = *made.scene.mutable_tissue()->mutable_effects();
  effects.set_gravity_tilt_x_deg(about_x / kDegree);
  effects.set_gravity_tilt_y_deg(about_y / kDegree);
  return {};
}

void set_believed_mass(const Belief& belief, BelievedScene& made) {
  for (const auto& [number, mass] : belief.masses()) {
    const std::string heavy = fmt::format("mass_{}_kg", number);
    const std::string place = fmt::format("mass_{}_B_m", number);
    const auto tell = [&](const std::string& key, const std::string& what) {
      made.warnings.push_back(belief.place(key) + ": " + what + ": not used");
    };
    if (!mass.kg) {
      tell(place, "without " + heavy);
    } else if (!mass.p_B) {
      tell(heavy, "without " + place);
    } else if (made.scene.tissue().effects().added_mass().mass_kg() > 0) {
      tell(heavy, "a scene can hang one mass on the body");
    } else {
      pb::AddedMass& added = *made.scene.mutable_tissue()->mutable_effects()->mutable_added_mass();
      added.set_mass_kg(*mass.kg);
      added.set_x_m(mass.p_B->x());
      added.set_y_m(mass.p_B->y());
    }
  }
}

void set_believed_tool(const Belief& belief, const Eigen::Isometry3d& X_WB, BelievedScene& made) {
  pb::Tool& tool = *made.scene.mutable_tool();
  tool.set_contact(false);  // how thick the shaft is no belief says
  const std::optional<Vector3d> shaft = shaft_down(belief);
  if (shaft) {
    set(*tool.mutable_shaft_direction(), *shaft);
    place_arm(*shaft, made.scene);
  }
  if (belief.has("shaft_direction_W") && !shaft)
    made.warnings.push_back(belief.place("shaft_direction_W") + ": no direction: not used");
  if (!belief.has("gripper_patch_x_m") && !belief.has("gripper_patch_y_m")) return;
  const double along = belief.number("gripper_patch_x_m", belief.number("gripper_patch_y_m", 0));
  const double across = belief.number("gripper_patch_y_m", along);
  pb::Grip& grip = *tool.mutable_grip();
  if (!made.scene.tissue().has_grid()) {
    grip.set_half_x_m(std::sqrt(along * across / kPi));
    const bool first = belief.has("gripper_patch_x_m");
    made.warnings.push_back(fmt::format(
        "{}: only a sheet's grid can be held by a pad: a disc of the same area holds in the mean",
        belief.place(first ? "gripper_patch_x_m" : "gripper_patch_y_m")));
    return;
  }
  tool.set_roll_deg(
      roll_along(X_WB.linear().col(1), X_WB.linear().col(2), shaft.value_or(-Vector3d::UnitZ())));
  grip.set_hold(pb::HOLD_PAD);
  grip.set_shape(pb::GRIP_RECTANGLE);
  grip.set_half_x_m(0.5 * along);
  grip.set_half_y_m(0.5 * across);
}

}  // namespace omentum
