#pragma once

#include <atomic>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "dvrk_gateway/loop/control_loop.h"
#include "dvrk_gateway/loop/control_port.h"
#include "dvrk_gateway/loop/histogram.h"
#include "dvrk_gateway/loop/latest.h"
#include "dvrk_gateway/loop/semaphore.h"

namespace omentum {

/// Share of a period in which the request of that period is waited for; the rest is for judging and
/// sending it, and for the next to begin on time.
inline constexpr double kRequestShare = 0.4;
/// The same where the policy is stopped if none comes: 2 + 0.2 periods behind its last one, so that
/// the hold is out within 50 ms also where the machine is in the way for a moment.
inline constexpr double kLastRequestShare = 0.2;

/// What the operator asks on this machine, as GatewayEvents; any thread and signal handler.
struct OperatorEvents {
  std::atomic<std::int64_t> arm_ns{0}, stop_ns{0}, acknowledge_ns{0}, held_ns{0};
  std::atomic<bool> fault{false};

  GatewayEvents now() const {
    return {.arm_ns = arm_ns,
            .stop_ns = stop_ns,
            .acknowledge_ns = acknowledge_ns,
            .held_ns = held_ns,
            .fault = fault};
  }
};

/// Gives the calling thread SCHED_FIFO one step below the control loop: for the one that decides
/// where the arm goes, which on a busy machine would ask too late. Whether the system granted it.
bool raise_deciding_thread();

/// How well the period was kept, since start().
struct LoopTimes {
  Histogram jitter;     ///< begin of a period after its time
  Histogram latency;    ///< begin of a period -> command handed to the socket
  Histogram state_age;  ///< arrival of the newest measured_cp -> command handed to the socket
  std::uint64_t periods = 0;
  std::uint64_t late = 0;       ///< began more than 5 ms late
  std::uint64_t missed = 0;     ///< did not take place: the one before took so long
  std::uint64_t unwatched = 0;  ///< not seen by `watch`, which was busy
};

/// The control loop on a thread of its own, on an absolute clock: SCHED_FIFO and locked memory
/// where the system grants them. The thread that calls exchange() is the port's; a second one that
/// calls watch() gets every period for recordings.
class RealTimeLoop final : public ControlPort {
 public:
  /// `loop`, `clock` and `events` must outlive it.
  RealTimeLoop(ControlLoop& loop, Clock& clock, const OperatorEvents& events);
  ~RealTimeLoop() override;

  /// Begins the periods; once. One line for each thing the system did not grant.
  std::vector<std::string> start();
  /// No period follows; the thread has ended when it returns. Wakes who waits in exchange().
  void stop();

  /// A request that comes too late for its period is taken in the next one, and the call returns
  /// behind that: so the one after is on time again.
  const Period& exchange(const PolicyRequest& request) override;
  const Period& period() const override { return began_.value().period; }
  bool ended() const override { return ended_; }

  /// Takes the oldest period not yet watched, at its end; false where there is none.
  bool watch(Period& period);
  /// After stop().
  const LoopTimes& times() const { return times_; }

 private:
  static constexpr std::size_t kWatched = 256;  // 5 s at 50 Hz
  struct Begun {
    Period period;
    std::uint64_t taken = 0;  ///< number of the newest request that was taken before
  };
  struct Numbered {
    PolicyRequest request;
    std::uint64_t number = 0;  ///< from 1
  };
  void run();
  void count_begin(std::int64_t late_ns) noexcept;
  bool wait_for_request(const Period& period) noexcept;
  void leave_to_watcher(const Period& period, std::int64_t late_ns) noexcept;

  ControlLoop& loop_;
  Clock& clock_;
  const OperatorEvents& events_;
  LoopTimes times_;

  Latest<Begun> began_;        // to the port
  Latest<Numbered> requests_;  // from the port
  // They say that there may be something new, not what: began_ and requests_ do.
  Semaphore begun_, requested_;
  std::uint64_t asked_ = 0;  // by the port: number of its newest request

  std::vector<Period> watched_;
  std::atomic<std::uint64_t> written_{0}, read_{0};

  std::atomic<bool> stop_{false}, ended_{false};
  std::thread thread_;  // last: uses everything above
};

}  // namespace omentum
