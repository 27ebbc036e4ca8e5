// The policy that the gateway takes from the bus: pinned for an episode, another between two.
#include <gtest/gtest.h>

#include "core/check.h"
#include "core/config.h"
#include "core/hash.h"
#include "dvrk_gateway/bus/bus_policy_source.h"
#include "tests/support/domain.h"

namespace omentum {
namespace {

/// Publishes what a learner does.
class SmallLearner {
 public:
  SmallLearner(std::uint32_t domain, std::uint32_t epoch = 7)
      : participant(domain, test::loopback_profile().uri, "learner"),
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

bool never() { return false; }

TEST(BusPolicySource, OneVersionIsPinnedAndTheNextIsTakenBetweenEpisodes) {
  const test::PrivateDomain domain;
  SmallLearner learner(domain.id());
  learner.offer();
  learner.publish(learner.weights(3));
  const auto source = BusPolicySource::wait(learner.participant, "r", never);
  ASSERT_TRUE(source);
  EXPECT_EQ(config_hash(source->config()), config_hash(learner.config));
  const Policy& pinned = source->for_next_episode();
  EXPECT_EQ(pinned.weights().policy_version, 3U);
  learner.publish(learner.weights(4));
  learner.publish(learner.weights(5));
  EXPECT_EQ(pinned.weights().policy_version, 3U) << "while the episode runs";
  EXPECT_EQ(source->for_next_episode().weights().policy_version, 5U);
  EXPECT_EQ(source->for_next_episode().weights().policy_version, 5U) << "nothing is newer";
  EXPECT_EQ(source->refused(), 0U);
}

TEST(BusPolicySource, WeightsThatDoNotFitOrAreDamagedAreRefusedAndTheOldOnesGoOn) {
  const test::PrivateDomain domain;
  SmallLearner learner(domain.id());
  learner.offer();
  learner.publish(learner.weights(3));
  const auto source = BusPolicySource::wait(learner.participant, "r", never);
  ASSERT_TRUE(source);
  PolicyWeights damaged = learner.weights(4);
  damaged.parameters[7] += 1;
  learner.publish(damaged);
  EXPECT_EQ(source->for_next_episode().weights().policy_version, 3U);
  EXPECT_EQ(source->refused(), 1U);
  PolicyWeights other = learner.weights(5);
  other.config_hash ^= 1;
  learner.publish(other);
  EXPECT_EQ(source->for_next_episode().weights().policy_version, 3U);
  EXPECT_EQ(source->for_next_episode().weights().policy_version, 3U);
  EXPECT_EQ(source->refused(), 2U) << "told once";
  PolicyWeights wide = learner.weights(6);
  wide.obs_mean.assign(3, 0);
  wide.obs_inv_std.assign(3, 1);
  wide.weights_hash = hash_weights(wide.parameters, wide.obs_mean, wide.obs_inv_std);
  learner.publish(wide);
  EXPECT_EQ(source->for_next_episode().weights().policy_version, 3U);
  learner.publish(learner.weights(7));
  EXPECT_EQ(source->for_next_episode().weights().policy_version, 7U);
  EXPECT_EQ(source->refused(), 3U);
}

TEST(BusPolicySource, AStrangerWithoutAManifestIsNotBelieved) {
  const test::PrivateDomain domain;
  SmallLearner learner(domain.id());
  learner.offer();
  learner.publish(learner.weights(3));
  const auto source = BusPolicySource::wait(learner.participant, "r", never);
  ASSERT_TRUE(source);
  SmallLearner stranger(domain.id(), 99);
  stranger.publish(stranger.weights(1000));
  learner.publish(learner.weights(4));
  EXPECT_EQ(source->for_next_episode().weights().policy_version, 4U);
}

TEST(BusPolicySource, APolicyOfOtherObservationsIsRefusedWithOneLine) {
  const test::PrivateDomain domain;
  SmallLearner learner(domain.id());
  learner.offer();
  PolicyWeights other = learner.weights(3);
  other.layout_hash ^= 1;
  learner.publish(other);
  try {
    (void)BusPolicySource::wait(learner.participant, "r", never);
    FAIL() << "taken";
  } catch (const Error& error) {
    const std::string text = error.what();
    EXPECT_EQ(text.rfind("--policy bus, version 3: made for other observations", 0), 0U) << text;
    EXPECT_EQ(text.find('\n'), std::string::npos);
  }
}

// Nothing here leads an arm whose tool turns.
TEST(BusPolicySource, APolicyThatTurnsTheToolIsRefusedWithOneLine) {
  const test::PrivateDomain domain;
  SmallLearner learner(domain.id());
  learner.config = load_config("omentum_oriented", std::vector<std::string>{"ppo.hidden=16"});
  learner.offer();
  learner.publish(learner.weights(3));
  const auto refused = [](auto take) {
    try {
      take();
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string("taken");
  };
  const std::string why =
      ": turns the tool (task.action ACTION_ORIENTED), allowed: the other actions; the arm is led "
      "with the orientation of the scene";
  EXPECT_EQ(refused([&] { (void)BusPolicySource::wait(learner.participant, "r", never); }),
            "--policy bus, version 3" + why);
  SavedPolicy saved;
  saved.path = "runs/x";
  saved.config = learner.config;
  saved.weights = learner.weights(3);
  EXPECT_EQ(refused([&] { FilePolicySource source(saved); }), "--policy runs/x" + why);
}

TEST(BusPolicySource, WaitingEndsWhenTheOperatorDoes) {
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "alone");
  int asked = 0;
  EXPECT_FALSE(BusPolicySource::wait(participant, "r", [&] { return ++asked > 3; }));
}

}  // namespace
}  // namespace omentum
