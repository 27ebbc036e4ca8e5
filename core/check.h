#pragma once

#include <fmt/core.h>

#include <stdexcept>
#include <string>

namespace omentum {

/// The operator or the machine is at fault and the program cannot start: wrong knob, missing file,
/// port taken. Thrown at start-up only, caught once in main(), printed as one line, exit code 2.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

template <typename... Args>
[[noreturn]] void throw_error(fmt::format_string<Args...> format, Args&&... args) {
  throw Error(fmt::format(format, std::forward<Args>(args)...));
}

/// Prints file, line, expression and message to stderr and aborts. Never returns.
[[noreturn]] void check_failed(const char* file, int line, const char* expression,
                               const std::string& message);

}  // namespace omentum

/// A bug of ours: aborts with the expression and the values given. Always compiled in.
#define OMENTUM_CHECK(condition, ...)                                                         \
  do {                                                                                        \
    if (!(condition)) {                                                                       \
      ::omentum::check_failed(__FILE__, __LINE__, #condition, ::fmt::format("" __VA_ARGS__)); \
    }                                                                                         \
  } while (false)

/// As OMENTUM_CHECK, in debug and sanitizer builds only: for inner loops.
#ifdef NDEBUG
#define OMENTUM_DCHECK(condition, ...) \
  do {                                 \
  } while (false)
#else
#define OMENTUM_DCHECK(condition, ...) OMENTUM_CHECK(condition, __VA_ARGS__)
#endif
