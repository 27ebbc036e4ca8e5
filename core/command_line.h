#pragma once

#include <CLI/CLI.hpp>
#include <optional>

#include "core/check.h"

namespace omentum {

/// Parses the command line of a program: the exit code when there is nothing more to do (help was
/// asked for), else nothing. Throws Error: one line with the option and what it allows.
inline std::optional<int> parse_command_line(CLI::App& app, int argc, char** argv) {
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);
    throw_error("{}", error.what());
  }
  return std::nullopt;
}

}  // namespace omentum
