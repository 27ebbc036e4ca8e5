#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "dvrk_gateway/protocol/robot_state.h"

namespace omentum {

/// What became of a datagram on its way out.
enum class SendOutcome {
  kSent,
  kRefused,  ///< empty or longer than the link allows: not given to the network
  kFailed,   ///< the network did not take it
};

/// Datagrams to and from the other side: a UDP socket, or a script in simulated time. One thread at
/// a time; nothing blocks, allocates or throws.
class Link {
 public:
  struct Received {
    std::size_t size = 0;  ///< bytes written to the memory
    UdpAddress source;
    bool cut = false;  ///< it was longer than the memory
  };

  Link() = default;
  virtual ~Link() = default;
  Link(const Link&) = delete;
  Link& operator=(const Link&) = delete;

  /// The next datagram that waits, or nothing.
  virtual std::optional<Received> receive(std::span<char> memory) noexcept = 0;
  virtual SendOutcome send(std::string_view datagram, const UdpAddress& to) noexcept = 0;
};

/// Time of a program: the machine's, or a test's.
class Clock {
 public:
  Clock() = default;
  virtual ~Clock() = default;
  Clock(const Clock&) = delete;
  Clock& operator=(const Clock&) = delete;

  /// Never goes back; counts from an arbitrary moment.
  virtual std::int64_t now_ns() noexcept = 0;
  /// Returns at that moment, or sooner when a signal arrives.
  virtual void sleep_until(std::int64_t time_ns) noexcept = 0;
};

/// CLOCK_MONOTONIC.
class SteadyClock final : public Clock {
 public:
  std::int64_t now_ns() noexcept override;
  void sleep_until(std::int64_t time_ns) noexcept override;
};

}  // namespace omentum
