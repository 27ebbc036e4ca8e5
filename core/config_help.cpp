#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <limits>

#include "core/config.h"

namespace omentum {
namespace {

namespace protobuf = google::protobuf;
using protobuf::FieldDescriptor;

/// What a field is without being set: its default, three of a vector.
std::string default_of(const protobuf::Message& defaults, const FieldDescriptor& field) {
  if (field.is_repeated()) return "(none)";
  if (field.containing_oneof() != nullptr) return "(absent)";
  if (field.message_type() != nullptr) {
    // A direction that is not given is none.
    const bool direction = field.options().GetExtension(pb::knob).unit() == "1";
    return direction ? "(absent)" : "{ x: 0 y: 0 z: 0 }";
  }
  std::string value;
  protobuf::TextFormat::PrintFieldValueToString(defaults, &field, -1, &value);
  return value;
}

std::string help_line(const protobuf::Message& defaults, const FieldDescriptor& field,
                      const std::string& path) {
  std::string line = fmt::format("  {} = {}", path, default_of(defaults, field));
  const pb::Knob& knob = field.options().GetExtension(pb::knob);
  if (knob.has_unit() && knob.unit() != "1") line += " " + knob.unit();
  if (knob.has_min() || knob.has_max()) {
    constexpr double kMost = std::numeric_limits<double>::max();
    line += fmt::format("  [{} ... {}]", knob.has_min() ? knob.min() : -kMost,
                        knob.has_max() ? knob.max() : kMost);
  }
  if (knob.has_source()) line += fmt::format("  ({})", knob.source());
  if (knob.has_help()) line += fmt::format("  {}", knob.help());
  if (field.enum_type() != nullptr) {
    line += "  one of:";
    for (int k = 0; k < field.enum_type()->value_count(); ++k)
      line += " " + field.enum_type()->value(k)->name();
  }
  return line + "\n";
}

/// One line per knob of `defaults`, a message of which no field is set.
void add_help(const protobuf::Message& defaults, const std::string& prefix, std::string& out) {
  const protobuf::Descriptor& descriptor = *defaults.GetDescriptor();
  for (int i = 0; i < descriptor.field_count(); ++i) {
    const FieldDescriptor& field = *descriptor.field(i);
    const std::string path = prefix + field.name();
    const protobuf::Descriptor* type = field.message_type();
    if (type == nullptr || type == pb::Vec3::descriptor()) {
      out += help_line(defaults, field, path);
    } else {
      auto& factory = *defaults.GetReflection()->GetMessageFactory();
      add_help(*factory.GetPrototype(type), path + (field.is_repeated() ? "[]." : "."), out);
    }
  }
}

}  // namespace

std::string knob_help() {
  std::string text =
      "Knobs, for --set a.b=value: name = default unit [range] (source) meaning. Without a unit: a "
      "number, a share, a text. An entry of a list, a[], is set as a whole: a={ b: 1 c: 2 }. A "
      "vector is set as a={ x: 1 y: 2 z: 3 }, or one number of it as a.x=1.\n";
  add_help(pb::Config::default_instance(), "", text);
  return text;
}

}  // namespace omentum
