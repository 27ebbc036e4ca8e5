#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "dvrk_gateway/loop/control_loop.h"

namespace omentum {

/// How often and how evenly each stream of a robot renews itself, as `check` tells.
class StreamRates {
 public:
  static constexpr std::size_t kStreams = 8;

  void add(const Period& period);
  /// A line per stream: rate [Hz], longest gap [ms], valid or not; "missing" for one never seen.
  std::string table(const RobotState& robot) const;

 private:
  struct Row {
    std::int64_t first_ns = 0, last_ns = 0, longest_gap_ns = 0;
    std::uint64_t renewals = 0;
  };
  std::array<Row, kStreams> rows_{};
};

/// What `check` found, line by line: source, streams, state, instrument by both lengths, frames and
/// registration.
std::string describe_robot(const Period& period, const StreamRates& rates,
                           const SafetySetup& setup);

}  // namespace omentum
