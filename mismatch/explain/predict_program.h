#pragma once

#include <CLI/CLI.hpp>
#include <functional>

namespace omentum {

/// Adds the command predict; the returned function runs it and returns its exit code.
std::function<int()> add_predict_command(CLI::App& app);

}  // namespace omentum
