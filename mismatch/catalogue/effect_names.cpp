#include "mismatch/catalogue/effect_names.h"

#include <fmt/format.h>
#include <google/protobuf/message.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <optional>

#include "core/check.h"
#include "mismatch/catalogue/effect_table.h"
#include "proto/knob.pb.h"

namespace omentum {
namespace {

namespace protobuf = google::protobuf;

/// "a.b[].c" at the dots.
std::vector<std::string> steps_of(const std::string& path) {
  std::vector<std::string> steps(1);
  for (const char c : path) {
    if (c == '.') {
      steps.emplace_back();
    } else {
      steps.back() += c;
    }
  }
  return steps;
}

/// A field of a scene by its path, whose "[]" is the entry `index`: the message that holds it, null
/// where that is missing, and the field itself.
struct Place {
  const protobuf::Message* message = nullptr;
  const protobuf::FieldDescriptor* field = nullptr;
};

Place find(const pb::Scene& scene, const std::string& path, int index) {
  const protobuf::Message* message = &scene;
  const protobuf::Descriptor* type = scene.GetDescriptor();
  const std::vector<std::string> steps = steps_of(path);
  for (std::size_t k = 0; k < steps.size(); ++k) {
    const bool repeated = steps[k].ends_with("[]");
    const std::string name = repeated ? steps[k].substr(0, steps[k].size() - 2) : steps[k];
    const auto* field = type->FindFieldByName(name);
    OMENTUM_CHECK(field != nullptr, "no field {} in a scene", path);
    if (k + 1 == steps.size()) return {message, field};
    type = field->message_type();
    if (message == nullptr) continue;
    const auto* reflection = message->GetReflection();
    if (!repeated) {
      message = &reflection->GetMessage(*message, field);
    } else {
      const bool there = index < reflection->FieldSize(*message, field);
      message = there ? &reflection->GetRepeatedMessage(*message, field, index) : nullptr;
    }
  }
  return {};
}

double field_value(const pb::Scene& scene, const std::string& path, int index = 0) {
  const Place place = find(scene, path, index);
  return place.message == nullptr
             ? place.field->default_value_double()
             : place.message->GetReflection()->GetDouble(*place.message, place.field);
}

/// Of a repeated message in front of the field.
bool is_repeated(const EffectField& row) { return row.path.find("[]") != std::string::npos; }

int entries_of(const pb::Scene& scene, const EffectField& row) {
  if (!is_repeated(row)) return 1;
  const Place place = find(scene, row.path.substr(0, row.path.find("[]")), 0);
  return place.message->GetReflection()->FieldSize(*place.message, place.field);
}

void set_field(pb::Scene& scene, const EffectField& row, double value, int index) {
  const Place place = find(scene, row.path, index);
  const pb::Knob& knob = place.field->options().GetExtension(pb::knob);
  const bool has_range = place.field->options().HasExtension(pb::knob) && knob.has_min();
  if (!std::isfinite(value) || (has_range && !(value >= knob.min() && value <= knob.max()))) {
    throw_error("{}.{}: makes scene.{} {}, allowed {} ... {}", row.effect, row.parameter, row.path,
                value, knob.min(), knob.max());
  }
  protobuf::Message* message = &scene;
  const std::vector<std::string> steps = steps_of(row.path);
  for (std::size_t k = 0; k + 1 < steps.size(); ++k) {
    const bool repeated = steps[k].ends_with("[]");
    const std::string name = repeated ? steps[k].substr(0, steps[k].size() - 2) : steps[k];
    const auto* field = message->GetDescriptor()->FindFieldByName(name);
    const auto* reflection = message->GetReflection();
    while (repeated && reflection->FieldSize(*message, field) <= index)
      reflection->AddMessage(message, field);
    message = repeated ? reflection->MutableRepeatedMessage(message, field, index)
                       : reflection->MutableMessage(message, field);
  }
  message->GetReflection()->SetDouble(message, place.field, value);
}

double to_value(const EffectField& row, double field, const pb::Scene& scene) {
  switch (row.map) {
    case FieldMap::kLinear:
      return row.shift + row.scale * field;
    case FieldMap::kReciprocal:
      return 1 / field;
    case FieldMap::kRatio:
      return (1 + field) * field_value(scene, row.base);
    case FieldMap::kSum:
      return field + field_value(scene, row.base);
  }
  return 0;
}

double to_field(const EffectField& row, double value, const pb::Scene& scene) {
  switch (row.map) {
    case FieldMap::kLinear:
      return (value - row.shift) / row.scale;
    case FieldMap::kReciprocal:
      return 1 / value;
    case FieldMap::kRatio:
      return value / field_value(scene, row.base) - 1;
    case FieldMap::kSum:
      return value - field_value(scene, row.base);
  }
  return 0;
}

/// An inclusion that softens has a name of its own.
constexpr const char* kInclusion = "inclusion";
constexpr const char* kSoftSpot = "soft_spot";
const std::string& table_name(const std::string& effect) {
  static const std::string inclusion = kInclusion;
  return effect == kSoftSpot ? inclusion : effect;
}

/// Rows of an effect, in the order of the table.
std::vector<const EffectField*> rows_of(const std::string& effect) {
  std::vector<const EffectField*> rows;
  for (const EffectField& row : effect_table()) {
    if (row.effect == table_name(effect)) rows.push_back(&row);
  }
  return rows;
}

std::vector<std::string> table_effects() {
  std::vector<std::string> names;
  for (const EffectField& row : effect_table()) {
    if (names.empty() || names.back() != row.effect) names.push_back(row.effect);
  }
  return names;
}

double value_of(const NamedEffect& effect, const std::string& name, double otherwise = 0) {
  const NamedValue* found = effect.find(name);
  return found == nullptr ? otherwise : found->value;
}

double norm_of(const NamedEffect& effect, const std::vector<std::string>& names) {
  double squares = 0;
  for (const std::string& name : names) squares += value_of(effect, name) * value_of(effect, name);
  return std::sqrt(squares);
}

}  // namespace

const NamedValue* NamedEffect::find(const std::string& parameter) const {
  for (const auto* list : {&parameters, &where}) {
    const auto found = std::ranges::find(*list, parameter, &NamedValue::name);
    if (found != list->end()) return &*found;
  }
  return nullptr;
}

std::vector<ParameterName> parameter_names() {
  std::vector<ParameterName> names;
  for (const EffectField& row : effect_table())
    names.push_back({row.effect, row.parameter, row.unit, row.of_place});
  return names;
}

std::vector<NamedEffect> effects_of_scene(const pb::Scene& scene) {
  std::vector<NamedEffect> effects;
  for (const std::string& name : table_effects()) {
    const std::vector<const EffectField*> rows = rows_of(name);
    for (int index = 0; index < entries_of(scene, *rows.front()); ++index) {
      NamedEffect effect{name, {}, {}};
      bool on = false;
      for (const EffectField* row : rows) {
        const double field = field_value(scene, row->path, index);
        on = on || (row->on && field != 0);
        const NamedValue value{row->parameter, row->unit, to_value(*row, field, scene)};
        (row->of_place ? effect.where : effect.parameters).push_back(value);
      }
      if (!on) continue;
      if (name == kInclusion && value_of(effect, "k") < 1) effect.name = kSoftSpot;
      effects.push_back(std::move(effect));
    }
  }
  return effects;
}

void apply_effects(const std::vector<NamedEffect>& effects, pb::Scene& scene) {
  std::vector<std::pair<std::string, int>> entries;  // of repeated fields: how many are set
  for (const NamedEffect& effect : effects) {
    const std::vector<const EffectField*> rows = rows_of(effect.name);
    if (rows.empty()) throw_error("{}: no effect of that name", effect.name);
    int index = 0;
    if (is_repeated(*rows.front())) {
      const std::string& name = table_name(effect.name);
      auto entry = std::ranges::find(entries, name, &std::pair<std::string, int>::first);
      if (entry == entries.end()) {
        entry = entries.insert(entries.end(), {name, 0});
        protobuf::Message* all = scene.mutable_tissue()->mutable_effects();
        all->GetReflection()->ClearField(all, all->GetDescriptor()->FindFieldByName(name));
      }
      index = entry->second++;
    }
    for (const auto* list : {&effect.parameters, &effect.where}) {
      for (const NamedValue& value : *list) {
        const auto row = std::ranges::find(rows, value.name, &EffectField::parameter);
        if (row == rows.end()) {
          throw_error("{}.{}: no parameter of that name", effect.name, value.name);
        }
        set_field(scene, **row, to_field(**row, value.value, scene), index);
      }
    }
  }
}

pb::Scene without_effects(const pb::Scene& scene) {
  pb::Scene base = scene;
  for (const EffectField& row : effect_table()) {
    protobuf::Message* message = &base;
    const std::vector<std::string> steps = steps_of(row.path);
    for (const std::string& step : steps) {
      const bool repeated = step.ends_with("[]");
      const auto* field = message->GetDescriptor()->FindFieldByName(
          repeated ? step.substr(0, step.size() - 2) : step);
      const auto* reflection = message->GetReflection();
      if (repeated || field->message_type() == nullptr) {
        reflection->ClearField(message, field);
        break;
      }
      if (!reflection->HasField(*message, field)) break;
      message = reflection->MutableMessage(message, field);
    }
  }
  return base;
}

std::vector<NamedValue> derived_values(const NamedEffect& effect) {
  std::vector<NamedValue> values;
  const auto add = [&](const char* name, const char* unit, double value) {
    values.push_back({name, unit, value});
  };
  if (table_name(effect.name) == kInclusion)
    add("k_r2", "m2", value_of(effect, "k") * value_of(effect, "r") * value_of(effect, "r"));
  if (effect.name == "adhesion") {
    // Work of separation k d^2 / 4 with d the length at which the spring breaks.
    const double d = std::numbers::sqrt2 * value_of(effect, "delta_c");
    add("G", "J/m2", value_of(effect, "k") * d * d / 4);
  }
  if (effect.name == "gravity_tilt") add("tilt", "rad", norm_of(effect, {"tilt_x", "tilt_y"}));
  if (effect.name == "grasp_offset") add("offset", "m", norm_of(effect, {"x", "y"}));
  if (effect.name == "jaw_orientation")
    add("angle", "rad", norm_of(effect, {"roll", "tilt", "lean"}));
  if (effect.name == "registration") {
    add("offset", "m", norm_of(effect, {"x", "y", "z"}));
    add("angle", "rad", norm_of(effect, {"turn_x", "turn_y", "turn_z"}));
  }
  if (effect.name == "rest_shape") {
    // The principal curvature of the largest size.
    const double mean = 0.5 * (value_of(effect, "kappa_x") + value_of(effect, "kappa_y"));
    const double half = 0.5 * (value_of(effect, "kappa_x") - value_of(effect, "kappa_y"));
    const double twist = value_of(effect, "twist");
    const double reach = std::sqrt(half * half + twist * twist);
    add("kappa", "1/m", mean < 0 ? mean - reach : mean + reach);
  }
  if (effect.name == "tool_backlash") {
    add("b", "m",
        std::max({value_of(effect, "b_x"), value_of(effect, "b_y"), value_of(effect, "b_z")}));
  }
  if (effect.name == "tool_compliance") {
    add("C", "m/N",
        std::max({value_of(effect, "C_x"), value_of(effect, "C_y"), value_of(effect, "C_z")}));
  }
  if (effect.name == "anchor_detachment")
    add("length", "m", value_of(effect, "to") - value_of(effect, "from"));
  return values;
}

}  // namespace omentum
