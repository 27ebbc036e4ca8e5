#pragma once

#include <charconv>
#include <cmath>
#include <span>
#include <string_view>

namespace omentum {

/// Writes JSON into memory given to it as the robot does: compact, doubles with 17 significant
/// digits, `1.0` for a whole number, null for one that is not finite. No allocation. Once the
/// memory is full nothing more is written and size() is 0.
class JsonWriter {
 public:
  explicit JsonWriter(std::span<char> memory) : memory_(memory) {}
  std::size_t size() const { return full_ ? 0 : size_; }
  std::string_view text() const { return {memory_.data(), size()}; }

  void put(std::string_view text) {
    full_ |= text.size() > memory_.size() - size_;
    if (full_) return;
    text.copy(memory_.data() + size_, text.size());
    size_ += text.size();
  }
  void number(double value) {
    if (!std::isfinite(value)) return put("null");
    char digits[32];
    const auto [end, error] =
        std::to_chars(digits, digits + sizeof digits, value, std::chars_format::general, 17);
    const std::string_view text(digits, static_cast<std::size_t>(end - digits));
    put(text);
    if (text.find_first_of(".e") == std::string_view::npos) put(".0");
  }
  void boolean(bool value) { put(value ? "true" : "false"); }
  /// A list of numbers; an empty one is null.
  void numbers(std::span<const double> values) {
    if (values.empty()) return put("null");
    for (std::size_t i = 0; i < values.size(); ++i) {
      put(i == 0 ? "[" : ",");
      number(values[i]);
    }
    put("]");
  }

 private:
  std::span<char> memory_;
  std::size_t size_ = 0;
  bool full_ = false;
};

}  // namespace omentum
