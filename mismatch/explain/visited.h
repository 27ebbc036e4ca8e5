#pragma once

#include <span>
#include <string>
#include <vector>

#include "mismatch/seen/observation.h"
#include "proto/verdict.pb.h"

// How far a verdict was led by the commands it was fitted on, and how far others go beyond
// (docs/mismatch.md 5.8).
namespace omentum {

/// Ranges over the recordings that were fitted.
void add_visited(std::span<const Observation> observations, pb::Verdict& verdict);

/// What of the commands of a recording lies beyond these ranges, and by how much: "lift 22.0 mm, up
/// to 14.0 mm were fitted". Empty: nothing.
std::vector<std::string> beyond_visited(const Observation& seen, const pb::Verdict& verdict);

}  // namespace omentum
