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

// Stiffness of clusters is no material constant (docs/tissue.md 5): they have what needs none.
constexpr std::uint32_t kElasticModels = kShellModel | kSolidModel | kReferenceModel;
constexpr std::uint32_t kSheetModels = kShellModel | kReferenceModel;
constexpr std::uint32_t kEveryModel = kElasticModels | kClusterModel | kSoftBodyModel;

const EffectRow kRows[] = {
    {"strain_stiffening", [](V& v) -> double& { return v.stiffening; }, EffectPart::kMaterial,
     kElasticModels, 0, nullptr, 1},
    {"anisotropy.fibre_ratio", [](V& v) -> double& { return v.fibre_ratio; }, EffectPart::kMaterial,
     kElasticModels, 0, nullptr, 1},
    {"anisotropy.angle_deg", [](V& v) -> double& { return v.fibre_angle; }, EffectPart::kMaterial,
     kElasticModels, 0, "anisotropy.fibre_ratio", kDegree},
    {"viscoelastic[0].share", [](V& v) -> double& { return v.share[0]; }, EffectPart::kMaterial,
     kElasticModels, 0, nullptr, 1},
    {"viscoelastic[1].share", [](V& v) -> double& { return v.share[1]; }, EffectPart::kMaterial,
     kElasticModels, 0, nullptr, 1},
    {"viscoelastic[2].share", [](V& v) -> double& { return v.share[2]; }, EffectPart::kMaterial,
     kElasticModels, 0, nullptr, 1},
    {"viscoelastic[0].time_s", [](V& v) -> double& { return v.time[0]; }, EffectPart::kMaterial,
     kElasticModels, 0, "viscoelastic[0].share", 1},
    {"viscoelastic[1].time_s", [](V& v) -> double& { return v.time[1]; }, EffectPart::kMaterial,
     kElasticModels, 0, "viscoelastic[1].share", 1},
    {"viscoelastic[2].time_s", [](V& v) -> double& { return v.time[2]; }, EffectPart::kMaterial,
     kElasticModels, 0, "viscoelastic[2].share", 1},
    {"structural_damping", [](V& v) -> double& { return v.loss_factor; }, EffectPart::kMaterial,
     kElasticModels, 0, nullptr, 1},
    {"plastic_set.modulus_ratio", [](V& v) -> double& { return v.slider_ratio; },
     EffectPart::kMaterial, kElasticModels, 0, nullptr, 1},
    {"plastic_set.yield_strain", [](V& v) -> double& { return v.slider_yield; },
     EffectPart::kMaterial, kElasticModels, 0, "plastic_set.modulus_ratio", 1},
    {"inclusion.x_m", [](V& v) -> double& { return v.inclusion_x; }, EffectPart::kStructure,
     kElasticModels, kReferenceModel, "inclusion.stiffness_change", 1},
    {"inclusion.y_m", [](V& v) -> double& { return v.inclusion_y; }, EffectPart::kStructure,
     kElasticModels, kReferenceModel, "inclusion.stiffness_change", 1},
    {"inclusion.radius_m", [](V& v) -> double& { return v.inclusion_radius; },
     EffectPart::kStructure, kElasticModels, kReferenceModel, "inclusion.stiffness_change", 1},
    {"inclusion.stiffness_change", [](V& v) -> double& { return v.inclusion_change; },
     EffectPart::kStructure, kElasticModels, kReferenceModel, nullptr, 1},
    {"density_change", [](V& v) -> double& { return v.density_change; }, EffectPart::kGravity,
     kElasticModels, kReferenceModel, nullptr, 1},
    {"gravity_tilt_x_deg", [](V& v) -> double& { return v.tilt_x; }, EffectPart::kGravity,
     kEveryModel, 0, nullptr, kDegree},
    {"gravity_tilt_y_deg", [](V& v) -> double& { return v.tilt_y; }, EffectPart::kGravity,
     kEveryModel, 0, nullptr, kDegree},
    {"poisson_change", [](V& v) -> double& { return v.poisson_change; }, EffectPart::kStructure,
     kElasticModels, kReferenceModel, nullptr, 1},
    {"bending_change", [](V& v) -> double& { return v.bending_change; }, EffectPart::kStructure,
     kSheetModels, kReferenceModel, nullptr, 1},
    {"rest_shape.curvature_x_per_m", [](V& v) -> double& { return v.curvature_x; },
     EffectPart::kShape, kSheetModels, kReferenceModel, nullptr, 1},
    {"rest_shape.curvature_y_per_m", [](V& v) -> double& { return v.curvature_y; },
     EffectPart::kShape, kSheetModels, kReferenceModel, nullptr, 1},
    {"rest_shape.twist_per_m", [](V& v) -> double& { return v.twist; }, EffectPart::kShape,
     kSheetModels, kReferenceModel, nullptr, 1},
    {"rest_shape.stretch", [](V& v) -> double& { return v.stretch; }, EffectPart::kShape,
     kSheetModels, kReferenceModel, nullptr, 1},
    {"thickness.x_per_m", [](V& v) -> double& { return v.thickness_x; }, EffectPart::kStructure,
     kSheetModels, kReferenceModel, nullptr, 1},
    {"thickness.y_per_m", [](V& v) -> double& { return v.thickness_y; }, EffectPart::kStructure,
     kSheetModels, kReferenceModel, nullptr, 1},
    {"adhesion.stiffness_pa_per_m", [](V& v) -> double& { return v.adhesion; },
     EffectPart::kContact, kElasticModels, 0, nullptr, 1},
    {"adhesion.break_m", [](V& v) -> double& { return v.adhesion_break; }, EffectPart::kContact,
     kElasticModels, 0, "adhesion.stiffness_pa_per_m", 1},
    {"suction.drag_pa_s_per_m", [](V& v) -> double& { return v.suction; }, EffectPart::kContact,
     kElasticModels, 0, nullptr, 1},
    {"suction.reach_m", [](V& v) -> double& { return v.suction_reach; }, EffectPart::kContact,
     kElasticModels, 0, "suction.drag_pa_s_per_m", 1},
    {"friction_change", [](V& v) -> double& { return v.friction_change; }, EffectPart::kContact,
     kEveryModel, 0, nullptr, 1},
    {"anchor.compliance_m2_per_n", [](V& v) -> double& { return v.anchor_compliance; },
     EffectPart::kAnchor, kElasticModels, kReferenceModel, nullptr, 1},
    {"anchor.free_from_m", [](V& v) -> double& { return v.anchor_free_from; }, EffectPart::kAnchor,
     kElasticModels, kReferenceModel, nullptr, 1},
    {"anchor.free_to_m", [](V& v) -> double& { return v.anchor_free_to; }, EffectPart::kAnchor,
     kElasticModels, kReferenceModel, nullptr, 1},
    {"anchor.break_m", [](V& v) -> double& { return v.anchor_break; }, EffectPart::kAnchor,
     kElasticModels, kReferenceModel, nullptr, 1},
    {"grasp_offset.x_m", [](V& v) -> double& { return v.grasp_x; }, EffectPart::kJaw,
     kElasticModels | kSoftBodyModel, 0, nullptr, 1},
    {"grasp_offset.y_m", [](V& v) -> double& { return v.grasp_y; }, EffectPart::kJaw,
     kElasticModels | kSoftBodyModel, 0, nullptr, 1},
    {"grasp_offset.radius_m", [](V& v) -> double& { return v.grasp_radius; }, EffectPart::kJaw,
     kElasticModels | kSoftBodyModel, 0, nullptr, 1},
    {"grasp_slip.speed_m_per_s", [](V& v) -> double& { return v.slip_speed; }, EffectPart::kJaw,
     kElasticModels, 0, nullptr, 1},
    {"grasp_slip.force_n", [](V& v) -> double& { return v.slip_force; }, EffectPart::kJaw,
     kElasticModels, 0, "grasp_slip.speed_m_per_s", 1},
    {"grasp_slip.loss_m", [](V& v) -> double& { return v.slip_loss; }, EffectPart::kJaw,
     kElasticModels, 0, "grasp_slip.speed_m_per_s", 1},
    {"grasp_compliance_m_per_n", [](V& v) -> double& { return v.grasp_compliance; },
     EffectPart::kJaw, kElasticModels | kSoftBodyModel, 0, nullptr, 1},
    {"jaw_roll_deg", [](V& v) -> double& { return v.jaw_roll; }, EffectPart::kJaw,
     kElasticModels | kSoftBodyModel, 0, nullptr, kDegree},
    {"jaw_tilt_deg", [](V& v) -> double& { return v.jaw_tilt; }, EffectPart::kJaw,
     kElasticModels | kSoftBodyModel, 0, nullptr, kDegree},
    {"air_drag", [](V& v) -> double& { return v.air_drag; }, EffectPart::kContact, kElasticModels,
     0, nullptr, 1},
    {"mullins.softening", [](V& v) -> double& { return v.softening; }, EffectPart::kMaterial,
     kElasticModels, 0, nullptr, 1},
    {"mullins.strain", [](V& v) -> double& { return v.softening_strain; }, EffectPart::kMaterial,
     kElasticModels, 0, "mullins.softening", 1},
    {"obstacle.x_m", nullptr, EffectPart::kContact, kEveryModel, kEveryModel, "obstacle.radius_m",
     1},
    {"obstacle.y_m", nullptr, EffectPart::kContact, kEveryModel, kEveryModel, "obstacle.radius_m",
     1},
    {"obstacle.z_m", nullptr, EffectPart::kContact, kEveryModel, kEveryModel, "obstacle.radius_m",
     1},
    {"obstacle.radius_m", nullptr, EffectPart::kContact, kEveryModel, kEveryModel, nullptr, 1},
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

bool EffectValues::has_memory() const {
  return share[0] > 0 || share[1] > 0 || share[2] > 0 || loss_factor > 0 || slider_ratio > 0 ||
         softening > 0;
}

double EffectValues::stiffness_at(const Vector3d& p) const {
  if (inclusion_change == 0) return 1;
  const double dx = p.x() - inclusion_x;
  const double dy = p.y() - inclusion_y;
  const double u = std::sqrt(dx * dx + dy * dy) / inclusion_radius;
  const double t = std::clamp((1.25 - u) / 0.5, 0.0, 1.0);
  return 1 + inclusion_change * t * t * (3 - 2 * t);
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
