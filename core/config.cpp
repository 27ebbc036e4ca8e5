#include "core/config.h"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <memory>
#include <sstream>

#include "core/check.h"
#include "core/config_parts.h"
#include "core/hash.h"
#include "core/read_file.h"
#include "core/scene_files.h"

namespace omentum {
namespace {

namespace protobuf = google::protobuf;
using protobuf::FieldDescriptor;

using config_parts::ParseInfoTree;

/// Throws Error for a number outside its knob's range or NaN. `places` tells where in `file` a
/// field was given; null = the message is not from a file.
void check_knobs(const protobuf::Message& message, const std::string& prefix = "",
                 const std::string& file = "", const ParseInfoTree* places = nullptr);

/// Errors of syntax and numbers outside their knob's range, both with file:line:column.
void merge_text(const std::string& name, const std::string& text, protobuf::Message& message) {
  std::unique_ptr<ParseInfoTree> places;
  const std::unique_ptr<protobuf::Message> fresh(message.New());
  const std::string error = config_parts::parse_text(text, *fresh, nullptr, &places);
  if (!error.empty()) throw_error("{}:{}", name, error);
  const bool is_scene = message.GetDescriptor() == pb::Scene::descriptor();
  check_knobs(*fresh, is_scene ? "scene" : "", name, places.get());
  message.MergeFrom(*fresh);
}

std::string text_of_file(const std::string& path) {
  Result<std::string> text = read_file(path);
  if (!text) throw_error("{}", text.error());
  return std::move(text).value();
}

/// Messages that always exist; all others only when the scene names them (a mesh, a box, a pose).
bool always_present(const FieldDescriptor& field) {
  static const char* const names[] = {"omentum.pb.Config.scene",      "omentum.pb.Config.task",
                                      "omentum.pb.Config.grasp",      "omentum.pb.Config.defects",
                                      "omentum.pb.Config.rollout",    "omentum.pb.Config.ppo",
                                      "omentum.pb.Config.evaluation", "omentum.pb.Config.run",
                                      "omentum.pb.Scene.tool",        "omentum.pb.Tissue.cluster"};
  return std::any_of(std::begin(names), std::end(names),
                     [&](const char* n) { return field.full_name() == n; });
}

/// Writes every default explicitly, so that the printed configuration is complete.
void fill_defaults(protobuf::Message& message) {
  const auto* descriptor = message.GetDescriptor();
  const auto* reflection = message.GetReflection();
  for (int i = 0; i < descriptor->field_count(); ++i) {
    const FieldDescriptor* field = descriptor->field(i);
    if (field->is_repeated()) {
      if (field->cpp_type() != FieldDescriptor::CPPTYPE_MESSAGE) continue;
      for (int k = 0; k < reflection->FieldSize(message, field); ++k) {
        fill_defaults(*reflection->MutableRepeatedMessage(&message, field, k));
      }
      continue;
    }
    if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
      if (reflection->HasField(message, field) || always_present(*field)) {
        fill_defaults(*reflection->MutableMessage(&message, field));
      }
      continue;
    }
    if (reflection->HasField(message, field) || field->containing_oneof() != nullptr) continue;
    // The value of a field that is not set is its default.
    std::string value;
    protobuf::TextFormat::PrintFieldValueToString(message, field, -1, &value);
    OMENTUM_CHECK(protobuf::TextFormat::ParseFieldValueFromString(value, field, &message));
  }
}

bool numeric_value(const protobuf::Message& message, const FieldDescriptor* field, double& value) {
  const auto* reflection = message.GetReflection();
  switch (field->cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE:
      value = reflection->GetDouble(message, field);
      return true;
    case FieldDescriptor::CPPTYPE_UINT32:
      value = reflection->GetUInt32(message, field);
      return true;
    case FieldDescriptor::CPPTYPE_UINT64:
      value = static_cast<double>(reflection->GetUInt64(message, field));
      return true;
    default:
      return false;
  }
}

void check_finite_vector(const protobuf::Message& message, const std::string& path) {
  const auto* vector = dynamic_cast<const pb::Vec3*>(&message);
  if (vector == nullptr) return;
  for (const double v : {vector->x(), vector->y(), vector->z()}) {
    // 100 m: nothing in a scene is larger; a coordinate beyond it is a unit mistake or not a
    // number.
    if (!(v >= -100 && v <= 100)) throw_error("{}: component {}, allowed -100 ... 100", path, v);
  }
}

void check_knobs(const protobuf::Message& message, const std::string& prefix,
                 const std::string& file, const ParseInfoTree* places) {
  const auto* reflection = message.GetReflection();
  std::vector<const FieldDescriptor*> fields;
  reflection->ListFields(message, &fields);
  for (const FieldDescriptor* field : fields) {
    const std::string path = prefix.empty() ? field->name() : prefix + "." + field->name();
    const auto nested = [&](int index) {
      return places == nullptr ? nullptr : places->GetTreeForNested(field, index);
    };
    const auto place_of = [&](int index) -> std::string {
      if (places == nullptr) return "";
      const auto at = places->GetLocation(field, index);
      return fmt::format("{}:{}:{}: ", file, at.line + 1, at.column + 1);
    };
    if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
      if (!field->is_repeated()) {
        check_finite_vector(reflection->GetMessage(message, field), place_of(-1) + path);
        check_knobs(reflection->GetMessage(message, field), path, file, nested(-1));
        continue;
      }
      for (int i = 0; i < reflection->FieldSize(message, field); ++i) {
        check_knobs(reflection->GetRepeatedMessage(message, field, i),
                    fmt::format("{}[{}]", path, i), file, nested(i));
      }
      continue;
    }
    double value = 0;
    if (field->is_repeated() || !numeric_value(message, field, value)) continue;
    const std::string place = place_of(-1);
    if (field->options().HasExtension(pb::knob)) {
      const pb::Knob& knob = field->options().GetExtension(pb::knob);
      const double min = knob.has_min() ? knob.min() : std::numeric_limits<double>::lowest();
      const double max = knob.has_max() ? knob.max() : std::numeric_limits<double>::max();
      if (!(value >= min && value <= max)) {
        throw_error("{}{}: {}{}{}, allowed {} ... {}", place, path, value,
                    knob.has_unit() ? " " : "", knob.unit(), min, max);
      }
    } else if (!(value == value)) {
      throw_error("{}{}: not a number", place, path);
    }
  }
}

}  // namespace

std::string deploy_dir() {
  // NOLINTNEXTLINE(concurrency-mt-unsafe): read at start, before any thread is made
  if (const char* given = std::getenv("OMENTUM_DEPLOY_DIR")) return given;
  std::error_code error;
  std::filesystem::path folder =
      std::filesystem::read_symlink("/proc/self/exe", error).parent_path();
  for (; folder.has_relative_path(); folder = folder.parent_path()) {
    if (std::filesystem::exists(folder / "deploy" / "presets")) return (folder / "deploy").string();
  }
  throw_error("OMENTUM_DEPLOY_DIR: not set, and no folder deploy/presets above the executable");
}

std::vector<std::string> preset_names() {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(deploy_dir() + "/presets")) {
    if (entry.path().extension() == ".txtpb") names.push_back(entry.path().stem().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

pb::Config load_config(const std::string& preset, std::span<const std::string> overrides) {
  const std::vector<std::string> names = preset_names();
  if (std::find(names.begin(), names.end(), preset) == names.end()) {
    throw_error("preset: {}, allowed: {}", preset, fmt::format("{}", fmt::join(names, ", ")));
  }
  pb::Config config;
  const std::string common = deploy_dir() + "/common.txtpb";
  if (std::filesystem::exists(common)) read_text_proto(common, config);
  read_text_proto(deploy_dir() + "/presets/" + preset + ".txtpb", config);
  config.set_preset(preset);
  for (const std::string& assignment : overrides) {
    if (assignment.starts_with("preset="))
      throw_error("{}: no knob of a run: --preset {}", assignment, assignment.substr(7));
    if (assignment.rfind("scene_file=", 0) == 0) config_parts::apply_override(config, assignment);
  }
  if (!config.scene_file().empty()) {
    pb::Scene scene;
    read_text_proto(scene_path(config), scene);
    scene.MergeFrom(config.scene());
    *config.mutable_scene() = scene;
  }
  for (const std::string& assignment : overrides) config_parts::apply_override(config, assignment);
  fill_defaults(config);
  check_knobs(config);
  try {
    fill_mesh_contents(*config.mutable_scene(), scene_directory(config));
  } catch (const Error& error) {
    throw_error("{}{}", place_in_scene(scene_path(config), error.what()), error.what());
  }
  return config;
}

pb::Config parse_config(const std::string& name, const std::string& text) {
  pb::Config config;
  merge_text(name, text, config);
  fill_defaults(config);
  check_knobs(config);
  return config;
}

pb::Scene load_scene(const std::string& path, std::span<const std::string> overrides) {
  pb::Scene scene;
  read_text_proto(path, scene);
  return override_scene(scene, overrides);
}

pb::Scene override_scene(const pb::Scene& scene, std::span<const std::string> overrides) {
  pb::Config config;
  *config.mutable_scene() = scene;
  for (const std::string& assignment : overrides) config_parts::apply_override(config, assignment);
  fill_defaults(config);
  check_knobs(config);
  return config.scene();
}

std::string scene_path(const pb::Config& config) {
  const std::string& file = config.scene_file();
  if (file.empty() || file.front() == '/') return file;
  return deploy_dir() + "/scenes/" + file;
}

std::string scene_directory(const pb::Config& config) {
  const std::string path = scene_path(config);
  if (path.empty()) return deploy_dir() + "/scenes";
  return std::filesystem::path(path).parent_path().string();
}

std::string place_in_scene(const std::string& path, const std::string& error) {
  const std::string knob = error.substr(0, error.find(':'));
  if (knob.rfind("scene.", 0) != 0) return "";
  return place_of_field(path, pb::Scene::default_instance(), knob.substr(6));
}

std::string place_of_field(const std::string& file, const protobuf::Message& kind,
                           const std::string& wanted) {
  if (!std::filesystem::is_regular_file(file)) return "";
  return place_in_text(file, text_of_file(file), kind, wanted);
}

std::string place_in_text(const std::string& name, const std::string& text,
                          const protobuf::Message& kind, const std::string& wanted) {
  std::unique_ptr<ParseInfoTree> places;
  const std::unique_ptr<protobuf::Message> message(kind.New());
  if (!config_parts::parse_text(text, *message, nullptr, &places).empty()) return "";
  std::string place;
  const ParseInfoTree* tree = places.get();
  const protobuf::Descriptor* descriptor = kind.GetDescriptor();
  std::istringstream parts(wanted);
  for (std::string part; tree != nullptr && std::getline(parts, part, '.');) {
    const std::size_t bracket = part.find('[');
    const FieldDescriptor* field =
        descriptor == nullptr ? nullptr : descriptor->FindFieldByName(part.substr(0, bracket));
    if (field == nullptr || field->is_repeated() != (bracket != std::string::npos)) break;
    const int index = field->is_repeated() ? std::atoi(part.c_str() + bracket + 1) : -1;
    const auto at = tree->GetLocation(field, index);
    if (at.line < 0) break;
    place = fmt::format("{}:{}:{}: ", name, at.line + 1, at.column + 1);
    tree = tree->GetTreeForNested(field, index);
    descriptor = field->message_type();
  }
  return place;
}

void read_text_proto(const std::string& path, protobuf::Message& message) {
  merge_text(path, text_of_file(path), message);
}

void parse_text_proto(const std::string& name, const std::string& text,
                      protobuf::Message& message) {
  merge_text(name, text, message);
}

void check_ranges(const protobuf::Message& message, const std::string& prefix) {
  check_knobs(message, prefix);
}

std::string print_config(const pb::Config& config) {
  protobuf::TextFormat::Printer printer;
  std::string text;
  OMENTUM_CHECK(printer.PrintToString(config, &text));
  return text;
}

std::uint64_t config_hash(const pb::Config& config) {
  pb::Config relevant = config;
  relevant.clear_run();
  relevant.clear_preset();
  relevant.clear_scene_file();
  relevant.clear_evaluation();
  relevant.clear_report();
  relevant.mutable_scene()->clear_name();
  relevant.mutable_scene()->clear_source();
  return fnv1a64(print_config(relevant));
}

}  // namespace omentum
