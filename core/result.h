#pragma once

#include <string>
#include <utility>
#include <variant>

#include "core/check.h"

namespace omentum {

/// Why an operation on the outside world failed; one line for a person.
struct Failure {
  std::string message;
};

/// Value or failure of an operation that may fail at run time (short datagram, IK unreachable,
/// corrupt chunk). Member names follow std::expected. value() on a failure is a bug and aborts;
/// error() of a value throws std::bad_variant_access.
template <typename T>
class [[nodiscard]] Result {
 public:
  Result(T value) : content_(std::move(value)) {}            // NOLINT(google-explicit-constructor)
  Result(Failure failure) : content_(std::move(failure)) {}  // NOLINT(google-explicit-constructor)
  bool has_value() const { return std::holds_alternative<T>(content_); }
  explicit operator bool() const { return has_value(); }
  const T& value() const& {
    OMENTUM_CHECK(has_value(), "{}", error());
    return std::get<T>(content_);
  }
  T&& value() && {
    OMENTUM_CHECK(has_value(), "{}", error());
    return std::get<T>(std::move(content_));
  }
  const std::string& error() const { return std::get<Failure>(content_).message; }

 private:
  std::variant<T, Failure> content_;
};

template <>
class [[nodiscard]] Result<void> {
 public:
  Result() = default;
  Result(Failure failure) : message_(std::move(failure.message)), failed_(true) {}  // NOLINT
  bool has_value() const { return !failed_; }
  explicit operator bool() const { return !failed_; }
  const std::string& error() const { return message_; }

 private:
  std::string message_;
  bool failed_ = false;
};

}  // namespace omentum
