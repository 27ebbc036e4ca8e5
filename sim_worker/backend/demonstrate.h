#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "proto/config.pb.h"

namespace omentum {

/// What is shown of a scripted expert.
struct DemonstrationOptions {
  std::uint32_t episodes = 20;
  /// Share of the decisions in which an axis moves at random instead, each axis by itself; the jaw
  /// never does. Shows what to do beside the expert's own path.
  double tremor = 0.1;
  std::string folder = {};        ///< of the recordings
  std::string git_revision = {};  ///< they carry it
};

/// What became of the episodes of a scripted expert.
struct DemonstrationCount {
  std::uint32_t episodes = 0, reached = 0;
  std::uint64_t steps = 0;
  bool stopped = false;  ///< nothing was written
};

/// Runs whole episodes of the scripted expert, from starts drawn as those of training
/// but never the same ones, and writes folder/demonstration_<i>.mcap of each, as evaluations are
/// recorded; `folder` appears with all of them. Episode i does not depend on the others. Throws
/// Error (one line) where there is something of that name already, or the disk does not take it.
DemonstrationCount demonstrate(const pb::Config& config, const DemonstrationOptions& options,
                               const std::function<bool()>& stop = {});

}  // namespace omentum
