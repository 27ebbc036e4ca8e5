#include "sim_worker/tissue/effect_catalogue.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "core/check.h"
#include "core/constants.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

namespace protobuf = google::protobuf;
using Eigen::Vector3d;
using V = EffectValues;
using enum EffectPart;

/// A member of the values, or an entry of one that is an array.
template <double V::*kMember>
double& at(V& values) {
  return values.*kMember;
}
template <std::array<double, 3> V::*kMember, int kIndex>
double& at(V& values) {
  return (values.*kMember)[kIndex];
}

// Stiffness of clusters is no material constant (docs/tissue.md 5): they have what needs none.
constexpr std::uint32_t kElasticModels = kShellModel | kSolidModel | kReferenceModel;
constexpr std::uint32_t kSheetModels = kShellModel | kReferenceModel;
constexpr std::uint32_t kStickingModels = kElasticModels | kClusterModel;
constexpr std::uint32_t kEveryModel = kElasticModels | kClusterModel | kSoftBodyModel;

const EffectRow kRows[] = {
    {"strain_stiffening", at<&V::stiffening>, kMaterial, kElasticModels},
    {"anisotropy.fibre_ratio", at<&V::fibre_ratio>, kMaterial, kElasticModels},
    {"anisotropy.angle_deg", at<&V::fibre_angle>, kMaterial, kElasticModels, 0,
     "anisotropy.fibre_ratio", kDegree},
    {"viscoelastic[0].share", at<&V::share, 0>, kMaterial, kElasticModels},
    {"viscoelastic[1].share", at<&V::share, 1>, kMaterial, kElasticModels},
    {"viscoelastic[2].share", at<&V::share, 2>, kMaterial, kElasticModels},
    {"viscoelastic[0].time_s", at<&V::time, 0>, kMaterial, kElasticModels, 0,
     "viscoelastic[0].share"},
    {"viscoelastic[1].time_s", at<&V::time, 1>, kMaterial, kElasticModels, 0,
     "viscoelastic[1].share"},
    {"viscoelastic[2].time_s", at<&V::time, 2>, kMaterial, kElasticModels, 0,
     "viscoelastic[2].share"},
    {"structural_damping", at<&V::loss_factor>, kMaterial, kElasticModels},
    {"plastic_set.modulus_ratio", at<&V::slider_ratio>, kMaterial, kElasticModels},
    {"plastic_set.yield_strain", at<&V::slider_yield>, kMaterial, kElasticModels, 0,
     "plastic_set.modulus_ratio"},
    {"inclusion[0].x_m", at<&V::inclusion_x, 0>, kStructure, kElasticModels, kReferenceModel,
     "inclusion[0].stiffness_change"},
    {"inclusion[1].x_m", at<&V::inclusion_x, 1>, kStructure, kElasticModels, kReferenceModel,
     "inclusion[1].stiffness_change"},
    {"inclusion[2].x_m", at<&V::inclusion_x, 2>, kStructure, kElasticModels, kReferenceModel,
     "inclusion[2].stiffness_change"},
    {"inclusion[0].y_m", at<&V::inclusion_y, 0>, kStructure, kElasticModels, kReferenceModel,
     "inclusion[0].stiffness_change"},
    {"inclusion[1].y_m", at<&V::inclusion_y, 1>, kStructure, kElasticModels, kReferenceModel,
     "inclusion[1].stiffness_change"},
    {"inclusion[2].y_m", at<&V::inclusion_y, 2>, kStructure, kElasticModels, kReferenceModel,
     "inclusion[2].stiffness_change"},
    {"inclusion[0].radius_m", at<&V::inclusion_radius, 0>, kStructure, kElasticModels,
     kReferenceModel, "inclusion[0].stiffness_change"},
    {"inclusion[1].radius_m", at<&V::inclusion_radius, 1>, kStructure, kElasticModels,
     kReferenceModel, "inclusion[1].stiffness_change"},
    {"inclusion[2].radius_m", at<&V::inclusion_radius, 2>, kStructure, kElasticModels,
     kReferenceModel, "inclusion[2].stiffness_change"},
    {"inclusion[0].stiffness_change", at<&V::inclusion_change, 0>, kStructure, kElasticModels,
     kReferenceModel},
    {"inclusion[1].stiffness_change", at<&V::inclusion_change, 1>, kStructure, kElasticModels,
     kReferenceModel},
    {"inclusion[2].stiffness_change", at<&V::inclusion_change, 2>, kStructure, kElasticModels,
     kReferenceModel},
    {"density_change", at<&V::density_change>, kGravity, kElasticModels, kReferenceModel},
    {"gravity_tilt_x_deg", at<&V::tilt_x>, kGravity, kEveryModel, 0, nullptr, kDegree},
    {"gravity_tilt_y_deg", at<&V::tilt_y>, kGravity, kEveryModel, 0, nullptr, kDegree},
    {"poisson_change", at<&V::poisson_change>, kStructure, kElasticModels, kReferenceModel},
    {"bending_change", at<&V::bending_change>, kStructure, kSheetModels, kReferenceModel},
    {"rest_shape.curvature_x_per_m", at<&V::curvature_x>, kShape, kSheetModels, kReferenceModel},
    {"rest_shape.curvature_y_per_m", at<&V::curvature_y>, kShape, kSheetModels, kReferenceModel},
    {"rest_shape.twist_per_m", at<&V::twist>, kShape, kSheetModels, kReferenceModel},
    {"rest_shape.stretch", at<&V::stretch>, kStructure, kSheetModels, kReferenceModel},
    {"thickness.x_per_m", at<&V::thickness_x>, kStructure, kSheetModels, kReferenceModel},
    {"thickness.y_per_m", at<&V::thickness_y>, kStructure, kSheetModels, kReferenceModel},
    {"adhesion.stiffness_pa_per_m", at<&V::adhesion>, kContact, kStickingModels},
    {"adhesion.break_m", at<&V::adhesion_break>, kContact, kStickingModels, 0,
     "adhesion.stiffness_pa_per_m"},
    {"adhesion.x_m", at<&V::adhesion_x>, kContact, kStickingModels, 0,
     "adhesion.stiffness_pa_per_m"},
    {"adhesion.y_m", at<&V::adhesion_y>, kContact, kStickingModels, 0,
     "adhesion.stiffness_pa_per_m"},
    {"adhesion.half_x_m", at<&V::adhesion_half_x>, kContact, kStickingModels, 0,
     "adhesion.stiffness_pa_per_m"},
    {"adhesion.half_y_m", at<&V::adhesion_half_y>, kContact, kStickingModels, 0,
     "adhesion.stiffness_pa_per_m"},
    {"suction.drag_pa_s_per_m", at<&V::suction>, kContact, kElasticModels},
    {"suction.reach_m", at<&V::suction_reach>, kContact, kElasticModels, 0,
     "suction.drag_pa_s_per_m"},
    {"friction_change", at<&V::friction_change>, kContact, kEveryModel},
    // The edge of a clamp that gives way bends as its bed lets it.
    {"anchor.compliance_m2_per_n", at<&V::anchor_compliance>, kStructure, kElasticModels,
     kReferenceModel},
    {"anchor.free_from_m", at<&V::anchor_free_from>, kStructure, kElasticModels, kReferenceModel},
    {"anchor.free_to_m", at<&V::anchor_free_to>, kStructure, kElasticModels, kReferenceModel},
    {"anchor.break_m", at<&V::anchor_break>, kAnchor, kElasticModels, kReferenceModel},
    {"grasp_offset.x_m", at<&V::grasp_x>, kJaw, kElasticModels | kSoftBodyModel},
    {"grasp_offset.y_m", at<&V::grasp_y>, kJaw, kElasticModels | kSoftBodyModel},
    {"grasp_offset.radius_m", at<&V::grasp_radius>, kJaw, kElasticModels | kSoftBodyModel},
    {"grasp_slip.speed_m_per_s", at<&V::slip_speed>, kJaw, kElasticModels},
    {"grasp_slip.force_n", at<&V::slip_force>, kJaw, kElasticModels, 0, "grasp_slip.speed_m_per_s"},
    {"grasp_slip.loss_m", at<&V::slip_loss>, kJaw, kElasticModels, 0, "grasp_slip.speed_m_per_s"},
    {"grasp_slip.total_m", at<&V::slip_total>, kJaw, kElasticModels, 0, "grasp_slip.speed_m_per_s"},
    {"grasp_compliance_m_per_n", at<&V::grasp_compliance>, kJaw, kElasticModels | kSoftBodyModel},
    {"grasp_turn_rad_per_n_m", at<&V::grasp_turn>, kJaw, kSheetModels},
    {"jaw_roll_deg", at<&V::jaw_roll>, kJaw, kElasticModels | kSoftBodyModel, 0, nullptr, kDegree},
    {"jaw_tilt_deg", at<&V::jaw_tilt>, kJaw, kElasticModels | kSoftBodyModel, 0, nullptr, kDegree},
    {"jaw_lean_deg", at<&V::jaw_lean>, kJaw, kElasticModels | kSoftBodyModel, 0, nullptr, kDegree},
    {"air_drag", at<&V::air_drag>, kContact, kElasticModels},
    {"mullins.softening", at<&V::softening>, kMaterial, kElasticModels},
    {"mullins.strain", at<&V::softening_strain>, kMaterial, kElasticModels, 0, "mullins.softening"},
    {"exponential_stiffening", at<&V::exponential>, kMaterial, kElasticModels},
    {"added_mass.mass_kg", at<&V::added_mass>, kGravity, kElasticModels, kElasticModels},
    {"added_mass.x_m", at<&V::added_x>, kGravity, kElasticModels, kElasticModels,
     "added_mass.mass_kg"},
    {"added_mass.y_m", at<&V::added_y>, kGravity, kElasticModels, kElasticModels,
     "added_mass.mass_kg"},
    {"added_mass.radius_m", at<&V::added_radius>, kGravity, kElasticModels, kElasticModels,
     "added_mass.mass_kg"},
    {"local_force.strength", at<&V::pull>, kContact, kElasticModels},
    {"local_force.x_m", at<&V::pull_x>, kContact, kElasticModels, 0, "local_force.strength"},
    {"local_force.y_m", at<&V::pull_y>, kContact, kElasticModels, 0, "local_force.strength"},
    {"local_force.radius_m", at<&V::pull_radius>, kContact, kElasticModels, 0,
     "local_force.strength"},
    {"local_force.stiffness_n_per_m", at<&V::pull_stiffness>, kContact, kElasticModels, 0,
     "local_force.strength"},
    {"local_force.slack_m", at<&V::pull_slack>, kContact, kElasticModels, 0,
     "local_force.strength"},
    {"local_force.anchor_x_m", at<&V::pull_anchor_x>, kContact, kElasticModels, 0,
     "local_force.strength"},
    {"local_force.anchor_y_m", at<&V::pull_anchor_y>, kContact, kElasticModels, 0,
     "local_force.strength"},
    {"local_force.anchor_z_m", at<&V::pull_anchor_z>, kContact, kElasticModels, 0,
     "local_force.strength"},
    {"local_force.damper_n_s_per_m", at<&V::pull_damper>, kContact, kElasticModels, 0,
     "local_force.strength"},
    {"local_force.push_x_n", at<&V::push_x>, kContact, kElasticModels, 0, "local_force.strength"},
    {"local_force.push_y_n", at<&V::push_y>, kContact, kElasticModels, 0, "local_force.strength"},
    {"local_force.push_z_n", at<&V::push_z>, kContact, kElasticModels, 0, "local_force.strength"},
    {"local_force.decay_s", at<&V::push_decay>, kContact, kElasticModels, 0,
     "local_force.strength"},
    {"obstacle.x_m", nullptr, kContact, kEveryModel, kEveryModel, "obstacle.radius_m"},
    {"obstacle.y_m", nullptr, kContact, kEveryModel, kEveryModel, "obstacle.radius_m"},
    {"obstacle.z_m", nullptr, kContact, kEveryModel, kEveryModel, "obstacle.radius_m"},
    {"obstacle.radius_m", nullptr, kContact, kEveryModel, kEveryModel},
};
constexpr std::size_t kValues = sizeof(EffectValues) / sizeof(double);

/// Rows that have a value in EffectValues.
std::span<const EffectRow> value_rows() { return std::span(kRows).first(kValues); }

/// The field of a path in a message, and the message that holds it; null where there is none.
/// Repeated messages that lack an entry are not made.
struct Place {
  const protobuf::Message* message = nullptr;
  const protobuf::FieldDescriptor* field = nullptr;
};

/// "name[2]" is the name and 2, "name" the name and 0.
std::pair<std::string, int> split_index(std::string name) {
  const std::size_t bracket = name.find('[');
  if (bracket == std::string::npos) return {std::move(name), 0};
  const int index = std::atoi(name.c_str() + bracket + 1);
  name.resize(bracket);
  return {std::move(name), index};
}

/// Of a path of the catalogue.
Place find(const pb::TissueEffects& effects, const std::string& path) {
  const std::size_t dot = path.find('.');
  const auto [name, index] = split_index(path.substr(0, dot));
  const auto* field = effects.GetDescriptor()->FindFieldByName(name);
  if (dot == std::string::npos) return {&effects, field};
  const auto* inner = field->message_type()->FindFieldByName(path.substr(dot + 1));
  const auto* reflection = effects.GetReflection();
  if (!field->is_repeated()) return {&reflection->GetMessage(effects, field), inner};
  if (reflection->FieldSize(effects, field) <= index) return {nullptr, inner};
  return {&reflection->GetRepeatedMessage(effects, field, index), inner};
}

/// In units of the knob.
double value_at(const pb::TissueEffects& effects, const char* path) {
  const Place place = find(effects, path);
  return place.message == nullptr
             ? place.field->default_value_double()
             : place.message->GetReflection()->GetDouble(*place.message, place.field);
}

/// Refuses a place that is not on the body.
void check_places(const EffectValues& v, std::span<const Vector3d> particles) {
  if (particles.empty()) return;
  Eigen::AlignedBox2d body;
  for (const Vector3d& p : particles) body.extend(Eigen::Vector2d(p.head<2>()));
  const auto require = [&](bool on, const char* name, double x, double y,
                           const Eigen::Vector2d& half) {
    const Eigen::Vector2d centre(x, y);
    if (!on || body.intersects(Eigen::AlignedBox2d(centre - half, centre + half))) return;
    throw_error(
        "scene.tissue.effects.{}: its place ({}, {}) m is off the tissue, which lies within x_B {} "
        "... {}, y_B {} ... {} m",
        name, x, y, body.min().x(), body.max().x(), body.min().y(), body.max().y());
  };
  const auto round = [](double radius) { return Eigen::Vector2d::Constant(radius).eval(); };
  for (std::size_t k = 0; k < v.inclusion_change.size(); ++k) {
    require(v.inclusion_change[k] != 0, "inclusion", v.inclusion_x[k], v.inclusion_y[k],
            round(1.25 * v.inclusion_radius[k]));
  }
  require(v.adhesion > 0 && !v.sticks_everywhere(), "adhesion", v.adhesion_x, v.adhesion_y,
          {v.adhesion_half_x, v.adhesion_half_y});
  require(v.added_mass > 0, "added_mass", v.added_x, v.added_y, round(v.added_radius));
  require(v.pull > 0, "local_force", v.pull_x, v.pull_y, round(v.pull_radius));
}

std::string effect_name(const EffectRow& row) {
  return std::string(row.path).substr(0, std::string(row.path).find_first_of(".["));
}

/// The first row that is on and that the model lacks; null where there is none.
const EffectRow* first_lacking(const pb::TissueEffects& effects, EffectModel model) {
  for (const EffectRow& row : kRows) {
    if (row.of == nullptr && (row.models & model) == 0 && value_at(effects, row.path) != 0)
      return &row;
  }
  return nullptr;
}

}  // namespace

std::span<const EffectRow> effect_catalogue() {
  static_assert(std::size(kRows) == kValues + 4);
  return kRows;
}

const pb::Knob& knob_of(const EffectRow& row) {
  return find(pb::TissueEffects::default_instance(), row.path)
      .field->options()
      .GetExtension(pb::knob);
}

bool EffectValues::same_structure(const EffectValues& other) const {
  const auto rows = value_rows();
  return std::all_of(rows.begin(), rows.end(), [&](const EffectRow& row) {
    return row.part != EffectPart::kStructure || row.get(*this) == row.get(other);
  });
}

bool EffectValues::has_inclusion() const {
  return std::ranges::any_of(inclusion_change, [](double change) { return change != 0; });
}

bool EffectValues::has_memory() const {
  return share[0] > 0 || share[1] > 0 || share[2] > 0 || loss_factor > 0 || slider_ratio > 0 ||
         softening > 0;
}

double EffectValues::stiffness_at(const Vector3d& p) const {
  double stiffness = 1;
  for (std::size_t k = 0; k < inclusion_change.size(); ++k) {
    if (inclusion_change[k] == 0) continue;
    const double dx = p.x() - inclusion_x[k];
    const double dy = p.y() - inclusion_y[k];
    const double u = std::sqrt(dx * dx + dy * dy) / inclusion_radius[k];
    const double t =
        std::clamp((1.25 - u) / 0.5, 0.0, 1.0);  // place_weight(), with the bits it had
    stiffness += inclusion_change[k] * t * t * (3 - 2 * t);
  }
  return stiffness;
}

double EffectValues::thickness_at(const Vector3d& p) const {
  return 1 + thickness_x * p.x() + thickness_y * p.y();
}

EffectValues make_effects(const pb::TissueEffects& e, double poisson_ratio,
                          std::span<const Vector3d> particles) {
  EffectValues v;
  if (e.viscoelastic_size() > static_cast<int>(v.share.size())) {
    throw_error("scene.tissue.effects.viscoelastic: {} branches, allowed at most {}",
                e.viscoelastic_size(), v.share.size());
  }
  if (e.inclusion_size() > static_cast<int>(v.inclusion_change.size())) {
    throw_error("scene.tissue.effects.inclusion: {} of them, allowed at most {}",
                e.inclusion_size(), v.inclusion_change.size());
  }
  for (const EffectRow& row : value_rows()) {
    if (row.of == nullptr || value_at(e, row.of) != 0)
      row.member(v) = row.factor * value_at(e, row.path);
  }
  if (v.anchor_free_from == v.anchor_free_to) v.anchor_free_from = v.anchor_free_to = 0;

  const double nu = poisson_ratio + v.poisson_change;
  if (v.poisson_change != 0 && !(nu >= 0 && nu <= 0.49)) {
    throw_error(
        "scene.tissue.effects.poisson_change: {} makes Poisson's ratio {}, allowed 0 ... 0.49",
        v.poisson_change, nu);
  }
  for (const Vector3d& p : particles) {
    const double h = v.thickness_at(p);
    if (!(h >= 0.2 && h <= 5)) {
      throw_error(
          "scene.tissue.effects.thickness: ({}, {}) 1/m makes {} of the thickness at ({}, {}) m, "
          "allowed 0.2 ... 5",
          v.thickness_x, v.thickness_y, h, p.x(), p.y());
    }
  }
  check_places(v, particles);
  if (v.anchor_free_from > v.anchor_free_to) {
    throw_error("scene.tissue.effects.anchor.free_to_m: {}, allowed from free_from_m {}",
                v.anchor_free_to, v.anchor_free_from);
  }
  if (v.anchor_break > 0 && !(v.anchor_compliance > 0)) {
    throw_error("scene.tissue.effects.anchor.break_m: {} m without compliance_m2_per_n, allowed 0",
                v.anchor_break);
  }
  return v;
}

// 1e-9: rounding of what was made with factors.
bool usable(const EffectValues& v, double poisson_ratio, std::span<const Vector3d> particles) {
  const auto rows = value_rows();
  const double nu = poisson_ratio + v.poisson_change;
  return std::all_of(rows.begin(), rows.end(),
                     [&](const EffectRow& row) {
                       const pb::Knob& knob = knob_of(row);
                       const double slack = 1e-9 * (knob.max() - knob.min());
                       const double value = row.get(v) / row.factor;
                       return value >= knob.min() - slack && value <= knob.max() + slack;
                     }) &&
         nu >= 0 && nu <= 0.49 &&
         std::all_of(particles.begin(), particles.end(), [&](const Vector3d& p) {
           return v.thickness_at(p) >= 0.2 && v.thickness_at(p) <= 5;
         });
}

bool has_effects(const pb::TissueEffects& effects, EffectModel model) {
  return first_lacking(effects, model) == nullptr;
}

void refuse_effects(const pb::TissueEffects& effects, EffectModel model, const std::string& name) {
  const EffectRow* lacking = first_lacking(effects, model);
  if (lacking == nullptr) return;
  std::vector<std::string> allowed;
  for (const EffectRow& row : kRows) {
    if ((row.models & model) != 0 && (allowed.empty() || allowed.back() != effect_name(row)))
      allowed.push_back(effect_name(row));
  }
  throw_error("scene.tissue.effects.{}: not possible with {}, allowed there: {}",
              effect_name(*lacking), name, fmt::join(allowed, ", "));
}

EffectValues effects_of_model(const EffectValues& values, EffectModel model) {
  EffectValues own;
  for (const EffectRow& row : value_rows()) {
    if ((row.models & model) != 0) row.member(own) = row.get(values);
  }
  return own;
}

bool baked_fit(const EffectValues& scene, const EffectValues& lane, EffectModel model) {
  const auto rows = value_rows();
  return std::all_of(rows.begin(), rows.end(), [&](const EffectRow& row) {
    return (row.baked & model) == 0 || row.get(scene) == row.get(lane);
  });
}

bool anchors_fit(const EffectValues& scene, const EffectValues& lane) {
  if (scene.anchor_compliance > 0) return lane.anchor_compliance > 0;
  return lane.anchor_compliance == 0 && lane.anchor_free_from == scene.anchor_free_from &&
         lane.anchor_free_to == scene.anchor_free_to;
}

void set_effect(pb::TissueEffects& effects, const std::string& path, double value) {
  protobuf::Message* message = &effects;
  std::size_t begin = 0;
  while (true) {
    const std::size_t dot = path.find('.', begin);
    const auto [name, index] =
        split_index(path.substr(begin, dot == std::string::npos ? dot : dot - begin));
    const auto* field = message->GetDescriptor()->FindFieldByName(name);
    const auto* reflection = message->GetReflection();
    const bool last = dot == std::string::npos;
    const bool is_message =
        field != nullptr && field->cpp_type() == protobuf::FieldDescriptor::CPPTYPE_MESSAGE;
    if (field == nullptr || is_message == last || index < 0 || index > 2) {
      std::string names;
      for (int k = 0; k < message->GetDescriptor()->field_count(); ++k) {
        names += (k == 0 ? "" : ", ") + message->GetDescriptor()->field(k)->name();
      }
      throw_error("tissue.effects.{}: no effect of that name, allowed at \"{}\": {}", path, name,
                  names);
    }
    if (last) {
      const pb::Knob& knob = field->options().GetExtension(pb::knob);
      if (!(value >= knob.min() && value <= knob.max())) {
        throw_error("tissue.effects.{}: {}, allowed {} ... {}", path, value, knob.min(),
                    knob.max());
      }
      reflection->SetDouble(message, field, value);
      return;
    }
    if (field->is_repeated()) {
      while (reflection->FieldSize(*message, field) <= index)
        reflection->AddMessage(message, field);
      message = reflection->MutableRepeatedMessage(message, field, index);
    } else {
      message = reflection->MutableMessage(message, field);
    }
    begin = dot + 1;
  }
}

}  // namespace omentum
