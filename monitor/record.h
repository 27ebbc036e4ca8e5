#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "monitor/tool.h"

namespace omentum {

struct RecordOptions {
  ToolOptions tool;
  std::string out;                  ///< file that does not exist yet
  std::vector<std::string> topics;  ///< names; empty: all public ones
  double seconds = 0;               ///< 0: until SIGINT or SIGTERM
};

/// Names that `topics` may hold.
std::vector<std::string> recordable_topics();

/// Writes an MCAP file with one protobuf channel per topic (proto/bus.proto). A thread of its own
/// takes samples; what the disk is too slow for is dropped and counted. Exit code: 0, or 1 when the
/// file could not be written whole. Throws Error.
int run_record(const RecordOptions& options);

}  // namespace omentum
