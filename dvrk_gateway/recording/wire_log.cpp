#include "dvrk_gateway/recording/wire_log.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "core/csv.h"
#include "core/table.h"
#include "dvrk_gateway/protocol/codec.h"
#include "dvrk_gateway/protocol/robot_codec.h"

namespace omentum {
namespace {

constexpr std::size_t kLongestLine = 70'000;  // a datagram has at most 65507 bytes
constexpr double kLatest_s = 9e9;             // ns of it fit into 64 bits
constexpr std::size_t kToldProblems = 5;
// Who logs with several threads writes a time a little back now and then.
constexpr std::int64_t kSmallBack_ns = 1000;
constexpr UdpAddress kRobot{0x7f000001, 1};  // a log says nothing of addresses

/// What the robot does last of a datagram, which is what counts (docs/dvrk.md 4.3); nothing where
/// the goal lacks numbers.
struct Goals {
  std::optional<RobotCommand> arm;
  std::optional<double> jaw;
  bool lacking = false;
};

void take_joints(const std::optional<JointGoal>& goal, Goals& goals) {
  if (!goal) return;
  if (goal->goal_count < 6) {
    goals.lacking = true;
    return;
  }
  RobotCommand& command = goals.arm.emplace();
  command.kind = RobotCommand::Kind::kServoJp;
  std::copy_n(goal->goal.begin(), 6, command.joints.begin());
}

void take_pose(const std::optional<CartesianGoal>& goal, Goals& goals) {
  if (!goal) return;
  if (!goal->has_rotation || !goal->has_translation) {
    goals.lacking = true;
    return;
  }
  RobotCommand& command = goals.arm.emplace();
  command.kind = RobotCommand::Kind::kServoCp;
  command.rotation = goal->rotation;
  command.translation = goal->translation;
}

void take_jaw(const std::optional<JointGoal>& goal, Goals& goals) {
  if (!goal) return;
  if (goal->goal_count < 1)
    goals.lacking = true;
  else
    goals.jaw = goal->goal[0];
}

/// In the order in which the robot runs them.
Goals goals_of(const CommandDatagram& said) {
  Goals goals;
  take_jaw(said.jaw_move_jp, goals);
  take_jaw(said.jaw_servo_jp, goals);
  take_pose(said.move_cp, goals);
  take_joints(said.move_jp, goals);
  take_pose(said.servo_cp, goals);
  take_joints(said.servo_jp, goals);
  return goals;
}

/// The text of a field of a datagram, as it is written; empty without it.
std::string_view text_of(std::string_view datagram, std::string_view field) {
  const std::size_t at = datagram.find(fmt::format("\"{}\"", field));
  if (at == std::string_view::npos) return {};
  std::string_view rest = datagram.substr(at + field.size() + 2);
  const std::size_t quote = rest.find_first_not_of(": \t");
  if (quote == std::string_view::npos || rest[quote] != '"') return {};
  rest.remove_prefix(quote + 1);
  const std::size_t end = rest.find('"');
  return end == std::string_view::npos ? std::string_view() : rest.substr(0, end);
}

/// Turns lines into messages of a recording.
class Conversion {
 public:
  Conversion(std::ostream& out, const RecordingSetup& setup) : file_(out, setup) {}

  void line(std::string_view text, std::uint64_t number) {
    while (!text.empty() && (text.back() == '\r' || text.back() == ' ')) text.remove_suffix(1);
    if (text.empty() || text.front() == '#') {
      ++counts_.comments;
      return;
    }
    const Result<WireLogLine> parsed = parse_wire_line(text);
    const Result<void> taken = parsed ? take(parsed.value()) : Failure{parsed.error()};
    if (taken) return;
    bad(number, taken.error());
  }
  void bad(std::uint64_t number, const std::string& why) {
    ++counts_.bad;
    if (counts_.problems.size() < kToldProblems)
      counts_.problems.push_back(fmt::format("line {}: {}", number, why));
  }
  Result<WireLogCounts> finish() {
    if (!two_arms_.empty()) return Failure{two_arms_};
    counts_.invalid_payloads = file_.invalid_payloads();
    if (const Result<void> finished = file_.finish(); !finished) return Failure{finished.error()};
    return counts_;
  }

 private:
  Result<void> take(const WireLogLine& line) {
    if (line.time_ns < line_ns_ - kSmallBack_ns)
      return Failure{"its time is before that of the line before"};
    // Samples of one time cannot be told apart; a log writes times with a microsecond.
    const std::int64_t time_ns = std::max(line.time_ns, time_ns_ + 1);
    const Result<void> taken =
        line.from_client ? take_client(line, time_ns) : take_robot(line, time_ns);
    if (!taken) return taken;
    if (line.time_ns < line_ns_) ++counts_.stepped_back;
    line_ns_ = std::max(line_ns_, line.time_ns);
    time_ns_ = time_ns;
    return {};
  }

  Result<void> take_robot(const WireLogLine& line, std::int64_t time_ns) {
    const std::uint64_t malformed = robot_.malformed;
    take_datagram(robot_, line.datagram, time_ns, kRobot);
    if (robot_.malformed != malformed) return Failure{"no JSON of the protocol"};
    look_for_another_arm(line.datagram);
    ++counts_.robot;
    file_.add_robot(robot_, time_ns);
    return {};
  }

  /// Every arm has a port of its own. Where two send to one, their poses would take turns in one
  /// channel, and joints and jaws do not say whose they are.
  void look_for_another_arm(std::string_view datagram) {
    const std::size_t from = datagram.find('"');
    if (from == std::string_view::npos || !two_arms_.empty()) return;
    const std::string_view rest = datagram.substr(from + 1);
    const std::string key(rest.substr(0, rest.find('"')));
    for (const char* field : {"MovingFrame", "ReferenceFrame"}) {
      const std::string_view name = text_of(datagram, field);
      if (name.empty()) continue;
      const auto [known, added] = frames_.try_emplace(key + field, name);
      if (added || known->second == name) continue;
      two_arms_ = fmt::format(
          "{} has {} \"{}\" and \"{}\": two arms in one log, and a recording has one; needed a "
          "log of each, captured at its own port",
          shown(key), field, shown(known->second), shown(name));
      return;
    }
  }

  Result<void> take_client(const WireLogLine& line, std::int64_t time_ns) {
    const CommandDatagram said = decode_commands(line.datagram);
    if (!said.whole || !said.finite)
      return Failure{"of the client: no JSON of the protocol, or a number that is not finite"};
    ++counts_.client;
    const Goals goals = goals_of(said);
    if (goals.lacking) ++counts_.without_goal;
    if (goals.jaw) file_.add_jaw_goal(*goals.jaw, time_ns);
    if (!goals.arm) return {};
    RobotCommand command = *goals.arm;
    command.jaw = std::numeric_limits<double>::quiet_NaN();  // is written already
    file_.add_command(command, time_ns);
    return {};
  }

  RecordingFile file_;
  RobotState robot_;
  WireLogCounts counts_;
  std::map<std::string, std::string> frames_;  ///< by payload and field
  std::string two_arms_;
  std::int64_t line_ns_ = 0, time_ns_ = -1;  ///< the latest so far, in the log and recorded
};

}  // namespace

Result<WireLogLine> parse_wire_line(std::string_view line) {
  const std::size_t tab = line.find('\t');
  if (tab == std::string_view::npos) return Failure{"no tab"};
  const std::optional<double> time_s = parse_number(line.substr(0, tab));
  if (!time_s || !(*time_s >= 0 && *time_s <= kLatest_s))
    return Failure{"no time in s before the tab"};
  WireLogLine parsed;
  parsed.time_ns = std::llround(1e9 * *time_s);
  parsed.datagram = line.substr(tab + 1);
  constexpr std::string_view kClient = ">> ";
  parsed.from_client = parsed.datagram.starts_with(kClient);
  if (parsed.from_client) parsed.datagram.remove_prefix(kClient.size());
  return parsed;
}

Result<WireLogCounts> convert_wire_log(std::istream& log, const RecordingSetup& setup,
                                       std::ostream& out) {
  Conversion conversion(out, setup);
  std::string memory(kLongestLine, '\0');
  for (std::uint64_t number = 1; log.good(); ++number) {
    log.getline(memory.data(), static_cast<std::streamsize>(memory.size()));
    const auto size = static_cast<std::size_t>(log.gcount());
    if (log.eof() && size == 0) break;
    if (log.fail() && !log.eof()) {
      log.clear();
      log.ignore(std::numeric_limits<std::streamsize>::max(), '\n');
      conversion.bad(number, fmt::format("longer than {} bytes", kLongestLine));
      continue;
    }
    // The count has the end of line in it, unless the file ends without one.
    conversion.line({memory.data(), log.eof() ? size : size - 1}, number);
  }
  Result<WireLogCounts> counts = conversion.finish();
  if (counts && counts.value().robot == 0) {
    const std::string first =
        counts.value().problems.empty() ? "" : "; " + counts.value().problems.front();
    return Failure{fmt::format("no datagram of a robot in it{}", first)};
  }
  return counts;
}

}  // namespace omentum
