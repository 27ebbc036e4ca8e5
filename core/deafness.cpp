#include "core/deafness.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <utility>

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;
// Deaf for so long: it joins anew, and again after twice as long ... while that does not help.
constexpr std::int64_t kDeafNs = 12 * kS;
constexpr std::int64_t kLongPauseNs = 60 * kS;
constexpr std::int64_t kHeardLatelyNs = 300 * kS;
// Of discovery in progress, which looks like deafness.
constexpr std::int64_t kLookNs = kS / 2;
constexpr std::int64_t kStarvedPart = 3;  // of the time some thread waits for a core
constexpr std::int64_t kQuietNs = 2 * kS;
constexpr std::int64_t kQuietPerKnownNs = kS / 100;
constexpr std::int64_t kSpreadPerKnownNs = kS / 25;  // a worker is about 11
constexpr std::int64_t kKeptWaitingNs = kS / 5;
constexpr std::int64_t kMostUnsettledNs = 90 * kS;  // somebody may forge announcements for ever

}  // namespace

std::int64_t waited_for_core_ns() {
  std::error_code failed;
  std::int64_t all_ns = 0;
  for (const auto& thread : std::filesystem::directory_iterator("/proc/self/task", failed)) {
    std::int64_t ran_ns = 0, waited_ns = 0;
    std::ifstream(thread.path() / "schedstat") >> ran_ns >> waited_ns;
    all_ns += waited_ns;
  }
  return all_ns;
}

void Deafness::joined(std::int64_t now_ns) {
  joined_ns_ = disturbed_ns_ = unsettled_from_ns_ = now_ns;
  around_.found = around_.known = 0;
}

/// A part of so long for each participant and endpoint that is known: another part for each
/// process, so that they do not all join anew at one moment.
std::int64_t Deafness::spread_ns(std::int64_t per_known_ns) const {
  constexpr std::uint64_t kMostKnown = 500;  // somebody may make up any number
  constexpr std::uint32_t kMoments = 64;
  const auto known = static_cast<std::int64_t>(std::min(around_.known, kMostKnown));
  return per_known_ns * known * (id_ % kMoments) / kMoments;
}

/// How long it takes part before it joins anew. Many that start on few cores find each other
/// slowly, and each that joins anew costs all others time: so each next time is twice as late.
std::int64_t Deafness::pause_ns(std::int64_t now_ns) const {
  constexpr std::uint32_t kMostDoublings = 4;
  if (rejoins_in_vain_ == 0) return kDeafNs + spread_ns(kSpreadPerKnownNs);
  const std::int64_t doubled = kDeafNs << std::min(rejoins_in_vain_, kMostDoublings);
  const bool lately = heard_ns_ > 0 && now_ns - heard_ns_ < kHeardLatelyNs;
  return spread_ns(kSpreadPerKnownNs) + (lately ? std::min(doubled, kLongPauseNs) : kLongPauseNs);
}

void Deafness::watch(std::int64_t now_ns, std::int64_t late_ns,
                     const std::function<Around()>& look) {
  bool disturbed = late_ns > kKeptWaitingNs;
  if (const std::int64_t past_ns = now_ns - looked_ns_; past_ns >= kLookNs) {
    looked_ns_ = now_ns;
    const Around before = std::exchange(around_, look());
    // Threads that only listen hardly ever wait.
    disturbed |= around_.waited_for_core_ns - before.waited_for_core_ns > past_ns / kStarvedPart;
    disturbed |= around_.found > before.found;
  }
  if (!disturbed) return;
  if (is_quiet(now_ns)) unsettled_from_ns_ = now_ns;
  disturbed_ns_ = now_ns;
}

/// Discovery has found nothing new for a while, and this process gets its share of the cores. All
/// find who joins anew, so the others wait for it.
bool Deafness::is_quiet(std::int64_t now_ns) const {
  return now_ns - disturbed_ns_ > kQuietNs + spread_ns(kQuietPerKnownNs);
}

bool Deafness::may_join_anew(std::int64_t now_ns) const {
  if (now_ns - joined_ns_ < pause_ns(now_ns)) return false;
  return is_quiet(now_ns) || now_ns - unsettled_from_ns_ >= kMostUnsettledNs;
}

bool Deafness::is_too_long(std::int64_t since_ns, std::int64_t now_ns) const {
  return now_ns - since_ns > kDeafNs + spread_ns(kSpreadPerKnownNs);
}

}  // namespace omentum
