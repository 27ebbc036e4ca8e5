#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace omentum {

/// When a message was stamped by who made it and when it was recorded [ns].
struct RosStamp {
  std::int64_t logged = 0, stamped = 0;
  bool has_stamp = false;  ///< header.stamp is not zero
};

/// Whose times count.
enum class RosClock { kEither, kStamps, kLog };

/// Times of the messages of one topic.
struct RosTimes {
  std::vector<std::int64_t> time_ns;  ///< of each; without meaning where left_out
  std::vector<bool> left_out;         ///< of each
  bool of_log = false;                ///< all are times of the log
  std::vector<std::string> told;      ///< what was odd, one line each
};

/// header.stamp, where it can be believed; else the time of the log, of all messages alike:
///  - no message has a stamp: the log's;
///  - some have none: these are left out;
///  - a few stand apart from all others (a stamp that strays by more than a second from where the
///    messages beside it and the log put it): these are left out;
///  - the clock behind them was set, so that the stamps fall into parts: the log's; where the log's
///    do the same, the largest part, and the others are left out.
/// kStamps: a clock that was set is told and its stamps are taken. Messages in the order of the
/// file.
RosTimes settle_times(const std::vector<RosStamp>& stamps, RosClock clock);

}  // namespace omentum
