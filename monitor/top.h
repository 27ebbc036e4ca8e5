#pragma once

#include <cstdint>
#include <string>

#include "monitor/run_state.h"
#include "monitor/tool.h"

namespace omentum {

/// The table of `omentum top`: learner, ledger, workers, robots, alarms; plain text, one newline
/// per line. Control characters of received text become '?', so that no worker can steer a
/// terminal.
std::string make_top_table(const RunState& state, std::int64_t now_ns);

struct TopOptions {
  ToolOptions tool;
  bool once = false;       ///< one table, then the end; also where stdout is no terminal
  double interval_s = 1;   ///< between two tables
  double patience_s = 10;  ///< --once: how long to wait for a learner to speak
};

/// Exit code: 0, or 1 when --once heard neither learner nor robot.
int run_top(const TopOptions& options);

/// 3725 -> "1 h 2 min".
std::string short_duration(double seconds);

}  // namespace omentum
