#pragma once

#include <array>
#include <cstdint>

#include "dvrk_gateway/loop/rehearsed_arm.h"
#include "dvrk_gateway/protocol/link.h"
#include "dvrk_gateway/protocol/robot_state.h"
#include "dvrk_gateway/safety/safety.h"

namespace omentum {

/// One control period: what was received, what was judged, what went out.
struct Period {
  std::uint64_t number = 0;    ///< from 1
  std::int64_t began_ns = 0;   ///< of the loop's clock, as all here
  RobotState robot;            ///< after receiving
  std::int64_t state_ns = 0;   ///< arrival of the measured_cp with which it began; 0: none yet
  Judgement judgement;         ///< of the period before, until send() is through
  std::int64_t sent_ns = 0;    ///< when the command was handed to the link; 0: nothing went out
  std::size_t sent_bytes = 0;  ///< of judgement.command
  std::uint64_t cut = 0;       ///< datagrams longer than the memory so far; not taken
  std::uint64_t unsent = 0;    ///< commands so far that link or encoder refused
  bool dry_run = false;        ///< nothing goes out; an armed arm is a rehearsed one
  // Of a loop that keeps time, as LoopTimes counts them; so far.
  std::int64_t late_ns = 0;     ///< began so long after its time; 0 where a stop began it
  std::uint64_t late = 0;       ///< periods that began more than 5 ms late
  std::uint64_t missed = 0;     ///< that did not take place
  std::uint64_t unwatched = 0;  ///< that observers did not see
};

/// The gateway's control period (docs/dvrk.md 8) in two halves: receive(), then, when it is known
/// what to ask for, send(). In between, and between two periods, it looks whether an armed arm must
/// be held at once. Nothing here waits, allocates, locks or throws; link and clock may be a socket
/// and the machine's, or a script in simulated time. One thread.
class ControlLoop {
 public:
  /// `link` and `clock` must outlive it. The stream must begin from `robot_ipv4` (host byte order;
  /// 0: anybody). With `dry_run` all is judged, nothing goes out, and from arming on the robot is
  /// seen to do what it would have been told. A robot that speaks from another port of its machine
  /// is followed once the operator has acknowledged, unless the arm is armed.
  ControlLoop(Link& link, Clock& clock, const SafetySetup& setup, std::uint32_t robot_ipv4 = 0,
              bool dry_run = false);

  /// Begins a period: takes in what has arrived, 512 datagrams at most; the rest waits. send() must
  /// follow before the next one.
  const Period& receive() noexcept;
  /// Ends it: judges the request and sends what may be sent.
  const Period& send(const PolicyRequest& request, const GatewayEvents& events) noexcept;

  /// Takes in what has arrived. True where must_hold(): send() of these events will hold the arm,
  /// whatever it is asked for.
  bool is_alarmed(const GatewayEvents& events) noexcept;
  /// Between two periods: where it is alarmed the arm is held in a period of its own, which is over
  /// when this returns true.
  bool look(const GatewayEvents& events) noexcept;

  const Period& period() const { return period_; }
  const SafetySetup& setup() const { return setup_; }

 private:
  void begin() noexcept;
  void take_in() noexcept;
  void follow_restart(const GatewayEvents& events) noexcept;

  Link& link_;
  Clock& clock_;
  SafetySetup setup_;
  std::uint32_t robot_ipv4_;
  bool dry_run_;
  RehearsedArm rehearsed_;
  std::int64_t acknowledged_ns_ = 0;  ///< the newest that was looked at
  RobotState heard_;                  ///< period_.robot but for what is rehearsed
  Period period_;
  bool judged_ = false;               ///< what is in heard_
  std::array<char, 65536> memory_{};  // older robots put all streams into one datagram
};

/// A thief of the stream, a robot that ended or an operator who stops waits so long at most for
/// being seen. The robot sends every 10 ms.
inline constexpr std::int64_t kLookInterval_ns = 2'000'000;

/// Sleeps until that moment and looks at the robot on the way. True, and earlier, where the arm was
/// held in a period of its own. `events()` tells those of now.
template <typename Events>
bool sleep_looking(ControlLoop& loop, Clock& clock, std::int64_t until_ns, const Events& events) {
  for (std::int64_t look_ns = clock.now_ns() + kLookInterval_ns; look_ns < until_ns;
       look_ns += kLookInterval_ns) {
    clock.sleep_until(look_ns);
    if (loop.look(events())) return true;
  }
  clock.sleep_until(until_ns);
  return false;
}

}  // namespace omentum
