#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace omentum {

/// Builds one JSON document by hand: UTF-8 passes through, control characters, quotes and
/// backslashes are escaped, numbers that are not finite become null, doubles are the shortest text
/// that reads back the same.
///
///   JsonWriter json;
///   json.begin_object().key("steps").value(std::uint64_t{5}).end_object();
class JsonWriter {
 public:
  /// `indent` spaces per level; 0 writes one line.
  explicit JsonWriter(int indent = 2) : indent_(indent) {}

  JsonWriter& begin_object() { return open('{'); }
  JsonWriter& end_object() { return close('}'); }
  JsonWriter& begin_array() { return open('['); }
  JsonWriter& end_array() { return close(']'); }
  JsonWriter& key(std::string_view name);
  JsonWriter& value(std::string_view text);
  JsonWriter& value(const char* text) { return value(std::string_view(text)); }
  JsonWriter& value(double number);
  JsonWriter& value(std::uint64_t number);
  JsonWriter& value(std::int64_t number);
  JsonWriter& value(bool truth);

  /// The document; every object and array must be closed.
  const std::string& text() const;

 private:
  JsonWriter& open(char bracket);
  JsonWriter& close(char bracket);
  void separate();
  void break_line();
  void quote(std::string_view text);

  int indent_ = 2;
  std::string text_;
  std::vector<bool> filled_;  ///< per open level: something was written
  bool after_key_ = false;
};

}  // namespace omentum
