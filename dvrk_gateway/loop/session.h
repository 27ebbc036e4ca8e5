#pragma once

#include <atomic>
#include <functional>
#include <thread>
#include <vector>

#include "core/rollout.h"
#include "dvrk_gateway/loop/control_loop.h"
#include "dvrk_gateway/loop/real_time_loop.h"
#include "dvrk_gateway/protocol/udp_socket.h"

namespace omentum {

/// Who is told what the gateway does: a recording, the bus, the operator's screen.
class GatewayObserver {
 public:
  GatewayObserver() = default;
  virtual ~GatewayObserver() = default;
  GatewayObserver(const GatewayObserver&) = delete;
  GatewayObserver& operator=(const GatewayObserver&) = delete;

  /// Every period, at its end, in order; some 20 ms later. On the attending thread.
  virtual void on_period(const Period& period) = 0;
  /// An episode is over. On the thread of the rollout, beside on_period().
  virtual void on_episode(const RolloutTask& /*task*/, const RolloutSegment& /*segment*/) {}
};

/// Asks of keys and signals on this machine; what is new since the last call.
struct OperatorWishes {
  bool arm = false, held = false, stop = false, acknowledge = false, end = false;
  char key = 0;  ///< typed; 0: none
};

/// A robot on the wire and the loop that talks to it: from its constructor on periods run. A thread
/// of its own takes the operator's wishes and tells the observers.
class GatewaySession {
 public:
  /// `robot` sends the stream, `port` is where it arrives. Throws Error for a port in use.
  GatewaySession(const UdpAddress& robot, std::uint16_t port, const SafetySetup& safety,
                 bool dry_run);
  ~GatewaySession();

  /// From here on; once. `wishes` is asked on a thread of its own, again and again, and may wait
  /// for 20 ms; observers must outlive the session.
  void attend(std::function<OperatorWishes()> wishes, std::vector<GatewayObserver*> observers);
  /// Holds the arm and ends the periods; the observers have seen all of them when it returns.
  void end();

  /// For one thread.
  ControlPort& port() { return real_time_; }
  OperatorEvents& events() { return events_; }
  Clock& clock() { return clock_; }
  const SafetySetup& safety() const { return control_.setup(); }
  bool ended() const { return real_time_.ended(); }
  /// After end().
  const LoopTimes& times() const { return real_time_.times(); }

 private:
  void take(const OperatorWishes& wishes);
  void tell();

  UdpSocket socket_;
  SteadyClock clock_;
  ControlLoop control_;
  OperatorEvents events_;
  RealTimeLoop real_time_;
  std::vector<GatewayObserver*> observers_;
  std::atomic<bool> end_{false};
  std::thread attendant_;  // last: uses everything above
};

}  // namespace omentum
