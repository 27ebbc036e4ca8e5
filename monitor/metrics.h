#pragma once

#include <cstdint>
#include <string>

#include "monitor/run_state.h"

namespace omentum {

/// The figures of a run in the text format 0.0.4 of Prometheus (docs/monitor.md 3). Everything
/// about a learner that was never heard is left out but omentum_learner_up 0.
std::string make_metrics(const RunState& state, std::int64_t now_ns);

}  // namespace omentum
