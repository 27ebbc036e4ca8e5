#pragma once

#include <cstdint>
#include <string>

#include "core/result.h"
#include "monitor/tool.h"

namespace omentum {

/// A whole number of a request's query: digits alone, at most `max`. The failure names the
/// parameter.
Result<std::uint64_t> parse_parameter(const std::string& name, const std::string& text,
                                      std::uint64_t max);

struct MonitorOptions {
  ToolOptions tool;
  std::string address = "127.0.0.1";
  std::uint16_t port = 8080;  ///< 0: any free one, printed
};

/// Serves the page of a run until SIGINT or SIGTERM. Exit code: 0. Throws Error, also when the port
/// is taken.
int run_monitor(const MonitorOptions& options);

}  // namespace omentum
