#include "mismatch/fit/unknowns.h"

#include <fmt/format.h>
#include <google/protobuf/message.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/check.h"
#include "core/constants.h"
#include "proto/knob.pb.h"
#include "sim_worker/scene/scene_parts.h"

namespace omentum {
namespace {

namespace protobuf = google::protobuf;

struct Place {
  protobuf::Message* message = nullptr;
  const protobuf::FieldDescriptor* field = nullptr;
};

/// The field of a path "scene.a.b"; makes the messages on the way.
Place find_field(pb::Scene& scene, const std::string& path) {
  protobuf::Message* message = &scene;
  std::string_view rest = path;
  if (rest.starts_with("scene.")) rest.remove_prefix(6);
  while (true) {
    const std::size_t dot = rest.find('.');
    const auto* field = message->GetDescriptor()->FindFieldByName(std::string(rest.substr(0, dot)));
    if (field == nullptr || field->is_repeated()) throw_error("{}: no number of a scene", path);
    if (dot == std::string_view::npos) {
      if (field->cpp_type() != protobuf::FieldDescriptor::CPPTYPE_DOUBLE)
        throw_error("{}: no number of a scene", path);
      return {message, field};
    }
    if (field->cpp_type() != protobuf::FieldDescriptor::CPPTYPE_MESSAGE)
      throw_error("{}: no number of a scene", path);
    message = message->GetReflection()->MutableMessage(message, field);
    rest.remove_prefix(dot + 1);
  }
}

/// Stated prior of a path, as the standard deviation of x.
void take_prior(const pb::Priors& priors, Unknown& unknown) {
  for (const pb::Prior& prior : priors.prior()) {
    if (prior.path() != unknown.path) continue;
    const bool factor = unknown.scale != Unknown::Scale::kShift;
    if (factor && prior.factor() > 1) {
      unknown.sd = std::log(prior.factor());
    } else if (factor && prior.sd() > 0) {
      const double whole =
          unknown.scale == Unknown::Scale::kChange ? 1 + unknown.believed : unknown.believed;
      unknown.sd = std::log1p(prior.sd() / std::max(whole, 1e-12));
    } else if (!factor && prior.sd() > 0) {
      unknown.sd = prior.sd();
    } else {
      continue;
    }
    unknown.prior = prior.source().empty() ? "stated" : prior.source();
  }
}

void set_vector(pb::Vec3& to, const Eigen::Vector3d& v) {
  to.set_x(v.x());
  to.set_y(v.y());
  to.set_z(v.z());
}

/// Of a sheet that has become so many times as large and is turned about z_B [rad]: its part at
/// `about` stays where it is.
void set_size_and_turn(pb::Scene& scene, double factor, double turn, const Eigen::Vector2d& about) {
  pb::Pose& pose = *scene.mutable_tissue()->mutable_pose();
  const Eigen::Isometry3d before = to_pose(pose, "scene.tissue.pose");
  const Eigen::Vector3d part(about.x(), about.y(), 0);
  const Eigen::Matrix3d R = before.linear() * Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ());
  set_vector(*pose.mutable_translation_m(), before * part - R * (factor * part));
  if (turn == 0) return;
  set_vector(*pose.mutable_x_axis(), R.col(0));
  set_vector(*pose.mutable_y_axis(), R.col(1));
  pose.clear_z_axis();
}

/// The lower face stays where it is if it may lie on something.
void set_thickness(pb::Scene& scene, double value) {
  pb::Tissue& tissue = *scene.mutable_tissue();
  const double before = tissue.thickness_m();
  set_scene_number(scene, kThicknessPath, value);
  const double ratio = tissue.thickness_m() / before;
  set_scene_number(scene, "scene.tissue.particle_radius_m", ratio * tissue.particle_radius_m());
  if (scene.rigid_body_size() == 0) return;
  const Eigen::Vector3d up = 0.5 * (tissue.thickness_m() - before) *
                             to_pose(tissue.pose(), "scene.tissue.pose").linear().col(2);
  pb::Vec3& place = *tissue.mutable_pose()->mutable_translation_m();
  place.set_x(place.x() + up.x());
  place.set_y(place.y() + up.y());
  place.set_z(place.z() + up.z());
}

}  // namespace

double Unknown::value(double x) const {
  switch (scale) {
    case Scale::kFactor:
      return believed * std::exp(x);
    case Scale::kChange:
      return (1 + believed) * std::exp(x) - 1;
    case Scale::kShift:
      break;
  }
  return believed + x;
}

double Unknown::slope(double x) const {
  switch (scale) {
    case Scale::kFactor:
      return value(x);
    case Scale::kChange:
      return 1 + value(x);
    case Scale::kShift:
      break;
  }
  return 1;
}

double Unknown::at(double v) const {
  switch (scale) {
    case Scale::kFactor:
      return std::log(v / believed);
    case Scale::kChange:
      return std::log((1 + v) / (1 + believed));
    case Scale::kShift:
      break;
  }
  return v - believed;
}

double scene_number(const pb::Scene& scene, const std::string& path) {
  pb::Scene copy = scene;
  const Place place = find_field(copy, path);
  return place.message->GetReflection()->GetDouble(*place.message, place.field);
}

void set_scene_number(pb::Scene& scene, const std::string& path, double value) {
  const Place place = find_field(scene, path);
  const pb::Knob& knob = place.field->options().GetExtension(pb::knob);
  if (knob.has_min()) value = std::max(value, knob.min());
  if (knob.has_max()) value = std::min(value, knob.max());
  place.message->GetReflection()->SetDouble(place.message, place.field, value);
}

Range range_of(const Unknown& unknown) {
  constexpr double kFarthest = 3;  // standard deviations
  Range range{-kFarthest * unknown.sd, kFarthest * unknown.sd};
  if (!unknown.in_scene() || unknown.path == kTurnPath) return range;
  pb::Scene scene;
  const pb::Knob& knob = find_field(scene, unknown.path).field->options().GetExtension(pb::knob);
  // Beyond the last value there must be room for the step of a derivative.
  constexpr double kRoom = 1e-4;
  if (knob.has_min() && unknown.value(range.low) < knob.min())
    range.low = unknown.at(knob.min() + kRoom);
  if (knob.has_max() && unknown.value(range.high) > knob.max())
    range.high = unknown.at(knob.max() - kRoom);
  return range;
}

namespace {

constexpr const char* kDampingPath = "scene.tissue.material.damping_per_s";

bool has_sd(const pb::Priors& priors, const std::string& path) {
  return std::ranges::any_of(priors.prior(), [&](const pb::Prior& prior) {
    return prior.path() == path && prior.sd() > 0;
  });
}

}  // namespace

std::vector<std::string> told_not_looked_for(const pb::Scene& scene, const pb::Priors& priors) {
  std::vector<std::string> told;
  const pb::Tissue& tissue = scene.tissue();
  if (!(tissue.material().damping_per_s() > 0) && !has_sd(priors, kDampingPath)) {
    told.push_back(fmt::format(
        "damping is not looked for: {} is 0, and a factor of 0 is 0; a prior with sd beside the "
        "scene (NAME.prior.txtpb: prior {{ path: \"{}\" sd: 0.5 source: \"...\" }}) or a value "
        "above 0 has it looked for",
        kDampingPath, kDampingPath));
  }
  if (scene.rigid_body_size() > 0 && !(tissue.dynamic_friction() > 0)) {
    told.emplace_back(
        "friction is not looked for: scene.tissue.dynamic_friction is 0, and a factor of 0 is 0; "
        "a value above 0 has it looked for (--set scene.tissue.dynamic_friction=0.1)");
  }
  return told;
}

std::vector<Unknown> unknowns_of(const pb::Scene& scene, const pb::Priors& priors,
                                 bool with_force) {
  using Scale = Unknown::Scale;
  const pb::Tissue& tissue = scene.tissue();
  std::vector<Unknown> list = {
      {"scene.tissue.material.young_modulus_pa", "Pa", "young_modulus", Scale::kFactor,
       tissue.material().young_modulus_pa(), std::log(3.0), "a factor of 3, docs/calibrate.md 2"},
      {"scene.tissue.effects.bending_change", "1", "bending_stiffness.factor", Scale::kChange,
       tissue.effects().bending_change(), std::log(1.15), "15 %, docs/calibrate.md 2"},
      {kDampingPath, "1/s", "damping", Scale::kFactor, tissue.material().damping_per_s(),
       std::log(3.0), "a factor of 3, docs/calibrate.md 2"},
  };
  if (!(list.back().believed > 0)) {  // no factor makes it other than zero
    if (has_sd(priors, kDampingPath)) {
      list.back().scale = Scale::kShift;
    } else {
      list.pop_back();
    }
  }
  if (scene.rigid_body_size() > 0 && tissue.dynamic_friction() > 0) {
    list.push_back({"scene.tissue.effects.friction_change", "1", "board_friction.factor",
                    Scale::kChange, tissue.effects().friction_change(), std::log(1.6),
                    "a factor of 1.6, docs/calibrate.md 2"});
  }
  list.push_back({"scene.tissue.material.poisson_ratio", "1", "poisson.nu", Scale::kShift,
                  tissue.material().poisson_ratio(), 0.03, "0.03, docs/calibrate.md 2"});
  if (!tissue.has_volume() && tissue.thickness_m() > 0) {
    list.push_back({kThicknessPath, "m", "thickness", Scale::kFactor, tissue.thickness_m(),
                    std::log(1.05), "5 %, docs/calibrate.md 2"});
  }
  if (with_force) {
    list.push_back({"scene.tissue.effects.density_change", "1", "density.factor", Scale::kChange,
                    tissue.effects().density_change(), std::log(1.1), "10 %, docs/calibrate.md 2"});
  }
  for (Unknown& unknown : list) take_prior(priors, unknown);
  return list;
}

void add_named_unknowns(const pb::Scene& scene, const pb::Priors& priors,
                        std::vector<Unknown>& unknowns) {
  for (const pb::Prior& prior : priors.prior()) {
    const std::string& path = prior.path();
    // Of the camera: numbers of the registration, which are looked for anyway.
    if (path.starts_with("scene.depth_sensor.")) continue;
    if (std::ranges::find(unknowns, path, &Unknown::path) != unknowns.end()) continue;
    Unknown unknown{path, "deg", "", Unknown::Scale::kShift, 0, 0, ""};
    if (path != kTurnPath) {
      pb::Scene copy = scene;
      unknown.unit = find_field(copy, path).field->options().GetExtension(pb::knob).unit();
      if (unknown.unit.empty()) unknown.unit.assign(1, '1');
      unknown.believed = scene_number(scene, path);
      if (prior.factor() > 1) unknown.scale = Unknown::Scale::kFactor;
      if (prior.factor() > 1 && !(unknown.believed > 0)) {
        throw_error("prior of {}: a factor of {:.6g}, which it is in the scene; needed sd", path,
                    unknown.believed);
      }
    }
    take_prior(priors, unknown);
    if (unknown.sd > 0) unknowns.push_back(unknown);
  }
}

pb::Scene scene_at(const pb::Scene& believed, const std::vector<Unknown>& unknowns,
                   const Eigen::VectorXd& x, const OwnNumbers& own, const Eigen::Vector2d& about) {
  pb::Scene scene = believed;
  double turn = 0;  // [rad]
  for (std::size_t k = 0; k < unknowns.size(); ++k) {
    const Unknown& unknown = unknowns[k];
    if (!unknown.in_scene()) continue;
    double value = unknown.value(x[static_cast<Eigen::Index>(k)]);
    if (unknown.path == kThicknessPath) {
      set_thickness(scene, value);
      continue;
    }
    if (unknown.path == kTurnPath) {
      turn = kDegree * value;
      continue;
    }
    if (unknown.column == "young_modulus") value *= std::exp(own.stiffness);
    set_scene_number(scene, unknown.path, value);
  }
  const double size = scene_number(scene, kPitchPath) / scene_number(believed, kPitchPath);
  if (size != 1 || turn != 0) set_size_and_turn(scene, size, turn, about);
  const pb::GraspOffset& offset = believed.tissue().effects().grasp_offset();
  set_scene_number(scene, "scene.tissue.effects.grasp_offset.x_m", offset.x_m() + own.pinch.x());
  set_scene_number(scene, "scene.tissue.effects.grasp_offset.y_m", offset.y_m() + own.pinch.y());
  return scene;
}

}  // namespace omentum
