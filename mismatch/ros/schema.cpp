#include "mismatch/ros/schema.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <map>
#include <optional>

#include "core/table.h"

namespace omentum {
namespace {

constexpr std::size_t kMostText = 1 << 20;
constexpr std::size_t kMostCount = 1 << 30;
constexpr std::size_t kDeepest = 20;

std::optional<RosNumber> number_named(std::string_view name, RosVersion version) {
  static const std::map<std::string_view, RosNumber> kNumbers = {
      {"bool", RosNumber::kBool},       {"int8", RosNumber::kInt8},
      {"uint8", RosNumber::kUint8},     {"int16", RosNumber::kInt16},
      {"uint16", RosNumber::kUint16},   {"int32", RosNumber::kInt32},
      {"uint32", RosNumber::kUint32},   {"int64", RosNumber::kInt64},
      {"uint64", RosNumber::kUint64},   {"float32", RosNumber::kFloat32},
      {"float64", RosNumber::kFloat64}, {"char", RosNumber::kUint8}};
  // A byte has a sign in ROS 1 only.
  if (name == "byte") return version == RosVersion::kOne ? RosNumber::kInt8 : RosNumber::kUint8;
  const auto found = kNumbers.find(name);
  if (found == kNumbers.end()) return std::nullopt;
  return found->second;
}

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view kBlanks = " \t\r";
  const std::size_t begin = text.find_first_not_of(kBlanks);
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(kBlanks) + 1 - begin);
}

/// The text up to a blank; what follows stays.
std::string_view take_word(std::string_view& text) {
  text = trimmed(text);
  const std::size_t end = std::min(text.find_first_of(" \t"), text.size());
  const std::string_view word = text.substr(0, end);
  text = trimmed(text.substr(end));
  return word;
}

bool is_name(std::string_view text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  });
}

std::optional<std::size_t> count_in(std::string_view text) {
  std::size_t count = 0;
  const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), count);
  if (code != std::errc() || end != text.data() + text.size() || count > kMostCount)
    return std::nullopt;
  return count;
}

/// A field whose type is still a name.
struct Line {
  RosField field;
  std::string type;
  std::size_t number = 0;  ///< of the line
};
struct Definition {
  std::string name;
  std::vector<Line> lines;
};

class Parser {
 public:
  explicit Parser(RosVersion version) : version_(version) {}

  Result<RosSchema> parse(std::string_view name, std::string_view text) {
    if (text.size() > kMostText) return Failure{"a definition of more than 1 MB"};
    std::vector<Definition> definitions = {{short_ros_name(name), {}}};
    std::size_t number = 0;
    bool header = false;
    while (!text.empty()) {
      ++number;
      const std::size_t end = std::min(text.find('\n'), text.size());
      std::string_view line = trimmed(text.substr(0, end));
      text.remove_prefix(std::min(end + 1, text.size()));
      if (line.starts_with("===")) {
        header = true;
        continue;
      }
      if (line.empty() || line.front() == '#') continue;
      if (header) {
        if (!line.starts_with("MSG:"))
          return Failure{fmt::format("line {}: \"{}\", needed MSG: package/Type", number,
                                     shown(std::string(line)))};
        definitions.push_back({short_ros_name(trimmed(line.substr(4))), {}});
        header = false;
        continue;
      }
      if (!add_field(line, number, definitions.back())) return Failure{error_};
    }
    return resolve(definitions);
  }

 private:
  bool fail(std::size_t line, const std::string& what) {
    error_ = fmt::format("line {}: {}", line, what);
    return false;
  }

  bool add_field(std::string_view text, std::size_t number, Definition& definition) {
    const std::string whole = shown(std::string(text));
    std::string_view type = take_word(text);
    const std::size_t name_end = std::min(text.find_first_of(" \t=#"), text.size());
    const std::string_view name = text.substr(0, name_end);
    const std::string_view rest = trimmed(text.substr(name_end));
    if (!is_name(name)) return fail(number, fmt::format("\"{}\", needed type and name", whole));
    if (rest.starts_with('=')) return true;  // a constant takes no part in messages
    if (version_ == RosVersion::kOne && !rest.empty() && rest.front() != '#')
      return fail(number, fmt::format("\"{}\": something behind the name", whole));
    Line line;
    line.number = number;
    line.field.name = name;
    if (type.ends_with(']')) {
      const std::size_t open = type.rfind('[');
      if (open == std::string_view::npos) return fail(number, fmt::format("\"{}\"", whole));
      std::string_view count = type.substr(open + 1, type.size() - open - 2);
      type = type.substr(0, open);
      line.field.shape = RosField::kOpen;
      const bool bounded = count.starts_with("<=");
      if (bounded) count.remove_prefix(2);
      if (!count.empty() || bounded) {
        const auto found = count_in(count);
        if (!found || *found == 0) return fail(number, fmt::format("\"{}\": count", whole));
        if (!bounded) {
          line.field.shape = RosField::kFixed;
          line.field.count = *found;
        }
      }
    }
    if (const std::size_t bound = type.find("<="); bound != std::string_view::npos) {
      if (!type.substr(0, bound).ends_with("string") || !count_in(type.substr(bound + 2)))
        return fail(number, fmt::format("\"{}\": bound", whole));
      type = type.substr(0, bound);
    }
    if (type == "wstring" || type == "wchar")
      return fail(number, fmt::format("{}: wide strings are not read", name));
    if (type == "string") {
      line.field.kind = RosField::kText;
    } else if (const auto known = number_named(type, version_)) {
      line.field.number = *known;
    } else {
      line.field.kind = RosField::kMessage;
      line.type = short_ros_name(type);
      if (line.type == "Header") line.type = "std_msgs/Header";
    }
    definition.lines.push_back(std::move(line));
    return true;
  }

  /// Seconds and their fraction, which every dialect knows without a definition.
  void add_times(std::vector<Definition>& definitions) const {
    const bool one = version_ == RosVersion::kOne;
    const auto add = [&](const char* name, RosNumber seconds, RosNumber fraction) {
      if (std::any_of(definitions.begin(), definitions.end(),
                      [&](const Definition& d) { return d.name == name; }))
        return;
      Definition time{name, {}};
      time.lines.resize(2);
      time.lines[0].field.name = "sec";
      time.lines[0].field.number = seconds;
      time.lines[1].field.name = "nanosec";
      time.lines[1].field.number = fraction;
      definitions.push_back(time);
    };
    add(one ? "time" : "builtin_interfaces/Time", one ? RosNumber::kUint32 : RosNumber::kInt32,
        RosNumber::kUint32);
    add(one ? "duration" : "builtin_interfaces/Duration", RosNumber::kInt32,
        one ? RosNumber::kInt32 : RosNumber::kUint32);
  }

  Result<RosSchema> resolve(std::vector<Definition>& definitions) {
    add_times(definitions);
    std::map<std::string_view, std::size_t> places;
    for (std::size_t k = 0; k < definitions.size(); ++k) places.emplace(definitions[k].name, k);
    RosSchema schema;
    for (const Definition& definition : definitions) {
      RosType& type = schema.types.emplace_back();
      type.name = definition.name;
      const std::string package =
          definition.name.substr(0, std::min(definition.name.find('/'), definition.name.size()));
      for (const Line& line : definition.lines) {
        type.fields.push_back(line.field);
        if (line.field.kind != RosField::kMessage) continue;
        auto found = places.find(line.type);
        if (found == places.end()) found = places.find(package + "/" + line.type);
        if (found == places.end()) {
          return Failure{fmt::format("line {}: type {} of {} is not defined", line.number,
                                     shown(line.type), line.field.name)};
        }
        type.fields.back().type = found->second;
      }
      if (type.fields.empty() && version_ == RosVersion::kTwo)
        type.fields.push_back({"structure_needs_at_least_one_member", RosField::kNumber,
                               RosField::kOne, RosNumber::kUint8});
    }
    heights_.assign(schema.types.size(), kNotMeasured);
    for (std::size_t k = 0; k < schema.types.size(); ++k) {
      if (!measure(schema, k, 1)) return Failure{error_};
    }
    return schema;
  }

  /// Fills in least_bytes; false where a type holds itself, or an array nothing.
  bool measure(RosSchema& schema, std::size_t at, std::size_t depth) {
    if (heights_[at] != kNotMeasured && heights_[at] != kInHand) return true;
    if (heights_[at] == kInHand || depth > kDeepest) return fail_deep(schema.types[at].name);
    heights_[at] = kInHand;
    std::size_t bytes = 0, height = 1;
    for (const RosField& field : schema.types[at].fields) {
      std::size_t one = field.kind == RosField::kNumber ? bytes_of(field.number) : 4;
      if (field.kind == RosField::kMessage) {
        if (!measure(schema, field.type, depth + 1)) return false;
        height = std::max(height, heights_[field.type] + 1);
        one = schema.types[field.type].least_bytes;
        if (one == 0 && field.shape != RosField::kOne) {
          error_ = fmt::format("{} of {}: an array of messages without fields", field.name,
                               schema.types[at].name);
          return false;
        }
      }
      // Far beyond any message; products stay small.
      bytes = std::min(bytes + (field.shape == RosField::kOpen ? 4 : one * field.count),
                       std::size_t{1} << 40);
    }
    if (height > kDeepest) return fail_deep(schema.types[at].name);
    schema.types[at].least_bytes = std::min(bytes, std::size_t{1} << 32);
    heights_[at] = height;
    return true;
  }

  bool fail_deep(const std::string& name) {
    error_ = fmt::format("type {} holds itself, or more than {} levels of others", shown(name),
                         kDeepest);
    return false;
  }

  static constexpr std::size_t kNotMeasured = 0, kInHand = ~std::size_t{0};
  std::vector<std::size_t> heights_;  ///< of each type: levels of messages in it
  RosVersion version_;
  std::string error_;
};

}  // namespace

std::size_t bytes_of(RosNumber number) {
  switch (number) {
    case RosNumber::kBool:
    case RosNumber::kInt8:
    case RosNumber::kUint8:
      return 1;
    case RosNumber::kInt16:
    case RosNumber::kUint16:
      return 2;
    case RosNumber::kInt32:
    case RosNumber::kUint32:
    case RosNumber::kFloat32:
      return 4;
    default:
      return 8;
  }
}

std::string short_ros_name(std::string_view name) {
  std::string text(name);
  const std::size_t middle = text.find("/msg/");
  if (middle != std::string::npos) text.erase(middle, 4);
  return text;
}

Result<RosSchema> parse_ros_schema(std::string_view name, std::string_view text,
                                   RosVersion version) {
  return Parser(version).parse(name, text);
}

}  // namespace omentum
