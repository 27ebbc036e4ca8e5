#pragma once

#include <CLI/CLI.hpp>
#include <functional>

namespace omentum {

/// Adds the command explain; the returned function runs it and returns its exit code.
std::function<int()> add_explain_command(CLI::App& app);

}  // namespace omentum
