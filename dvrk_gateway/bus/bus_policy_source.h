#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "core/wire.h"
#include "dvrk_gateway/bus/policy_source.h"
#include "sim_worker/bus/learner_choice.h"

namespace omentum {

/// The policy that the learner of a run publishes: configuration by run/manifest, weights by
/// policy/weights, from the learner that workers would follow (docs/wire.md 4.2). What does not fit
/// the configuration of the first manifest is refused, counted and told; the version before goes
/// on. One thread.
class BusPolicySource final : public PolicySource {
 public:
  /// Waits until a learner has offered a manifest and weights, and says so every minute; null when
  /// `stop`, which is asked every 50 ms, became true before. `participant` must outlive it. Throws
  /// Error: one line, where the learner's first policy does not fit its own configuration.
  static std::unique_ptr<BusPolicySource> wait(const dds::Participant& participant,
                                               const std::string& run,
                                               const std::function<bool()>& stop);

  const pb::Config& config() const override { return config_; }
  Policy& for_next_episode() override;

  /// Weights that were not taken: of strangers, with a wrong hash, or that do not fit.
  std::uint64_t refused() const { return refused_; }

 private:
  BusPolicySource(const dds::Participant& participant, const std::string& run);

  void take_arrivals();
  /// Weights of the learner to follow that are newer than the pinned ones; null without.
  const PolicyWeights* newer();
  bool begin();
  void refuse(const std::string& reason);

  std::string run_;
  std::uint32_t policy_id_;
  BusReader<RunManifest> manifest_reader_;
  BusReader<LearnerStatus> learner_reader_;
  BusReader<PolicyWeights> weights_reader_;
  dds::Waitset waitset_;

  LearnerChoice choice_;
  std::map<std::uint64_t, PolicyWeights> newest_;  ///< by participant
  pb::Config config_;
  std::uint64_t config_hash_ = 0;
  std::unique_ptr<Policy> policy_;                ///< pinned
  std::optional<PolicyWeights> refused_weights_;  ///< told once
  std::uint64_t refused_ = 0;
};

}  // namespace omentum
