#pragma once

#include <span>
#include <string>
#include <vector>

#include "mismatch/seen/observation.h"

namespace omentum {

/// Takes frames out that were seen after the commands of their recording had ended: what the jaws
/// did then is not known. A recording without any left goes with them. Each is told of in
/// `warnings`.
void drop_frames_without_commands(std::vector<Observation>& observations,
                                  std::vector<std::string>& warnings);

/// What recordings of this kind cannot say, and what to record next; a line each (docs/mismatch.md
/// 5.10).
std::vector<std::string> case_notes(std::span<const Observation> observations);

}  // namespace omentum
