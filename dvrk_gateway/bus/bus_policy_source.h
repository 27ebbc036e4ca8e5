#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "core/wire.h"
#include "dvrk_gateway/bus/gateway_bus.h"
#include "dvrk_gateway/bus/policy_source.h"
#include "sim_worker/bus/learner_choice.h"

namespace omentum {

/// The policy that the learner of a run publishes: configuration by run/manifest, weights by
/// policy/weights, from the learner that workers would follow (docs/wire.md 4.2). What does not fit
/// the configuration of the first manifest is refused, counted and told; the version before goes
/// on. One thread.
class BusPolicySource final : public PolicySource, public BusMember {
 public:
  /// Waits until a learner has offered a manifest and weights, and says so every minute; null when
  /// `stop`, which is asked every 50 ms, became true before. `bus`, from whose participant nothing
  /// else may be made yet, is made anew where it is deaf; it must outlive what is returned. Throws
  /// Error: one line, where the learner's first policy does not fit its own configuration.
  static std::unique_ptr<BusPolicySource> wait(GatewayBus& bus, const std::string& run,
                                               const std::function<bool()>& stop);

  const pb::Config& config() const override { return config_; }
  Policy& for_next_episode() override;

  /// The pinned version stays; while it has left there is no newer one.
  void leave() override;
  void join(const dds::Participant& participant) override;

  /// When a learner of the run was heard last, as far as it was looked; 0 = never.
  std::int64_t heard_ns() const { return heard_ns_; }
  /// Weights that were not taken: of strangers, with a wrong hash, or that do not fit.
  std::uint64_t refused() const { return refused_; }

 private:
  struct Readers {
    Readers(const dds::Participant& participant, const std::string& run);
    BusReader<RunManifest> manifests;
    BusReader<LearnerStatus> learners;
    BusReader<PolicyWeights> weights;
    dds::Waitset waitset;
  };

  BusPolicySource(const dds::Participant& participant, const std::string& run);

  void wait_for_arrivals();
  void take_arrivals();
  /// Weights of the learner to follow that are newer than the pinned ones; null without.
  const PolicyWeights* newer();
  bool begin();
  void refuse(const std::string& reason);

  std::string run_;
  std::uint32_t policy_id_;
  std::optional<Readers> readers_;
  std::int64_t heard_ns_ = 0;

  LearnerChoice choice_;
  std::map<std::uint64_t, PolicyWeights> newest_;  ///< by participant
  pb::Config config_;
  std::uint64_t config_hash_ = 0;
  std::unique_ptr<Policy> policy_;                ///< pinned
  std::optional<PolicyWeights> refused_weights_;  ///< told once
  std::uint64_t refused_ = 0;
};

}  // namespace omentum
