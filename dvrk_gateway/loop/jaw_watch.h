#pragma once

#include <atomic>

#include "dvrk_gateway/loop/session.h"

namespace omentum {

/// Whether a real jaw holds something: told to close, it stops short of where it was sent, since
/// tissue stands between its faces. Knows nothing of the scene.
class JawWatch final : public GatewayObserver {
 public:
  /// Holds when the jaw stays `gap_rad` or more above its goal for kPeriods with a goal that stands
  /// still and is below `closed_below_rad`. Where the robot tells a set-point of its own above the
  /// goal, as software that keeps the jaw from closing further does, the jaw is measured by that.
  JawWatch(double closed_below_rad, double gap_rad)
      : closed_below_rad_(closed_below_rad), gap_rad_(gap_rad) {}

  void on_period(const Period& period) override;

  /// Before an episode.
  void forget() { held_ever_ = false; }
  bool holds() const { return holds_; }
  bool held_ever() const { return held_ever_; }

 private:
  static constexpr int kPeriods = 10;  // 0.2 s: transport and the servo's lag are over
  double closed_below_rad_, gap_rad_;
  double goal_ = 0;
  int still_ = 0;
  std::atomic<bool> holds_{false}, held_ever_{false};
};

}  // namespace omentum
