#pragma once

#include <cstdint>

#include "dvrk_gateway/loop/control_loop.h"

namespace omentum {

/// The control loop as the thread sees it that decides where the arm goes: one request per period.
class ControlPort {
 public:
  ControlPort() = default;
  virtual ~ControlPort() = default;
  ControlPort(const ControlPort&) = delete;
  ControlPort& operator=(const ControlPort&) = delete;

  /// Hands over the request of the present period and returns at the beginning of the next: with
  /// what the robot says then, and what became of the request.
  virtual const Period& exchange(const PolicyRequest& request) = 0;
  virtual const Period& period() const = 0;
  /// The program is to end: no period follows.
  virtual bool ended() const = 0;
};

/// Simulated time, or one thread for everything: the caller's exchange() carries the periods out
/// and looks between them.
class SteppedPort final : public ControlPort {
 public:
  /// `events` is read in every period. All three must outlive it.
  SteppedPort(ControlLoop& loop, Clock& clock, const GatewayEvents& events)
      : loop_(loop), clock_(clock), events_(events), next_ns_(clock.now_ns()) {
    loop_.receive();
  }

  const Period& exchange(const PolicyRequest& request) override {
    loop_.send(request, events_);
    next_ns_ += loop_.setup().period_ns;
    while (sleep_looking(loop_, clock_, next_ns_, [this] { return events_; }))
      next_ns_ = loop_.period().began_ns + loop_.setup().period_ns;
    return loop_.receive();
  }
  const Period& period() const override { return loop_.period(); }
  bool ended() const override { return false; }

 private:
  ControlLoop& loop_;
  Clock& clock_;
  const GatewayEvents& events_;
  std::int64_t next_ns_;
};

}  // namespace omentum
