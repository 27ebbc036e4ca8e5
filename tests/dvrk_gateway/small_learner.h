#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

#include "core/config.h"
#include "core/hash.h"
#include "core/policy.h"
#include "core/wire.h"
#include "tests/support/domain.h"

namespace omentum::test {

/// Publishes what a learner does.
class SmallLearner {
 public:
  SmallLearner(std::uint32_t domain, std::uint32_t epoch = 7)
      : participant(domain, loopback_profile().uri, "omentum-learner"),
        config(load_config("omentum", std::vector<std::string>{"ppo.hidden=16"})),
        epoch_(epoch),
        manifests_(participant, public_partitions("r"), "manifest"),
        statuses_(participant, public_partitions("r"), "status"),
        weights_(participant, public_partitions("r"), "weights") {}

  void offer() {
    RunManifest manifest;
    manifest.run_id = "r";
    manifest.learner_epoch = epoch_;
    manifest.config_text = print_config(config);
    manifest.config_hash = config_hash(config);
    manifest.layout_hash = policy_shape(config).layout_hash();
    ASSERT_TRUE(manifests_.write(manifest));
    speak();
  }
  void speak() {
    LearnerStatus status;
    status.run_id = "r";
    status.learner_epoch = epoch_;
    ASSERT_TRUE(statuses_.write(status));
  }
  PolicyWeights weights(std::uint64_t version) const {
    PolicyWeights w;
    w.policy_id = static_cast<std::uint32_t>(fnv1a64(std::string("r")));
    w.learner_epoch = epoch_;
    w.policy_version = version;
    w.layout_hash = policy_shape(config).layout_hash();
    w.config_hash = config_hash(config);
    w.parameters.assign(policy_shape(config).parameter_count(),
                        0.01F * static_cast<float>(version));
    w.weights_hash = hash_weights(w.parameters, w.obs_mean, w.obs_inv_std);
    return w;
  }
  void publish(const PolicyWeights& w) { ASSERT_TRUE(weights_.write(w)); }

  dds::Participant participant;
  pb::Config config;

 private:
  std::uint32_t epoch_;
  BusWriter<RunManifest> manifests_;
  BusWriter<LearnerStatus> statuses_;
  BusWriter<PolicyWeights> weights_;
};

}  // namespace omentum::test
