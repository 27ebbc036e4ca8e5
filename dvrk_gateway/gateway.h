#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include "core/policy.h"
#include "dvrk_gateway/backend/dvrk_backend.h"
#include "dvrk_gateway/bus/bus_observers.h"
#include "dvrk_gateway/bus/bus_policy_source.h"
#include "dvrk_gateway/gateway_options.h"
#include "dvrk_gateway/gateway_setup.h"
#include "dvrk_gateway/loop/session.h"
#include "dvrk_gateway/operator_screen.h"
#include "dvrk_gateway/recording/gateway_recording.h"

namespace omentum {

/// A policy, its scene and a robot, in one of the modes that run episodes. The operator's keys and
/// signals work from the constructor on.
class Gateway {
 public:
  /// `more` are told of periods and episodes beside screen, bus and recording, and outlive the
  /// gateway. Null when the program was told to end while it waited for bus or policy. Throws
  /// Error: one line with the option, for what is wrong at the start.
  static std::unique_ptr<Gateway> start(const GatewayOptions& options,
                                        std::vector<GatewayObserver*> more);
  ~Gateway();

  /// One episode: leads the arm to its start when the operator has armed, runs, holds. An episode
  /// that was stopped has `failed` set, a reason and its steps. Nothing when the program ends.
  std::optional<RolloutSegment> run_episode(const RolloutTask& task);
  /// From a start of the set, with the hold at p_T at its end; actions as the options say.
  /// Pins the newest version of the policy for it.
  RolloutTask next_task(StartSet start_set, std::uint32_t start_index, std::uint64_t episode);
  /// Holds the arm, ends periods and recording; false where the recording lost something, which has
  /// been told.
  bool end();
  /// What simulation alone makes of the task.
  RolloutSegment predict(const RolloutTask& task) const;
  /// Waits for one of these keys; nothing when the program ends.
  std::optional<char> ask_key(std::string_view keys);

  const pb::Config& config() const { return policies_->config(); }
  /// Of the last task.
  const PolicyWeights& weights() const { return policy_->weights(); }
  ArmGuide& guide() { return *guide_; }
  GatewaySession& session() { return *session_; }
  const TaughtBackend* taught() const { return taught_; }

 private:
  Gateway(const GatewayOptions& options, std::unique_ptr<GatewayBus> bus,
          std::unique_ptr<PolicySource> policies, std::vector<GatewayObserver*> more);
  OperatorWishes ask();
  void stay_on_bus();

  GatewayOptions options_;
  std::unique_ptr<GatewayBus> bus_;
  std::unique_ptr<PolicySource> policies_;
  BusPolicySource* policies_of_bus_;  ///< policies_ with --policy bus, else null
  Policy* policy_;                    ///< pinned
  std::shared_ptr<const SimSetup> setup_;
  std::unique_ptr<SimBackend> scene_;
  OperatorDesk desk_;
  OperatorScreen screen_;
  std::vector<GatewayObserver*> observers_;
  std::atomic<bool> demonstration_begins_{false}, demonstration_ends_{false};
  std::atomic<char> key_{0};  ///< the last one that asks for nothing by itself
  std::unique_ptr<BusObservers> told_;
  std::unique_ptr<GatewayRecording> recording_;
  std::unique_ptr<GatewaySession> session_;
  std::unique_ptr<ArmGuide> guide_;
  std::unique_ptr<DvrkBackend> backend_;
  TaughtBackend* taught_ = nullptr;  ///< backend_ in mode teach
};

}  // namespace omentum
