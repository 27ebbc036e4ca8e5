#pragma once

#include <CLI/CLI.hpp>
#include <functional>

namespace omentum {

/// Adds the commands import, export and info; the returned function runs the one that was given
/// and returns its exit code, or -1 where none of them was.
std::function<int()> add_recording_commands(CLI::App& app);

}  // namespace omentum
