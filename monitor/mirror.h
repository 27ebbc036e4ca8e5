#pragma once

#include <cstdint>

#include "monitor/tool.h"

namespace omentum {

struct MirrorOptions {
  ToolOptions tool;
  std::uint32_t to_domain = 0;  ///< 0 ... 230, another one than the run's
};

/// Republishes the public topics of a run into an open domain on this machine's loopback, until
/// SIGINT or SIGTERM: partitions "" and <run>, keys, disposals, crashes and what a late joiner gets
/// as in the source (docs/monitor.md 5). Only reads the source and only writes the other, so
/// nothing flows back. Exit code 0. Throws Error.
int run_mirror(const MirrorOptions& options);

}  // namespace omentum
