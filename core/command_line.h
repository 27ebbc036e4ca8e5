#pragma once

#include <CLI/CLI.hpp>
#include <algorithm>
#include <optional>
#include <string>

#include "core/build_id.h"
#include "core/check.h"
#include "core/csv.h"

namespace omentum {

/// Numbers of a range; what is no number, NaN above all, is none of them (CLI::Range takes it).
inline CLI::Validator number_between(double min, double max) {
  const std::string range = fmt::format("[{} - {}]", min, max);
  return {[=](std::string& text) {
            const double value = parse_number(text).value_or(min - 1);
            return value >= min && value <= max
                       ? std::string()
                       : fmt::format("{}, allowed {} ... {}", text, min, max);
          },
          range};
}

/// Digits alone: as an unsigned number CLI takes -1 for the largest there is.
inline CLI::Validator whole_number() {
  return {[](std::string& text) {
            const bool digits = !text.empty() && std::all_of(text.begin(), text.end(), [](char c) {
              return c >= '0' && c <= '9';
            });
            return digits && text.size() <= 19
                       ? std::string()
                       : fmt::format("{}, allowed 0 ... 9999999999999999999", text);
          },
          "WHOLE"};
}

/// Parses the command line of a program: the exit code when there is nothing more to do (help or
/// version was asked for), else nothing. Throws Error: one line with the option and what it allows.
inline std::optional<int> parse_command_line(CLI::App& app, int argc, char** argv) {
  app.set_version_flag("--version", program_version(), "Print release, revision and build");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);
    throw_error("{}", error.what());
  }
  return std::nullopt;
}

}  // namespace omentum
