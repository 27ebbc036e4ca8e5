#pragma once

#include <atomic>

#include "dvrk_gateway/loop/session.h"
#include "dvrk_gateway/operator_keys.h"

namespace omentum {

/// From now on SIGUSR1 arms, SIGUSR2 stops, SIGINT and SIGTERM end: what keys do, for scripts and
/// foot pedals.
void catch_operator_signals();
/// SIGINT or SIGTERM came.
bool end_was_signalled();

/// Keys and signals of this machine as wishes (docs/dvrk.md 8.2). One thread.
class OperatorDesk {
 public:
  /// Waits up to 20 ms for a key.
  OperatorWishes ask();

 private:
  OperatorKeys keys_;
};

/// Prints one line for each change that an operator must know of.
class OperatorScreen final : public GatewayObserver {
 public:
  /// `teaches`: the keys begin and end a demonstration.
  explicit OperatorScreen(bool teaches) : teaches_(teaches) {}

  void on_period(const Period& period) override;
  /// The session is about to end as it should: the stop that holds the arm is none to tell of.
  void end_follows() { ending_ = true; }

 private:
  bool teaches_, told_keys_ = false;
  SafetyPhase phase_ = SafetyPhase::kListening;
  StopReason reason_ = StopReason::kNone;
  bool heard_others_ = false, moved_ = false;
  std::atomic<bool> ending_{false};
};

}  // namespace omentum
