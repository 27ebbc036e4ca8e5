#include "mismatch/ros/stamps.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace omentum {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kSwapped = 20'000'000;  // [ns] publishers and networks swap messages
constexpr std::int64_t kLongestStall = 60 * kSecond;
constexpr std::int64_t kWorthTelling = 1'000'000;
constexpr std::size_t kSustained = 3;      // messages in a row behind one: no swap
constexpr double kFewStray = 0.2;          // of all
constexpr std::size_t kLongestStray = 10;  // messages in a row

double seconds(std::int64_t ns) { return 1e-9 * static_cast<double>(ns); }

/// Whether one message may follow another by a clock that was not set between them.
class Continuity {
 public:
  explicit Continuity(const std::vector<RosStamp>& stamps) : stamps_(stamps) {
    const auto [first, last] = std::minmax_element(
        stamps.begin(), stamps.end(),
        [](const RosStamp& a, const RosStamp& b) { return a.logged < b.logged; });
    log_tells_ = first->logged != last->logged;
    for (const RosStamp& stamp : stamps) {
      const std::int64_t late = stamp.logged - stamp.stamped;
      least_late_.push_back(least_late_.empty() ? late : std::min(late, least_late_.back()));
    }
  }

  bool follows(std::size_t from, std::size_t to) const {
    const std::int64_t stamped = stamps_[to].stamped - stamps_[from].stamped;
    const std::int64_t logged =
        std::max<std::int64_t>(0, stamps_[to].logged - stamps_[from].logged);
    if (stamped < -kSecond) return false;
    const bool leaps =
        log_tells_ && static_cast<double>(stamped) >
                          static_cast<double>(kSecond) + 10 * static_cast<double>(logged);
    // Messages that were held up come all at once, later than others and not earlier.
    const bool held_up = stamped < kLongestStall &&
                         stamps_[to].logged - stamps_[to].stamped > least_late_[from] - kSecond;
    if (leaps && !held_up) return false;
    return stamped >= -kSwapped || !stays_behind(from, to);
  }

 private:
  /// The messages from `to` on are all stamped before `from`.
  bool stays_behind(std::size_t from, std::size_t to) const {
    const std::size_t end = std::min(to + kSustained, stamps_.size());
    for (std::size_t k = to; k < end; ++k) {
      if (stamps_[k].stamped >= stamps_[from].stamped) return false;
    }
    return true;
  }

  const std::vector<RosStamp>& stamps_;
  bool log_tells_ = false;
  std::vector<std::int64_t>
      least_late_;  ///< of all messages up to each: by how much it was recorded later
};

/// Messages of one clock setting, by index; in runs of neighbours.
struct Part {
  std::vector<std::size_t> members;
  std::size_t longest_run = 0;
};

std::vector<Part> parts_of(const std::vector<RosStamp>& stamps) {
  constexpr std::size_t kMostParts = 64;  // beyond it nothing in the stamps can be believed
  const Continuity continuity(stamps);
  std::vector<Part> parts;
  for (std::size_t begin = 0; begin < stamps.size();) {
    std::size_t end = begin + 1;
    while (end < stamps.size() && continuity.follows(end - 1, end)) ++end;
    auto part = std::find_if(parts.begin(), parts.end(), [&](const Part& known) {
      return continuity.follows(known.members.back(), begin);
    });
    if (part == parts.end() && parts.size() == kMostParts) part = std::prev(parts.end());
    if (part == parts.end()) part = parts.insert(parts.end(), Part{});
    for (std::size_t k = begin; k < end; ++k) part->members.push_back(k);
    part->longest_run = std::max(part->longest_run, end - begin);
    begin = end;
  }
  return parts;
}

std::string count_of(std::size_t count) {
  return fmt::format("{} message{}", count, count == 1 ? "" : "s");
}

/// The first place where the clock was set.
std::string told_step(const std::vector<RosStamp>& stamps) {
  const Continuity continuity(stamps);
  for (std::size_t k = 1; k < stamps.size(); ++k) {
    if (continuity.follows(k - 1, k)) continue;
    const std::int64_t step = stamps[k].stamped - stamps[k - 1].stamped;
    return fmt::format("header.stamp goes {} by {:.6g} s at message {} of {}, the log by {:.3g} s",
                       step < 0 ? "back" : "on", std::fabs(seconds(step)), k + 1, stamps.size(),
                       seconds(stamps[k].logged - stamps[k - 1].logged));
  }
  return "header.stamp is of no one clock";
}

/// Messages that came a little out of order; they are sorted by their stamps.
void tell_swapped(const std::vector<RosStamp>& stamps, std::vector<std::string>& told) {
  std::size_t count = 0;
  std::int64_t farthest = 0, latest = stamps.front().stamped;
  for (const RosStamp& stamp : stamps) {
    if (latest - stamp.stamped > kWorthTelling) ++count;
    farthest = std::max(farthest, latest - stamp.stamped);
    latest = std::max(latest, stamp.stamped);
  }
  if (count > 0)
    told.push_back(fmt::format("{} stamped up to {:.3g} s before earlier ones: sorted by stamp",
                               count_of(count), seconds(farthest)));
}

/// Stamps of which all have one, into `times` at the places `at`.
void settle(const std::vector<RosStamp>& stamps, const std::vector<std::size_t>& at, bool forced,
            RosTimes& times) {
  const std::vector<Part> parts = parts_of(stamps);
  const auto largest = std::max_element(
      parts.begin(), parts.end(),
      [](const Part& a, const Part& b) { return a.members.size() < b.members.size(); });
  const std::size_t others = stamps.size() - largest->members.size();
  const bool stray =
      static_cast<double>(others) <= kFewStray * static_cast<double>(stamps.size()) &&
      std::all_of(parts.begin(), parts.end(), [&](const Part& part) {
        return &part == &*largest || part.longest_run <= kLongestStray;
      });
  if (others == 0 || forced) {
    if (others > 0) times.told.push_back(told_step(stamps) + ": taken as the map says");
    return tell_swapped(stamps, times.told);
  }
  const auto leave_out_others = [&] {
    std::vector<bool> stays(stamps.size(), false);
    for (const std::size_t k : largest->members) stays[k] = true;
    for (std::size_t k = 0; k < stamps.size(); ++k) times.left_out[at[k]] = !stays[k];
  };
  if (stray) {
    leave_out_others();
    const std::size_t k = parts[largest == parts.begin() ? 1 : 0].members.front();
    const std::int64_t beside = stamps[largest->members.front()].stamped;
    times.told.push_back(
        fmt::format("{} whose header.stamp strays, by {:.6g} s at message {} of {}: left out",
                    count_of(others), seconds(stamps[k].stamped - beside), k + 1, stamps.size()));
    return;
  }
  std::vector<RosStamp> logs;
  for (const RosStamp& stamp : stamps) logs.push_back({stamp.logged, stamp.logged, true});
  if (parts_of(logs).size() == 1 && logs.front().logged != logs.back().logged) {
    times.of_log = true;
    times.told.push_back(
        told_step(stamps) +
        ": the times of the log are taken; log_time: false of a map takes the stamps");
    return;
  }
  leave_out_others();
  times.told.push_back(
      fmt::format("{}, and the log goes no better: {} of the largest part are taken, {} left out",
                  told_step(stamps), count_of(largest->members.size()), others));
}

}  // namespace

RosTimes settle_times(const std::vector<RosStamp>& stamps, RosClock clock) {
  RosTimes times;
  times.left_out.assign(stamps.size(), false);
  std::vector<RosStamp> stamped;
  std::vector<std::size_t> at;
  for (std::size_t k = 0; k < stamps.size(); ++k) {
    if (!stamps[k].has_stamp) continue;
    stamped.push_back(stamps[k]);
    at.push_back(k);
  }
  times.of_log = clock == RosClock::kLog || stamped.empty();
  if (!times.of_log) {
    if (const std::size_t without = stamps.size() - stamped.size(); without > 0) {
      for (std::size_t k = 0; k < stamps.size(); ++k) times.left_out[k] = !stamps[k].has_stamp;
      times.told.push_back(
          fmt::format("{} of {} without header.stamp, which the others have: left out; log_time: "
                      "true of a map takes all at the times of the log",
                      without, count_of(stamps.size())));
    }
    settle(stamped, at, clock == RosClock::kStamps, times);
    if (times.of_log) times.left_out.assign(stamps.size(), false);
  }
  for (const RosStamp& stamp : stamps)
    times.time_ns.push_back(times.of_log ? stamp.logged : stamp.stamped);
  return times;
}

}  // namespace omentum
