#pragma once

#include <array>
#include <cstdint>

#include "dvrk_gateway/protocol/link.h"
#include "dvrk_gateway/protocol/robot_state.h"
#include "dvrk_gateway/safety/safety.h"

namespace omentum {

/// One control period: what was received, what was judged, what went out.
struct Period {
  std::uint64_t number = 0;    ///< from 1
  std::int64_t began_ns = 0;   ///< of the loop's clock, as all here
  RobotState robot;            ///< after receiving
  Judgement judgement;         ///< of the period before, until send() is through
  std::int64_t sent_ns = 0;    ///< when the command was handed to the link; 0: nothing went out
  std::size_t sent_bytes = 0;  ///< of judgement.command
  std::uint64_t cut = 0;       ///< datagrams longer than the memory so far; not taken
  std::uint64_t unsent = 0;    ///< commands so far that link or encoder refused
  // Of a loop that keeps time, as LoopTimes counts them; so far.
  std::int64_t late_ns = 0;     ///< began so long after its time
  std::uint64_t late = 0;       ///< periods that began more than 5 ms late
  std::uint64_t missed = 0;     ///< that did not take place
  std::uint64_t unwatched = 0;  ///< that observers did not see
};

/// The gateway's control period (docs/dvrk.md 8) in two halves: receive(), then, when it is known
/// what to ask for, send(). Nothing here waits, allocates, locks or throws; link and clock may be a
/// socket and the machine's, or a script in simulated time. One thread.
class ControlLoop {
 public:
  /// `link` and `clock` must outlive it. The stream must begin from `robot_ipv4` (host byte order;
  /// 0: anybody). With `dry_run` all is judged and nothing goes out.
  ControlLoop(Link& link, Clock& clock, const SafetySetup& setup, std::uint32_t robot_ipv4 = 0,
              bool dry_run = false);

  /// Begins a period: takes in all that has arrived.
  const Period& receive() noexcept;
  /// Ends it: judges the request and sends what may be sent.
  const Period& send(const PolicyRequest& request, const GatewayEvents& events) noexcept;

  const Period& period() const { return period_; }
  const SafetySetup& setup() const { return setup_; }

 private:
  Link& link_;
  Clock& clock_;
  SafetySetup setup_;
  std::uint32_t robot_ipv4_;
  bool dry_run_;
  Period period_;
  std::array<char, 65536> memory_{};  // older robots put all streams into one datagram
};

}  // namespace omentum
