#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "mismatch/ros/schema.h"

namespace omentum {

/// A part of a ROS message. It refers to the bytes and the schema that it was decoded from.
struct RosValue {
  enum Kind : std::uint8_t { kNumber, kText, kNumbers, kList, kMessage };
  Kind kind = kNumber;
  RosNumber type = RosNumber::kFloat64;  ///< of numbers
  bool swapped = false;                  ///< of numbers: not in the byte order of this machine
  double number = 0;                     ///< whole ones are exact up to 2^53
  std::string_view bytes;                ///< text, or an array of numbers as it is in the message
  const RosType* message = nullptr;
  std::vector<RosValue> items;  ///< fields in the order of `message`, or a list of messages, texts

  /// How many numbers an array has; 1 of a number.
  std::size_t size() const { return kind == kNumbers ? bytes.size() / bytes_of(type) : 1; }
  /// The k-th of an array of numbers.
  double at(std::size_t k) const;
  /// A field of a message; null where it has none of this name, or this is no message.
  const RosValue* find(std::string_view name) const;
  /// "header.stamp.sec": a field of a field. Throws Error naming the path.
  const RosValue& get(std::string_view path) const;
  // The same of a number, a text, an array of numbers.
  double number_at(std::string_view path) const;
  std::string_view text_at(std::string_view path) const;
  const RosValue& numbers_at(std::string_view path) const;
};

/// How messages of a channel are written: packed (`ros1`), or aligned with a header that says the
/// byte order (`cdr`).
enum class RosEncoding { kRos1, kCdr };

/// Total over any bytes; fails with one line: bytes that end too soon or go on, a header of `cdr`
/// that is not known, more than a million parts.
Result<RosValue> decode_ros_message(const RosSchema& schema, RosEncoding encoding,
                                    std::string_view bytes);

}  // namespace omentum
