#pragma once

#include <CLI/CLI.hpp>
#include <functional>

namespace omentum {

/// Adds the command calibrate; the returned function runs it and returns its exit code.
std::function<int()> add_calibrate_command(CLI::App& app);

}  // namespace omentum
