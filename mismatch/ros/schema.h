#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

// Definitions of ROS messages, as a bag (.mcap) holds them: the text of the message itself, then of
// every message in it behind a line of "===" and "MSG: package/Type".

enum class RosNumber : std::uint8_t {
  kBool,
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kFloat32,
  kFloat64
};
std::size_t bytes_of(RosNumber number);

struct RosField {
  enum Kind : std::uint8_t { kNumber, kText, kMessage };
  enum Shape : std::uint8_t { kOne, kFixed, kOpen };  ///< a bounded array is an open one
  std::string name;
  Kind kind = kNumber;
  Shape shape = kOne;
  RosNumber number = RosNumber::kFloat64;
  std::size_t count = 1;  ///< of a fixed array
  std::size_t type = 0;   ///< of a message: its place in RosSchema::types
};

struct RosType {
  std::string name;  ///< package/Type
  std::vector<RosField> fields;
  std::size_t least_bytes = 0;  ///< that one takes in a message
};

/// ROS 1 has `time` and `duration`; ROS 2 strings with a bound, defaults, and a byte in an empty
/// message.
enum class RosVersion { kOne, kTwo };

struct RosSchema {
  std::vector<RosType> types;  ///< the first one is the message itself
};

/// "sensor_msgs/msg/Image" and "sensor_msgs/Image" are the latter.
std::string short_ros_name(std::string_view name);

/// Total over any text of up to 1 MB; fails with one line, "line 3: ...": a type that is not
/// defined, one that holds itself, wide strings (whose width differs between writers).
Result<RosSchema> parse_ros_schema(std::string_view name, std::string_view text,
                                   RosVersion version);

}  // namespace omentum
