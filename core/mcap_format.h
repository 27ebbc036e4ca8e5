#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

// Byte level of MCAP, shared by writer and reader: little-endian numbers, length-prefixed strings,
// records.

namespace omentum::mcap {

inline constexpr std::string_view kMagic{"\x89MCAP0\r\n", 8};

/// Record types. Values are those of the specification: do not change.
enum Opcode : std::uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kChunkIndex = 0x08,
  kStatistics = 0x0B,
  kSummaryOffset = 0x0E,
  kDataEnd = 0x0F,
};

/// Appends values to a byte string.
template <typename Number>
void put(std::string& out, Number value) {
  char raw[sizeof(Number)];
  std::memcpy(raw, &value, sizeof(Number));
  out.append(raw, sizeof(Number));
}

inline void put_string(std::string& out, std::string_view text) {
  put(out, static_cast<std::uint32_t>(text.size()));
  out.append(text);
}

inline std::string make_record(Opcode opcode, std::string_view content) {
  std::string record;
  record.reserve(content.size() + 9);
  record.push_back(static_cast<char>(opcode));
  put(record, static_cast<std::uint64_t>(content.size()));
  record.append(content);
  return record;
}

/// Takes values from the front of a view. Once a value does not fit, ok() is false and everything
/// after reads as zero or empty, so callers check once at the end.
class ByteCursor {
 public:
  explicit ByteCursor(std::string_view bytes) : rest_(bytes) {}

  template <typename Number>
  Number get() {
    Number value{};
    if (rest_.size() < sizeof(Number)) return fail(), value;
    std::memcpy(&value, rest_.data(), sizeof(Number));
    rest_.remove_prefix(sizeof(Number));
    return value;
  }

  std::string_view get_bytes(std::uint64_t size) {
    if (size > rest_.size()) return fail(), std::string_view();
    const std::string_view bytes = rest_.substr(0, static_cast<std::size_t>(size));
    rest_.remove_prefix(static_cast<std::size_t>(size));
    return bytes;
  }

  std::string_view get_string() { return get_bytes(get<std::uint32_t>()); }

  std::string_view rest() const { return rest_; }
  bool ok() const { return ok_; }

 private:
  void fail() {
    ok_ = false;
    rest_ = {};
  }

  std::string_view rest_;
  bool ok_ = true;
};

}  // namespace omentum::mcap
