#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include "dvrk_gateway/safety/safety.h"

namespace omentum::test {

/// What came of random scripts.
struct Tally {
  std::uint64_t armed = 0, unsafe = 0;
  std::array<std::uint64_t, kStopReasons + 1> stopped{}, waited{};

  void add(const Tally& other) {
    armed += other.armed;
    unsafe += other.unsafe;
    for (std::size_t k = 0; k < stopped.size(); ++k) {
      stopped[k] += other.stopped[k];
      waited[k] += other.waited[k];
    }
  }
  void note_unsafe(std::uint64_t script, int tick, const char* what) {
    if (++unsafe <= 20)
      std::printf("script %llu tick %d: %s\n", static_cast<unsigned long long>(script), tick, what);
  }
};

/// A stop sends hold in its own period and the two after it, then nothing until the operator has
/// acknowledged.
class HoldLaw {
 public:
  /// What is wrong, null if nothing is.
  const char* judge(const Judgement& judged, const GatewayEvents& events) {
    const bool hold = judged.send && judged.command.kind == RobotCommand::Kind::kHold;
    if (judged.stopped_now) {
      holds_due_ = 3;
      silent_ = true;
      acknowledged_ns_ = events.acknowledge_ns;
    }
    if (holds_due_ > 0) {
      --holds_due_;
      return hold ? nullptr : "no hold after a stop";
    }
    if (!silent_) return nullptr;
    if (judged.send) return "not silent after a stop";
    if (judged.memory.phase != SafetyPhase::kStopped) {
      silent_ = false;
      if (events.acknowledge_ns == acknowledged_ns_) return "left stopped by itself";
    }
    return nullptr;
  }

 private:
  int holds_due_ = 0;
  bool silent_ = false;
  std::int64_t acknowledged_ns_ = 0;  ///< at the last stop
};

/// Program NAME N [FIRST=0]: runs scripts FIRST ... FIRST + N - 1 on all cores, each as
/// Script(number).run(tally), and prints the reasons and scripts=N armed=A unsafe=U reasons=R/T.
/// Exit code 1 when U > 0, R < T or A < N / 20.
template <typename Script>
int run_scripts(const char* name, int argc, char** argv) {
  const long long count = argc > 1 ? std::atoll(argv[1]) : 0;
  const long long first = argc > 2 ? std::atoll(argv[2]) : 0;
  if (count <= 0 || first < 0) {
    std::fprintf(stderr, "usage: %s N [FIRST=0]\n", name);
    return 2;
  }
  const unsigned threads = std::max(1U, std::thread::hardware_concurrency());
  std::vector<Tally> parts(threads);
  {
    std::vector<std::jthread> workers;
    for (unsigned t = 0; t < threads; ++t) {
      workers.emplace_back([&, t] {
        for (long long n = t; n < count; n += threads)
          Script(static_cast<std::uint64_t>(first + n)).run(parts[t]);
      });
    }
  }
  Tally tally;
  for (const Tally& part : parts) tally.add(part);
  int reasons = 0;
  for (std::size_t k = 1; k <= kStopReasons; ++k) {
    const auto reason = static_cast<StopReason>(k);
    // Those are told before arming; all others must have stopped an armed arm.
    const bool before = is_before_arming_alone(reason);
    reasons += (before ? tally.waited[k] : tally.stopped[k]) > 0 ? 1 : 0;
    std::printf("%-20s stopped %llu, not ready %llu\n", stop_reason_name(reason),
                static_cast<unsigned long long>(tally.stopped[k]),
                static_cast<unsigned long long>(tally.waited[k]));
  }
  std::printf("scripts=%lld armed=%llu unsafe=%llu reasons=%d/%d\n", count,
              static_cast<unsigned long long>(tally.armed),
              static_cast<unsigned long long>(tally.unsafe), reasons, kStopReasons);
  const bool good = tally.unsafe == 0 && reasons == kStopReasons &&
                    tally.armed >= static_cast<std::uint64_t>(count) / 20;
  return good ? 0 : 1;
}

}  // namespace omentum::test
