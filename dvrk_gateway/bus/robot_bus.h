#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <string>

#include "core/wire.h"
#include "dvrk_gateway/bus/gateway_bus.h"
#include "dvrk_gateway/bus/robot_account.h"
#include "dvrk_gateway/loop/session.h"

namespace omentum {

struct RobotBusOptions {
  std::string run;           ///< name of the run, not empty
  std::string arm = "PSM1";  ///< as `robot` of robot/state tells it
  bool dry_run = false;
  std::uint64_t build_id = 0;
  std::string program_version;
};

/// The gateway on the bus of a run (docs/dvrk.md 10): robot/state ten times a second and at once
/// when the phase changes, and the segment and summary of each episode, tagged as of a robot. No
/// write waits for a reader, and none happens on the thread of the control loop. After the end of
/// the certificate the robot goes on and nobody hears of it: counted and logged. What happens while
/// it is not on the bus is not published; states are told as soon as it is again.
class RobotBus final : public GatewayObserver, public BusMember {
 public:
  /// `participant` must outlive it, or leave() comes first. Throws Error: one line, for writers
  /// that cannot be made.
  RobotBus(const dds::Participant& participant, const RobotBusOptions& options,
           const SafetySetup& setup);
  /// Readers see that the gateway left on purpose.
  ~RobotBus() override;

  /// Beside on_period(), which never waits for them; not beside on_episode().
  void leave() override;
  void join(const dds::Participant& participant) override;

  /// The policy of the episodes from now on. Any thread.
  void pin(const PolicyWeights& weights);
  void on_period(const Period& period) override;
  void on_episode(const RolloutTask& task, const RolloutSegment& segment) override;

  /// In robot/state, and as worker_id in segments.
  std::uint32_t gateway_id() const { return gateway_id_; }
  /// The arm was armed in the last period that was told. Any thread.
  bool is_armed() const { return armed_; }

 private:
  struct Writers {
    Writers(const dds::Participant& joined, const std::string& run);
    const dds::Participant& participant;
    BusWriter<RobotStatus> status;        // the thread of on_period
    BusWriter<RolloutSegment> segments;   // the thread of on_episode
    BusWriter<EpisodeSummary> summaries;  // the same
  };

  void publish();
  void count_failure(const std::string& reason);

  const std::string run_;
  const std::uint32_t gateway_id_;
  const std::uint64_t build_id_;
  // The thread of on_period alone.
  RobotAccount account_;
  std::int64_t published_ns_ = 0;
  RobotPhase published_phase_ = RobotPhase::kListening;
  std::atomic<bool> armed_{false};

  std::shared_mutex joining_;       ///< held alone by who makes or ends the writers
  std::optional<Writers> writers_;  // guarded by joining_

  std::mutex mutex_;
  RobotStatus shared_;  ///< identity, policy, counts of episodes and writes; guarded by mutex_
};

}  // namespace omentum
