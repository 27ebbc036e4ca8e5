// Text to messages: what protobuf's parser says is told with what would be right.
#include <fmt/format.h>
#include <google/protobuf/io/tokenizer.h>

#include <cmath>
#include <optional>
#include <set>
#include <vector>

#include "core/check.h"
#include "core/config_parts.h"
#include "core/csv.h"

namespace omentum::config_parts {
namespace {

namespace protobuf = google::protobuf;
using protobuf::Descriptor;
using protobuf::EnumDescriptor;
using protobuf::FieldDescriptor;

/// Keeps the first error with its place.
class FirstError : public protobuf::io::ErrorCollector {
 public:
  void AddError(int line, int column, const std::string& message) override {
    if (text_.empty()) text_ = message, line_ = line, column_ = column;
  }
  const std::string& text() const { return text_; }
  int line() const { return line_; }
  int column() const { return column_; }

 private:
  std::string text_;
  int line_ = 0, column_ = 0;
};

/// What stands between `before` and the next `after`; empty if it does not.
std::string part_of(const std::string& text, const std::string& before, const std::string& after) {
  const std::size_t at = text.find(before);
  if (at == std::string::npos) return {};
  const std::size_t begin = at + before.size();
  return text.substr(begin, text.find(after, begin) - begin);
}

/// The enum of a field of this name, wherever in a message it is; null if there is none.
const EnumDescriptor* find_enum(const Descriptor& message, const std::string& name,
                                std::set<const Descriptor*>& seen) {
  if (!seen.insert(&message).second) return nullptr;
  for (int i = 0; i < message.field_count(); ++i) {
    const FieldDescriptor& field = *message.field(i);
    const EnumDescriptor* found = field.name() == name ? field.enum_type() : nullptr;
    if (found == nullptr && field.message_type() != nullptr)
      found = find_enum(*field.message_type(), name, seen);
    if (found != nullptr) return found;
  }
  return nullptr;
}

/// The parser's reason, behind it the values that the enum allows. No two enum fields of one name
/// differ in type (tests/core/config_test.cpp).
std::string with_allowed(const std::string& reason, const Descriptor& message,
                         const FieldDescriptor* field) {
  const EnumDescriptor* of = field != nullptr ? field->enum_type() : nullptr;
  std::set<const Descriptor*> seen;
  if (of == nullptr && reason.starts_with("Unknown enumeration value"))
    of = find_enum(message, part_of(reason, "field \"", "\""), seen);
  if (of == nullptr) return reason;
  std::vector<std::string> values;
  for (int k = 0; k < of->value_count(); ++k) values.push_back(of->value(k)->name());
  return fmt::format("{} Allowed: {}", reason, fmt::join(values, ", "));
}

/// Writes a whole number such as 1e6, of which the parser complains in that line, in digits; false
/// if it does not complain of one.
bool write_in_digits(const FirstError& error, std::string& text) {
  constexpr double kExact = 9007199254740992;  // 2^53: whole numbers below are exact
  const std::string token = part_of(error.text(), "Expected integer, got: ", "\n");
  const std::optional<double> number = parse_number(token);
  if (!number || !(std::abs(*number) <= kExact) || std::trunc(*number) != *number) return false;
  std::size_t line = 0;
  for (int k = 0; k < error.line(); ++k) line = text.find('\n', line) + 1;
  const std::size_t at = text.find(token, line);
  if (at == std::string::npos) return false;
  text.replace(at, token.size(), fmt::format("{:.0f}", *number));
  return true;
}

}  // namespace

std::string parse_text(std::string text, protobuf::Message& message, const FieldDescriptor* field,
                       std::unique_ptr<ParseInfoTree>* places) {
  const std::unique_ptr<protobuf::Message> before(message.New());
  before->CopyFrom(message);
  while (true) {
    FirstError error;
    protobuf::TextFormat::Parser parser;
    parser.RecordErrorsTo(&error);
    if (places != nullptr) {
      *places = std::make_unique<ParseInfoTree>();
      parser.WriteLocationsTo(places->get());
    }
    const bool parsed = field == nullptr ? parser.MergeFromString(text, &message)
                                         : parser.ParseFieldValueFromString(text, field, &message);
    if (parsed) return {};
    message.CopyFrom(*before);
    if (write_in_digits(error, text)) continue;
    if (error.text().empty()) return "more than one value";
    const std::string reason = with_allowed(error.text(), *message.GetDescriptor(), field);
    return field != nullptr
               ? reason
               : fmt::format("{}:{}: {}", error.line() + 1, error.column() + 1, reason);
  }
}

void apply_override(pb::Config& config, const std::string& assignment) {
  // One line, whatever it holds.
  std::string told;
  for (const char c : "--set " + assignment)
    told += c == '\n' ? std::string("\\n") : std::string{c};
  const std::size_t equals = assignment.find('=');
  if (equals == std::string::npos || equals == 0) throw_error("{}: expected a.b=value", told);
  const std::string path = assignment.substr(0, equals);
  const std::string value = assignment.substr(equals + 1);
  pb::Config fresh;
  protobuf::Message* message = &fresh;
  for (std::size_t start = 0, dot = 0;; start = dot + 1) {
    dot = path.find('.', start);
    const std::string name = path.substr(start, dot == std::string::npos ? dot : dot - start);
    const Descriptor& descriptor = *message->GetDescriptor();
    const FieldDescriptor* field = descriptor.FindFieldByName(name);
    if (field == nullptr) {
      std::string names;
      for (int i = 0; i < descriptor.field_count(); ++i)
        names += (i == 0 ? "" : ", ") + descriptor.field(i)->name();
      throw_error("{}: {} has no field named \"{}\", allowed: {}", told, descriptor.name(), name,
                  names);
    }
    if (dot == std::string::npos) {
      if (field->cpp_type() == FieldDescriptor::CPPTYPE_STRING) {
        message->GetReflection()->SetString(message, field, value);
      } else {
        const std::string error = parse_text(value, *message, field);
        if (!error.empty()) throw_error("{}: {}", told, error);
      }
      break;
    }
    if (field->cpp_type() != FieldDescriptor::CPPTYPE_MESSAGE)
      throw_error("{}: {} has no parts", told, path.substr(0, dot));
    if (field->is_repeated()) {
      throw_error("{}: {} is a list; set a whole entry as {}={{ ... }}", told, name,
                  path.substr(0, dot));
    }
    message = message->GetReflection()->MutableMessage(message, field);
  }
  config.MergeFrom(fresh);
}

}  // namespace omentum::config_parts
