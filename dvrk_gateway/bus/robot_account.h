#pragma once

#include <cstdint>
#include <vector>

#include "core/types.h"
#include "dvrk_gateway/loop/control_loop.h"

namespace omentum {

/// What the periods of a gateway add up to, as omentum/robot/state tells it (docs/dvrk.md 10): the
/// part of RobotStatus that comes from periods. One thread.
class RobotAccount {
 public:
  /// The setup is copied: limits and frames by which periods are told.
  explicit RobotAccount(const SafetySetup& setup);

  /// Every period, in order.
  void add(const Period& period);
  /// As of the last period; who and which policy are the caller's to fill in.
  const RobotStatus& status() const { return status_; }

 private:
  /// Durations of one second [ms].
  struct Durations {
    std::vector<double> latency, jitter, state_age;
  };
  void tell_state(const Period& period);
  void tell_places(const Period& period);
  void count(const Period& period);
  void measure(const Period& period);

  SafetySetup setup_;
  Eigen::Isometry3d X_WA_;
  RobotStatus status_;
  Durations second_;
  std::int64_t second_began_ns_ = 0;
};

}  // namespace omentum
