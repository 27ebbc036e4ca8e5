#pragma once

#include <cstdint>
#include <istream>
#include <optional>
#include <ostream>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "dvrk_gateway/recording/recording_file.h"

namespace omentum {

/// A captured wire log (docs/formats.md 11): per line the time in s, a tab, and one datagram as it
/// was; ">> " before a datagram of the client; lines that begin with # are comments.

struct WireLogLine {
  std::int64_t time_ns = 0;  ///< on the clock of the log
  bool from_client = false;
  std::string_view datagram;
};

/// One line, or what is wrong with it. Total over any bytes.
Result<WireLogLine> parse_wire_line(std::string_view line);

/// What became of the lines of a log; each line is one of these.
struct WireLogCounts {
  std::uint64_t robot = 0;     ///< datagrams of the robot
  std::uint64_t client = 0;    ///< datagrams of the client
  std::uint64_t comments = 0;  ///< and blank lines
  std::uint64_t bad = 0;       ///< not of this form, not JSON, or of before the line before
  /// Of the datagrams, those with a time up to 1 us before that of a line before: recorded then.
  std::uint64_t stepped_back = 0;
  /// Of the client's datagrams, those with a goal that a robot does not take: too few numbers.
  std::uint64_t without_goal = 0;
  std::uint64_t invalid_payloads = 0;  ///< of the robot's: not recorded
  std::vector<std::string> problems;   ///< the first bad lines: "line 7: no tab"
};

/// Makes the recording of a log: every datagram becomes what RecordingFile makes of it, log time is
/// the time of the log. Fails, with what was there instead, where there is no datagram of a robot,
/// or the stream did.
Result<WireLogCounts> convert_wire_log(std::istream& log, const RecordingSetup& setup,
                                       std::ostream& out);

}  // namespace omentum
