#pragma once

#include <cstdint>
#include <string>

namespace omentum {

/// Id of what decides results: the sources of core, idl, proto, sim_worker and learner, compiler
/// and flags, as they were when the program was built; equal ids mean equal results. Made by
/// core/build_id.cmake. Reaches wire and disk.
std::uint64_t build_id();

/// Commit the program was built from, "-dirty" behind it where files differed, "unknown" without a
/// repository.
std::string git_revision();

/// What --version of every program prints: "omentum 0.1.0, revision <git>, build <id>".
std::string program_version();

}  // namespace omentum
