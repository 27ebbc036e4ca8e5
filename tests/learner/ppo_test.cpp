// Whole updates: equality over threads, resume, schedules, and learning of small known problems.

#include "learner/ppo.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "learner/segment_check.h"
#include "tests/learner/toy.h"

namespace omentum {
namespace {

PolicyShape toy_shape(int observations, std::vector<int> branches, int hidden) {
  PolicyShape shape;
  shape.observations = observations;
  shape.continuous = branches.empty();
  shape.branches = std::move(branches);
  shape.hidden = hidden;
  return shape;
}

pb::Config toy_config(std::uint32_t slots, std::uint64_t max_steps) {
  pb::Config config;
  config.mutable_rollout()->set_slots(slots);
  config.mutable_rollout()->set_max_steps(max_steps);
  config.mutable_ppo()->set_hidden(64);
  return config;
}

template <typename Kind>
Batch collect(Ppo& ppo, toy::Slots<Kind>& slots, std::uint32_t steps) {
  Policy behaviour(ppo.shape(), ppo.weights());
  std::vector<RolloutTask> tasks;
  const std::vector<RolloutSegment> segments = slots.collect(behaviour, steps, &tasks);
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const Result<void> result = check_segment(segments[i], ppo.shape(), tasks[i]);
    EXPECT_TRUE(result.has_value()) << result.error();
  }
  Batch batch = assemble(segments, ppo.shape());
  const LogProbCheck check = complete_batch(behaviour, batch);
  EXPECT_EQ(check.largest_log_prob_difference, 0.0);
  EXPECT_EQ(check.largest_value_difference, 0.0);
  return batch;
}

std::string hash_after(const pb::Config& config, int threads, int updates, int split_at = -1) {
  const PolicyShape shape = toy_shape(6, {3, 3, 3, 2}, 64);
  auto ppo = std::make_unique<Ppo>(config, shape, threads);
  toy::Slots<toy::Reach> slots(1, 4, 50);
  for (int k = 0; k < updates; ++k) {
    if (k ==
        split_at) {  // as a crash and resume would: everything through the checkpoint's message
      pb::PpoState state;
      ppo->save(state);
      pb::PpoState read;
      read.ParseFromString(state.SerializeAsString());
      ppo = std::make_unique<Ppo>(config, shape, threads);
      const Result<void> result = ppo->load(read);
      EXPECT_TRUE(result.has_value()) << result.error();
    }
    ppo->update(collect(*ppo, slots, 150));
  }
  return hex(ppo->weights().weights_hash);
}

TEST(Ppo, ThreadsNeverChangeABit) {
  pb::Config config = toy_config(4, 100'000);
  config.mutable_ppo()->set_minibatch(250);  // chunks of 64, 64, 64, 58 and a remainder of 100
  const std::string one = hash_after(config, 1, 3);
  EXPECT_EQ(hash_after(config, 2, 3), one);
  EXPECT_EQ(hash_after(config, 4, 3), one);
  config.mutable_rollout()->set_run_seed(2);
  EXPECT_NE(hash_after(config, 1, 3), one);
}

TEST(Ppo, SavedAndLoadedContinuesBitForBit) {
  pb::Config config = toy_config(4, 100'000);
  config.mutable_ppo()->set_scale_rewards(true);
  config.mutable_ppo()->set_learning_rate_schedule(pb::SCHEDULE_KL_ADAPTIVE);
  EXPECT_EQ(hash_after(config, 1, 4, 2), hash_after(config, 1, 4));
}

TEST(Ppo, LoadRefusesAnotherNetwork) {
  const pb::Config config = toy_config(4, 100'000);
  Ppo small(config, toy_shape(6, {3, 3, 3, 2}, 32), 1);
  Ppo large(config, toy_shape(6, {3, 3, 3, 2}, 64), 1);
  pb::PpoState state;
  small.save(state);
  const std::string before = hex(large.weights().weights_hash);
  EXPECT_FALSE(large.load(state).has_value());
  EXPECT_FALSE(large.initialise_from(state).has_value());
  EXPECT_EQ(hex(large.weights().weights_hash), before);
  EXPECT_FALSE(small.load(pb::PpoState()).has_value());
}

TEST(Ppo, FirstMinibatchHasRatioOne) {
  pb::Config config = toy_config(4, 100'000);
  config.mutable_ppo()->set_normalise_observations(false);
  config.mutable_ppo()->set_epochs(1);
  config.mutable_ppo()->set_minibatch(600);
  Ppo ppo(config, toy_shape(6, {3, 3, 3, 2}, 64), 1);
  toy::Slots<toy::Reach> slots(1, 4, 50);
  const UpdateStats stats = ppo.update(collect(ppo, slots, 150));
  // The training kernel's forward is the behaviour policy's, so the ratio is 1 to the last bit.
  EXPECT_EQ(stats.ratio_min, 1.0);
  EXPECT_EQ(stats.ratio_max, 1.0);
  EXPECT_EQ(stats.value_delta, 0.0);
  EXPECT_EQ(stats.approx_kl, 0.0);
  EXPECT_EQ(stats.minibatches, 1u);
  EXPECT_NEAR(stats.entropy, 3 * std::log(3.0) + std::log(2.0),
              1e-3);  // fresh policy head of size 0.01
}

TEST(Ppo, SchedulesFollowStepsTotal) {
  pb::Config config = toy_config(4, 1200);
  pb::Ppo& ppo_config = *config.mutable_ppo();
  ppo_config.set_learning_rate(3e-4);
  ppo_config.set_learning_rate_end(1e-10);
  ppo_config.set_clip(0.2);
  ppo_config.set_clip_end(0.1);
  ppo_config.set_entropy(5e-3);
  ppo_config.set_entropy_end(1e-5);
  Ppo ppo(config, toy_shape(6, {3, 3, 3, 2}, 32), 1);
  toy::Slots<toy::Reach> slots(1, 4, 50);
  const UpdateStats first = ppo.update(collect(ppo, slots, 75));
  EXPECT_DOUBLE_EQ(first.learning_rate, 3e-4);
  EXPECT_DOUBLE_EQ(first.clip, 0.2);
  ppo.update(collect(ppo, slots, 75));
  const UpdateStats third = ppo.update(collect(ppo, slots, 75));  // at half of max_steps
  EXPECT_NEAR(third.learning_rate, (3e-4 + 1e-10) / 2, 1e-15);
  EXPECT_NEAR(third.clip, 0.15, 1e-15);
  EXPECT_NEAR(third.entropy_coefficient, (5e-3 + 1e-5) / 2, 1e-15);
  EXPECT_EQ(ppo.steps_total(), 900u);
  EXPECT_EQ(ppo.version(), 3u);
}

TEST(Ppo, SwitchesOfTheLoopDoWhatTheySay) {
  pb::Config config = toy_config(4, 100'000);
  pb::Ppo& p = *config.mutable_ppo();
  const PolicyShape shape = toy_shape(6, {3, 3, 3, 2}, 32);
  const auto run = [&] {
    Ppo ppo(config, shape, 1);
    toy::Slots<toy::Reach> slots(1, 4, 50);
    const Batch batch = collect(ppo, slots, 150);
    int calls = 0;
    const UpdateStats stats = ppo.update(batch, [&] { ++calls; });
    EXPECT_EQ(calls, static_cast<int>(stats.minibatches));
    return stats;
  };
  EXPECT_EQ(run().minibatches, 4u * 3);  // 600 rows: 256 + 256 + 88
  p.set_drop_remainder(true);
  EXPECT_EQ(run().minibatches, 4u * 2);
  p.set_target_kl(1e-9);
  const UpdateStats stopped = run();
  EXPECT_TRUE(stopped.stopped_by_kl);
  EXPECT_EQ(stopped.epochs, 1u);
  p.clear_target_kl();
  p.set_minibatch(100'000);
  EXPECT_EQ(run().minibatches, 4u);  // capped at the batch
  p.set_max_gradient_norm(0);
  for (const pb::AdvantageNorm norm :
       {pb::ADVANTAGE_NONE, pb::ADVANTAGE_MINIBATCH, pb::ADVANTAGE_BATCH}) {
    p.set_advantage_norm(norm);
    EXPECT_TRUE(std::isfinite(run().policy_loss));
  }
}

// --- learning
// -------------------------------------------------------------------------------------------------

double recent(const std::vector<double>& returns, std::size_t count) {
  const std::size_t n = std::min(count, returns.size());
  return std::accumulate(returns.end() - static_cast<std::ptrdiff_t>(n), returns.end(), 0.0) /
         static_cast<double>(n);
}

template <typename Kind>
double learn(const pb::Config& config, const PolicyShape& shape, std::uint32_t steps,
             std::uint32_t limit) {
  Ppo ppo(config, shape, 1);
  toy::Slots<Kind> slots(config.rollout().run_seed(), static_cast<int>(config.rollout().slots()),
                         limit);
  while (ppo.steps_total() < config.rollout().max_steps()) ppo.update(collect(ppo, slots, steps));
  return recent(slots.finished_returns(), 50);
}

// Thresholds: mean return of the last 50 training episodes. A random policy scores about -12 at
// Reach.
TEST(PpoLearns, FourBranchReach) {
  for (const std::uint64_t seed : {1u, 2u}) {
    pb::Config config = toy_config(16, 150'000);
    config.mutable_rollout()->set_run_seed(seed);
    config.mutable_ppo()->set_learning_rate(3e-3);
    EXPECT_GT(learn<toy::Reach>(config, toy_shape(6, {3, 3, 3, 2}, 64), 128, 40), -6.0)
        << "seed " << seed;
  }
}

TEST(PpoLearns, FourBranchReachPerBranchSwishPaperForms) {
  pb::Config config = toy_config(16, 150'000);
  pb::Ppo& p = *config.mutable_ppo();
  p.set_learning_rate(3e-3);
  p.set_initialisation(pb::INIT_VARIANCE_SCALING);
  p.set_head_bias(false);
  p.set_adam(pb::ADAM_TENSORFLOW);
  p.set_adam_epsilon(1e-8);
  p.set_advantage_norm(pb::ADVANTAGE_BATCH);
  p.set_value_clip(true);
  p.set_max_gradient_norm(0);
  p.set_time_horizon(16);
  p.set_ratio(pb::RATIO_PER_BRANCH);
  p.set_entropy(1e-3);
  p.set_normalise_observations(false);
  PolicyShape shape = toy_shape(6, {3, 3, 3, 2}, 64);
  shape.head_bias = false;
  shape.activation = pb::ACTIVATION_SWISH;
  EXPECT_GT(learn<toy::Reach>(config, shape, 128, 40), -6.0);
}

TEST(PpoLearns, GaussianReach) {
  pb::Config config = toy_config(16, 150'000);
  config.mutable_ppo()->set_learning_rate(3e-3);
  config.mutable_ppo()->set_entropy(0);
  config.mutable_ppo()->set_entropy_end(0);
  EXPECT_GT(learn<toy::ContinuousReach>(config, toy_shape(6, {}, 64), 128, 40), -5.0);
}

TEST(PpoLearns, CartPole) {
  pb::Config config = toy_config(8, 100'000);
  config.mutable_ppo()->set_learning_rate(1e-3);
  config.mutable_ppo()->set_entropy(0);
  config.mutable_ppo()->set_entropy_end(0);
  EXPECT_GT(learn<toy::CartPole>(config, toy_shape(4, {2}, 64), 128, 500), 400);
}

}  // namespace
}  // namespace omentum
