// Behaviour cloning and the updates after it in which the critic learns alone.

#include <gtest/gtest.h>

#include <bit>
#include <cmath>

#include "learner/advantage.h"
#include "learner/ppo.h"
#include "tests/learner/toy.h"

namespace omentum {
namespace {

PolicyShape reach_shape(bool continuous = false) {
  PolicyShape shape;
  shape.observations = 6;
  shape.continuous = continuous;
  if (!continuous) shape.branches = {3, 3, 3, 2};
  shape.hidden = 32;
  return shape;
}

pb::Config small_config() {
  pb::Config config;
  config.mutable_rollout()->set_slots(4);
  config.mutable_ppo()->set_hidden(32);
  config.mutable_cloning()->set_epochs(40);
  config.mutable_cloning()->set_minibatch(100);  // chunks of 64 and 36, and a remainder
  config.mutable_cloning()->set_learning_rate(3e-3);
  return config;
}

/// What an expert does at Reach: straight to the goal, the gripper closed near it.
Decision expert(std::span<const float> seen) {
  Decision decision;
  float squares = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const float way = seen[axis + 3] - seen[axis];
    squares += way * way;
    decision.branch[axis] = way > 0.05F ? 2 : way < -0.05F ? 0 : 1;
    decision.continuous[axis] = std::clamp(10 * way, -1.0F, 1.0F);
  }
  decision.branch[3] = std::sqrt(squares) < 0.3F ? 1 : 0;
  decision.continuous[3] = decision.branch[3] == 1 ? 1.0F : -1.0F;
  return decision;
}

Batch demonstrations(int episodes, bool continuous = false, float unit = 1) {
  constexpr int kSteps = 30;
  Batch batch;
  batch.slots = 1;
  batch.observation_size = 6;
  for (int episode = 0; episode < episodes; ++episode) {
    toy::Reach reach;
    toy::ContinuousReach free;
    toy::Reach& environment = continuous ? free : reach;
    environment.reset(1, 100, static_cast<std::uint64_t>(episode));
    for (int i = 0; i < kSteps; ++i) {
      std::array<float, 6> seen{};
      environment.observe(seen);
      const Decision decision = expert(seen);
      batch.observations.insert(batch.observations.end(), seen.begin(), seen.end());
      batch.branches.insert(batch.branches.end(), decision.branch.begin(),
                            decision.branch.begin() + 4);
      if (continuous) {
        batch.continuous.insert(batch.continuous.end(), decision.continuous.begin(),
                                decision.continuous.end());
      }
      batch.rewards.push_back(unit * environment.step(decision).reward);
      batch.flags.push_back(i + 1 == kSteps ? step_flag::kTruncated : 0);
    }
    batch.steps += kSteps;
  }
  return batch;
}

Batch collect_reach(Ppo& ppo, toy::Slots<toy::Reach>& slots) {
  Policy behaviour(ppo.shape(), ppo.weights());
  Batch batch = assemble(slots.collect(behaviour, 50), ppo.shape());
  complete_batch(behaviour, batch);
  return batch;
}

std::string hash_of(const Ppo& ppo) { return hex(ppo.weights().weights_hash); }

TEST(Cloning, FitsActionsAndReturns) {
  for (const bool continuous : {false, true}) {
    Ppo ppo(small_config(), reach_shape(continuous), 1);
    const CloningStats stats = ppo.clone(demonstrations(20, continuous));
    EXPECT_EQ(stats.minibatches, 40u * 6);
    EXPECT_LT(stats.surprise, 0.5 * stats.first_surprise);
    EXPECT_LT(stats.value_error, 0.5 * stats.first_value_error);
  }
}

TEST(Cloning, TheGreedyPolicyDoesWhatTheExpertDoes) {
  Ppo ppo(small_config(), reach_shape(), 1);
  const Batch shown = demonstrations(40);
  ppo.clone(shown);
  const Batch others = [] {
    Batch all = demonstrations(60);
    all.observations.erase(all.observations.begin(), all.observations.begin() + 40 * 30 * 6);
    all.branches.erase(all.branches.begin(), all.branches.begin() + 40 * 30 * 4);
    return all;
  }();
  Policy policy(ppo.shape(), ppo.weights());
  const std::size_t rows = others.observations.size() / 6;
  std::vector<Decision> decisions(rows);
  policy.act(others.observations, std::vector<ActionCounter>(rows), true, decisions);
  std::size_t same = 0;
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t b = 0; b < 4; ++b)
      same += decisions[row].branch[b] == others.branches[row * 4 + b] ? 1 : 0;
  }
  // By chance 3/8 of them. Episodes that were not shown.
  EXPECT_GT(static_cast<double>(same), 0.85 * 4 * static_cast<double>(rows));
}

TEST(Cloning, ThreadsAndRepetitionNeverChangeABit) {
  pb::Config config = small_config();
  config.mutable_cloning()->set_epochs(3);
  config.mutable_ppo()->set_scale_rewards(true);
  const auto weights = [&](int threads) {
    Ppo ppo(config, reach_shape(), threads);
    ppo.clone(demonstrations(10));
    toy::Slots<toy::Reach> slots(1, 4, 40);
    ppo.update(collect_reach(ppo, slots));
    return hash_of(ppo);
  };
  const std::string one = weights(1);
  EXPECT_EQ(weights(1), one);
  EXPECT_EQ(weights(2), one);
  EXPECT_EQ(weights(3), one);
  config.mutable_rollout()->set_run_seed(2);
  EXPECT_NE(weights(1), one);
}

TEST(Cloning, EveryKnobMatters) {
  const auto weights = [](const pb::Config& config) {
    Ppo ppo(config, reach_shape(), 1);
    ppo.clone(demonstrations(5));
    return hash_of(ppo);
  };
  const std::string plain = weights(small_config());
  pb::Config config = small_config();
  config.mutable_cloning()->set_epochs(39);
  EXPECT_NE(weights(config), plain);
  config = small_config();
  config.mutable_cloning()->set_minibatch(99);
  EXPECT_NE(weights(config), plain);
  config = small_config();
  config.mutable_cloning()->set_learning_rate(2e-3);
  EXPECT_NE(weights(config), plain);
}

TEST(Cloning, ScaledRewardsHaveNoUnit) {
  pb::Config config = small_config();
  config.mutable_ppo()->set_scale_rewards(true);
  const auto clone = [&](float unit) {
    Ppo ppo(config, reach_shape(), 1);
    const CloningStats stats = ppo.clone(demonstrations(20, false, unit));
    pb::PpoState state;
    ppo.save(state);
    EXPECT_EQ(state.reward_moments().count(), 600);  // PPO goes on from the demonstrations' scale
    return stats;
  };
  const CloningStats one = clone(1);
  const CloningStats thousand = clone(1000);
  EXPECT_NEAR(one.value_error, thousand.value_error, 0.05 * one.value_error);
  EXPECT_LT(one.value_error, 0.5 * one.first_value_error);
}

TEST(Cloning, TheNormaliserBeginsWithTheDemonstrations) {
  Ppo ppo(small_config(), reach_shape(), 1);
  const Batch shown = demonstrations(20);
  ppo.clone(shown);
  const PolicyWeights weights = ppo.weights();
  for (std::size_t i = 0; i < 6; ++i) {
    double sum = 0;
    for (std::size_t row = 0; row < shown.rows(); ++row)
      sum += static_cast<double>(shown.observations[row * 6 + i]);
    EXPECT_NEAR(weights.obs_mean[i], sum / static_cast<double>(shown.rows()), 1e-5);
  }
}

TEST(DiscountedReturns, AnEndThatGoesOnIsAFixedPoint) {
  const double gamma = 0.9;
  const std::vector<float> rewards(50, -0.3F);
  std::vector<std::uint8_t> flags(50, 0);
  flags.back() = step_flag::kTruncated;
  for (const float value : discounted_returns(flags, rewards, gamma))
    EXPECT_NEAR(value, -0.3 / (1 - gamma), 1e-5);  // f32 rounding of 3
  flags.back() = step_flag::kTerminated;
  const std::vector<float> ended = discounted_returns(flags, rewards, gamma);
  EXPECT_FLOAT_EQ(ended.back(), -0.3F);
  EXPECT_NEAR(ended.front(), -0.3 * (1 - std::pow(gamma, 50)) / (1 - gamma), 1e-5);
}

TEST(DiscountedReturns, EpisodesDoNotSeeEachOther) {
  std::vector<float> rewards(20);
  for (std::size_t i = 0; i < rewards.size(); ++i) rewards[i] = std::sin(static_cast<float>(i));
  std::vector<std::uint8_t> flags(20, 0);
  flags[7] = step_flag::kTruncated;
  flags[19] = step_flag::kTerminated;
  const std::vector<float> both = discounted_returns(flags, rewards, 0.99);
  const std::vector<float> second =
      discounted_returns(std::span(flags).subspan(8), std::span(rewards).subspan(8), 0.99);
  EXPECT_TRUE(std::equal(second.begin(), second.end(), both.begin() + 8));
  rewards[12] = 5;
  const std::vector<float> changed = discounted_returns(flags, rewards, 0.99);
  EXPECT_TRUE(std::equal(changed.begin(), changed.begin() + 8, both.begin()));
}

TEST(CriticUpdates, LeaveTheActorAloneBitForBit) {
  for (const pb::RatioKind ratio : {pb::RATIO_JOINT, pb::RATIO_PER_BRANCH}) {
    pb::Config config = small_config();
    config.mutable_cloning()->set_critic_updates(2);
    config.mutable_ppo()->set_entropy(0.1);
    config.mutable_ppo()->set_ratio(ratio);
    const PolicyShape shape = reach_shape();
    const std::size_t critic = parameter_layout(shape).critic.weights1;
    Ppo ppo(config, shape, 2);
    ppo.clone(demonstrations(5));
    toy::Slots<toy::Reach> slots(1, 4, 40);
    std::vector<float> before = ppo.weights().parameters;
    const auto actor_is_same = [&](const std::vector<float>& after) {
      return std::equal(before.begin(), before.begin() + static_cast<std::ptrdiff_t>(critic),
                        after.begin(), [](float a, float b) {
                          return std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b);
                        });
    };
    for (int update = 0; update < 2; ++update) {
      const UpdateStats stats = ppo.update(collect_reach(ppo, slots));
      const std::vector<float> after = ppo.weights().parameters;
      EXPECT_TRUE(actor_is_same(after)) << update;
      EXPECT_NE(after, before) << update;
      EXPECT_GT(stats.gradient_norm, 0);
      before = after;
    }
    ppo.update(collect_reach(ppo, slots));
    EXPECT_FALSE(actor_is_same(ppo.weights().parameters));
  }
}

TEST(CriticUpdates, SavedAndLoadedContinuesBitForBit) {
  pb::Config config = small_config();
  config.mutable_cloning()->set_critic_updates(2);
  const auto weights = [&](int split_at) {
    auto ppo = std::make_unique<Ppo>(config, reach_shape(), 1);
    ppo->clone(demonstrations(5));
    toy::Slots<toy::Reach> slots(1, 4, 40);
    for (int update = 0; update < 4; ++update) {
      if (update == split_at) {
        pb::PpoState state;
        ppo->save(state);
        ppo = std::make_unique<Ppo>(config, reach_shape(), 1);
        const Result<void> loaded = ppo->load(state);
        EXPECT_TRUE(loaded.has_value());
      }
      ppo->update(collect_reach(*ppo, slots));
    }
    return hash_of(*ppo);
  };
  const std::string whole = weights(-1);
  for (const int split_at : {0, 1, 2, 3}) EXPECT_EQ(weights(split_at), whole) << split_at;
}

}  // namespace
}  // namespace omentum
