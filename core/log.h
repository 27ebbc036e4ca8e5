#pragma once

#include <fmt/core.h>

#include <string_view>

namespace omentum {

/// The process log: stderr, one event per line, key=value. Never used inside step(). Warnings and
/// errors that begin alike are told five times a minute, the others counted. Thread-safe.
///
/// Formatting is compiled once, in log.cpp: spdlog's own templates take 5 s in every source.
class Log {
 public:
  template <typename... T>
  void debug(fmt::format_string<T...> text, T&&... values) const {
    say(Level::kDebug, text, fmt::make_format_args(values...));
  }
  template <typename... T>
  void info(fmt::format_string<T...> text, T&&... values) const {
    say(Level::kInfo, text, fmt::make_format_args(values...));
  }
  template <typename... T>
  void warn(fmt::format_string<T...> text, T&&... values) const {
    say(Level::kWarn, text, fmt::make_format_args(values...));
  }
  template <typename... T>
  void error(fmt::format_string<T...> text, T&&... values) const {
    say(Level::kError, text, fmt::make_format_args(values...));
  }

 private:
  enum class Level { kDebug, kInfo, kWarn, kError };
  static void say(Level level, fmt::string_view text, fmt::format_args values);
};
inline Log log() { return {}; }

/// Names the program in every line; call once at the start of main().
void name_log(std::string_view program);

}  // namespace omentum
