#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "core/registration.h"
#include "dvrk_gateway/loop/session.h"

namespace omentum {

/// How often and how evenly each stream of a robot renews itself, as `check` tells.
class StreamRates {
 public:
  static constexpr std::size_t kStreams = 8;

  void add(const Period& period);
  /// A line per stream: rate [Hz], longest gap [ms], valid or not; "missing" for one never seen. A
  /// gap that is long is one of the robot's clock, too, where its computer was busy; else messages
  /// were late on their way, or this computer was.
  std::string table(const RobotState& robot) const;

 private:
  struct Row {
    std::int64_t first_ns = 0, last_ns = 0, longest_gap_ns = 0;
    double stamp_s = 0;      ///< of the newest payload, by the robot's clock
    double gap_stamp_s = 0;  ///< how far it went in the longest gap
    std::uint64_t renewals = 0;
  };
  std::array<Row, kStreams> rows_{};
};

/// What `check` finds: source, streams, state, frames, where the tip is, instrument by both
/// lengths, age and figures of the registration, then "go" or "no go" with the reason.
class RobotReport final : public GatewayObserver {
 public:
  /// `registration`: the fit behind setup.mount.X_WR; null without one.
  RobotReport(const SafetySetup& setup, const Registration* registration);

  void on_period(const Period& period) override;
  /// As of the last period: the arm could be armed.
  bool ready() const { return last_.judgement.memory.phase == SafetyPhase::kReady; }
  std::string text() const;

 private:
  std::string frames() const;
  std::string instrument() const;

  SafetySetup setup_;
  std::string registration_;
  StreamRates rates_;
  Period last_;
  RobotState together_;  ///< the newest whose poses and joints are of one Timestamp
  bool is_together_ = false;
};

}  // namespace omentum
