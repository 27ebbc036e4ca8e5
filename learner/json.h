#pragma once

#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

namespace omentum {

/// JSON of a run's files: members stay in the order in which they were added.
using Json = nlohmann::ordered_json;

/// Whole numbers without a point, others as the shortest text that reads back the same; what is not
/// finite becomes null.
inline Json json_number(double value) {
  constexpr double kExact = 9007199254740992;  // 2^53: whole numbers below are exact
  if (std::trunc(value) == value && std::abs(value) < kExact)
    return static_cast<std::int64_t>(value);
  return value;
}

/// The text of a document, `indent` blanks per level or in one line (-1). Bytes that are no UTF-8
/// become U+FFFD.
inline std::string json_text(const Json& json, int indent) {
  return json.dump(indent, ' ', false, Json::error_handler_t::replace);
}

}  // namespace omentum
