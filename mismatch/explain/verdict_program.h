#pragma once

#include <CLI/CLI.hpp>
#include <functional>

namespace omentum {

/// Adds the commands locate, name, model and show, which print parts of a stored verdict; the
/// returned function runs the one that was given and returns its exit code.
std::function<int()> add_verdict_commands(CLI::App& app);

}  // namespace omentum
