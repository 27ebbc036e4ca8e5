#pragma once

#include <cstdint>
#include <ctime>

namespace omentum {

/// The clocks of the programs, in nanoseconds. They serve timeouts, rates and statistics; no result
/// may depend on one, and no decision compares clocks of two machines.
inline std::int64_t clock_ns(clockid_t clock) {
  timespec now{};
  clock_gettime(clock, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

/// Never goes back; counts from an arbitrary moment.
inline std::int64_t steady_now_ns() { return clock_ns(CLOCK_MONOTONIC); }
/// Time since steady_now_ns() was `begin_ns` [s].
inline double seconds_since(std::int64_t begin_ns) {
  return 1e-9 * static_cast<double>(steady_now_ns() - begin_ns);
}
/// Since 1970-01-01 UTC; jumps when the clock is set.
inline std::int64_t wall_now_ns() { return clock_ns(CLOCK_REALTIME); }
/// Processor time of the calling thread [s].
inline double thread_seconds() {
  return 1e-9 * static_cast<double>(clock_ns(CLOCK_THREAD_CPUTIME_ID));
}

}  // namespace omentum
