// The policy that the gateway takes from the bus: pinned for an episode, another between two.
#include <gtest/gtest.h>

#include "core/check.h"
#include "core/config.h"
#include "dvrk_gateway/bus/bus_policy_source.h"
#include "tests/dvrk_gateway/small_learner.h"
#include "tests/support/domain.h"

namespace omentum {
namespace {

using test::SmallLearner;

bool never() { return false; }

TEST(BusPolicySource, OneVersionIsPinnedAndTheNextIsTakenBetweenEpisodes) {
  const test::PrivateDomain domain;
  SmallLearner learner(domain.id());
  learner.offer();
  learner.publish(learner.weights(3));
  GatewayBus bus(domain.id(), test::loopback_profile());
  const auto source = BusPolicySource::wait(bus, "r", never);
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
  GatewayBus bus(domain.id(), test::loopback_profile());
  const auto source = BusPolicySource::wait(bus, "r", never);
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
  GatewayBus bus(domain.id(), test::loopback_profile());
  const auto source = BusPolicySource::wait(bus, "r", never);
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
  GatewayBus bus(domain.id(), test::loopback_profile());
  try {
    (void)BusPolicySource::wait(bus, "r", never);
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
  GatewayBus bus(domain.id(), test::loopback_profile());
  EXPECT_EQ(refused([&] { (void)BusPolicySource::wait(bus, "r", never); }),
            "--policy bus, version 3" + why);
  SavedPolicy saved;
  saved.path = "runs/x";
  saved.config = learner.config;
  saved.weights = learner.weights(3);
  EXPECT_EQ(refused([&] { FilePolicySource source(saved); }), "--policy runs/x" + why);
}

TEST(BusPolicySource, WaitingEndsWhenTheOperatorDoes) {
  const test::PrivateDomain domain;
  GatewayBus bus(domain.id(), test::loopback_profile());
  int asked = 0;
  EXPECT_FALSE(BusPolicySource::wait(bus, "r", [&] { return ++asked > 3; }));
}

}  // namespace
}  // namespace omentum
