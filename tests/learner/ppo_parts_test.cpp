// The parts of PPO one by one: advantages, normaliser, Adam, shuffle, initialisation, segment
// checks.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numeric>

#include "learner/adam.h"
#include "learner/advantage.h"
#include "learner/batch.h"
#include "learner/initialise.h"
#include "learner/normaliser.h"
#include "tests/learner/toy.h"

namespace omentum {
namespace {

// --- advantages
// -----------------------------------------------------------------------------------------------

/// One slot, reward 1, gamma 0.99, exact values 100 everywhere: every true advantage is 0.
Batch endless(int steps, std::uint32_t first_episode_step = 0) {
  Batch batch;
  batch.slots = 1;
  batch.steps = steps;
  const auto n = static_cast<std::size_t>(steps);
  batch.rewards.assign(n, 1);
  batch.values.assign(n, 100);
  batch.flags.assign(n, 0);
  batch.final_index.assign(n, -1);
  batch.bootstrap_values = {100};
  for (std::size_t i = 0; i < n; ++i)
    batch.episode_step.push_back(first_episode_step + static_cast<std::uint32_t>(i));
  return batch;
}

std::vector<float> advantages(const Batch& batch, const AdvantageSettings& settings) {
  std::vector<float> advantage(batch.rows()), returns(batch.rows());
  estimate_advantages(batch, batch.rewards, settings, advantage, returns);
  for (std::size_t i = 0; i < batch.rows(); ++i)
    EXPECT_NEAR(returns[i], advantage[i] + batch.values[i], 1e-4);
  return advantage;
}

TEST(Advantage, TruncationIsNotTermination) {
  Batch batch = endless(200);
  batch.flags.back() = step_flag::kTruncated;
  batch.final_index.back() = 0;
  batch.final_values = {100};
  for (const float a : advantages(batch, {})) EXPECT_NEAR(a, 0, 1e-9);

  AdvantageSettings wrong;
  wrong.bootstrap_truncation = false;
  const std::vector<float> a = advantages(batch, wrong);
  EXPECT_NEAR(a[199], -99.0, 1e-4);  // digits as printed in docs/learner.md 4
  EXPECT_NEAR(a[190], -56.9986, 1e-4);
  EXPECT_NEAR(a[100], -0.2281, 1e-4);
}

TEST(Advantage, TerminationHasNoFuture) {
  Batch batch = endless(200);
  batch.flags[99] = step_flag::kTerminated;
  const std::vector<float> a = advantages(batch, {});
  EXPECT_NEAR(a[99], -99.0, 1e-4);
  for (std::size_t i = 100; i < 200; ++i) EXPECT_NEAR(a[i], 0, 1e-9);
}

TEST(Advantage, EqualsTheSumOfDiscountedErrors) {
  Batch batch = endless(5);
  batch.rewards = {1, -2, 0.5F, 3, 0.25F};
  batch.values = {0.5F, 1, -1, 2, 0};
  batch.bootstrap_values = {4};
  const AdvantageSettings s{0.9, 0.8, 0, true};
  const std::vector<float> a = advantages(batch, s);
  std::vector<double> delta;
  for (std::size_t i = 0; i < 5; ++i) {
    const double next = i == 4 ? 4 : static_cast<double>(batch.values[i + 1]);
    delta.push_back(static_cast<double>(batch.rewards[i]) + 0.9 * next -
                    static_cast<double>(batch.values[i]));
  }
  for (std::size_t i = 0; i < 5; ++i) {
    double sum = 0;
    for (std::size_t k = i; k < 5; ++k)
      sum += std::pow(0.72, static_cast<double>(k - i)) * delta[k];
    EXPECT_NEAR(static_cast<double>(a[i]), sum, 1e-6);
  }
}

TEST(Advantage, TimeHorizonCutsCountFromTheEpisodeStart) {
  Batch batch =
      endless(10, 3);  // steps 3 ... 12 of the episode: cuts of 4 lie after steps 3, 7, 11
  batch.rewards.assign(10, 0);
  batch.values.assign(10, 0);
  batch.bootstrap_values = {0};
  batch.rewards[6] = 1;  // episode step 9: flows back to step 8, not over the cut to step 7
  const std::vector<float> a = advantages(batch, {1, 1, 4, true});
  EXPECT_THAT(a, testing::ElementsAre(0, 0, 0, 0, 0, 1, 1, 0, 0, 0));
}

TEST(MeanDeviation, SampleAndPopulation) {
  const std::vector<float> values = {1, 2, 3, 4, 100};
  const std::vector<std::uint32_t> rows = {0, 1, 2, 3};
  EXPECT_DOUBLE_EQ(mean_deviation(values, rows, false).mean, 2.5);
  EXPECT_NEAR(mean_deviation(values, rows, false).deviation, std::sqrt(5.0 / 3), 1e-12);
  EXPECT_NEAR(mean_deviation(values, rows, true).deviation, std::sqrt(5.0 / 4), 1e-12);
}

// --- normaliser
// -----------------------------------------------------------------------------------------------

std::vector<double> samples(std::size_t count) {
  std::vector<double> values;
  for (std::uint32_t i = 0; i < count; ++i) {
    values.push_back(1000 + 3 * static_cast<double>(uniform_24(philox({i, 1, 1, 1}, {1, 1})[0])));
  }
  return values;
}

TEST(RunningMoments, MergingPartsEqualsOnePass) {
  const std::vector<double> values = samples(3 * 999);
  RunningMoments whole(3), parts(3);
  whole.merge(std::span<const double>(values));
  std::size_t from = 0;
  for (const std::size_t rows : {1u, 10u, 500u, 2u, 486u}) {
    parts.merge(std::span<const double>(values).subspan(from, rows * 3));
    from += rows * 3;
  }
  ASSERT_EQ(from, values.size());
  EXPECT_EQ(parts.count(), whole.count());
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(parts.mean()[i], whole.mean()[i],
                1e-11 * whole.mean()[i]);  // rounding of a sum of 1000 doubles
    EXPECT_NEAR(parts.variance(i), whole.variance(i), 1e-9 * whole.variance(i));
    EXPECT_NEAR(whole.variance(i), 9.0 / 12, 0.05);  // uniform of width 3
  }
}

TEST(RunningMoments, StartAsIdentity) {
  const FrozenNormaliser frozen = freeze(RunningMoments(2));
  EXPECT_THAT(frozen.mean, testing::ElementsAre(0.0F, 0.0F));
  EXPECT_THAT(frozen.inverse_deviation, testing::ElementsAre(1.0F, 1.0F));
}

TEST(RewardScaler, DividesByTheDeviationOfTheDiscountedReturn) {
  RewardScaler scaler(1, 0.5);
  Batch batch = endless(4);
  batch.rewards = {1, 2, 3, 4};
  batch.flags[1] = step_flag::kTerminated;
  std::vector<float> scaled(4);
  scaler.scale(batch, scaled);
  const std::vector<double> sums = {1, 2.5, 3, 5.5};  // the return starts again after the end
  const double mean = 3;
  double variance = 0;
  for (const double s : sums) variance += (s - mean) * (s - mean) / 4;
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_NEAR(static_cast<double>(scaled[i]),
                static_cast<double>(batch.rewards[i]) / std::sqrt(variance), 1e-6);
  }
}

// --- Adam
// -----------------------------------------------------------------------------------------------

TEST(Adam, BothFormsFollowTheirPapers) {
  for (const pb::AdamForm form : {pb::ADAM_TORCH, pb::ADAM_TENSORFLOW}) {
    pb::Ppo settings;
    settings.set_adam(form);
    settings.set_adam_epsilon(1e-3);  // large, so that the forms differ visibly
    Adam adam(settings, 16);
    std::vector<float> parameters(16, 1.0F);
    std::vector<double> p(16, 1.0), m(16, 0.0), v(16, 0.0);
    for (int t = 1; t <= 20; ++t) {
      std::vector<float> gradient(16);
      for (std::size_t i = 0; i < 16; ++i)
        gradient[i] = 0.01F * static_cast<float>(i) * static_cast<float>(t % 3 - 1) + 1e-3F;
      adam.begin_step(0.01);
      adam.apply(0, 16, 0.5F, gradient, parameters);
      for (std::size_t i = 0; i < 16; ++i) {
        const double g = 0.5 * static_cast<double>(gradient[i]);
        m[i] = 0.9 * m[i] + 0.1 * g;
        v[i] = 0.999 * v[i] + 0.001 * g * g;
        const double one = 1 - std::pow(0.9, t), two = 1 - std::pow(0.999, t);
        p[i] -= form == pb::ADAM_TORCH
                    ? 0.01 * (m[i] / one) / (std::sqrt(v[i] / two) + 1e-3)
                    : 0.01 * std::sqrt(two) / one * m[i] / (std::sqrt(v[i]) + 1e-3);
      }
    }
    for (std::size_t i = 0; i < 16; ++i)
      EXPECT_NEAR(static_cast<double>(parameters[i]), p[i], 3e-6) << i;  // 20 f32 steps
  }
}

TEST(Adam, RangesGiveTheSameBits) {
  pb::Ppo settings;
  Adam whole(settings, 64), parts(settings, 64);
  std::vector<float> a(64, 0.5F), b = a, gradient(64);
  for (std::size_t i = 0; i < 64; ++i) gradient[i] = 0.1F * static_cast<float>(i) - 2;
  whole.begin_step(1e-3);
  whole.apply(0, 64, 0.7F, gradient, a);
  parts.begin_step(1e-3);
  parts.apply(40, 64, 0.7F, gradient, b);
  parts.apply(0, 40, 0.7F, gradient, b);
  EXPECT_EQ(a, b);
}

// --- shuffle
// -----------------------------------------------------------------------------------------------

TEST(Shuffle, IsAPermutationOfItsArguments) {
  std::vector<std::uint32_t> rows = shuffled_rows(1, 2, 3, 1000);
  EXPECT_EQ(rows, shuffled_rows(1, 2, 3, 1000));
  EXPECT_NE(rows, shuffled_rows(1, 2, 4, 1000));
  EXPECT_NE(rows, shuffled_rows(1, 3, 3, 1000));
  EXPECT_NE(rows, shuffled_rows(2, 2, 3, 1000));
  std::sort(rows.begin(), rows.end());
  for (std::uint32_t i = 0; i < 1000; ++i) ASSERT_EQ(rows[i], i);
}

TEST(Shuffle, EveryOrderIsEquallyLikely) {
  std::array<int, 24> counts{};
  constexpr int kDraws = 24'000;
  for (std::uint64_t batch = 0; batch < kDraws; ++batch) {
    const std::vector<std::uint32_t> r = shuffled_rows(9, batch, 0, 4);
    // Rank of the permutation in lexical order.
    std::size_t rank = 0, factorial = 6;
    for (std::size_t i = 0; i < 3; ++i) {
      std::size_t smaller = 0;
      for (std::size_t j = i + 1; j < 4; ++j) smaller += r[j] < r[i] ? 1 : 0;
      rank += smaller * factorial;
      factorial /= 3 - i;
    }
    ++counts[rank];
  }
  double chi = 0;
  for (const int count : counts) chi += (count - 1000.0) * (count - 1000.0) / 1000.0;
  EXPECT_LT(chi, 49.7);  // 23 degrees of freedom, p = 0.001
}

// --- initialisation
// -------------------------------------------------------------------------------------------

PolicyShape shape_of(int observations, int hidden) {
  PolicyShape shape;
  shape.observations = observations;
  shape.branches = {3, 3, 3, 2};
  shape.hidden = hidden;
  return shape;
}

TEST(Initialise, OrthogonalRowsAndColumns) {
  const PolicyShape shape = shape_of(14, 64);
  const std::vector<float> p = initial_parameters(shape, pb::Ppo(), 3);
  const ParameterLayout layout = parameter_layout(shape);
  const auto dot = [&](std::size_t a, std::size_t b, std::size_t count, std::size_t stride) {
    double sum = 0;
    for (std::size_t i = 0; i < count; ++i)
      sum += static_cast<double>(p[a + i * stride]) * static_cast<double>(p[b + i * stride]);
    return sum;
  };
  for (std::size_t i = 0; i < 14; ++i) {
    for (std::size_t j = 0; j < 14; ++j) {
      EXPECT_NEAR(dot(layout.actor.weights1 + i * 64, layout.actor.weights1 + j * 64, 64, 1),
                  i == j ? 2 : 0, 1e-6);
    }
  }
  for (std::size_t i = 0; i < 64; ++i) {
    for (std::size_t j = 0; j < 64; ++j) {
      EXPECT_NEAR(dot(layout.critic.weights2 + i, layout.critic.weights2 + j, 64, 64),
                  i == j ? 2 : 0, 1e-6);
    }
  }
  EXPECT_NEAR(dot(layout.actor.head, layout.actor.head, 64, 1), 1e-4, 1e-9);
  EXPECT_NEAR(dot(layout.critic.head, layout.critic.head, 64, 1), 1, 1e-6);
  for (std::size_t i = 0; i < 64; ++i) EXPECT_EQ(p[layout.actor.bias1 + i], 0);
}

TEST(Initialise, VarianceScalingIsCutAndScaled) {
  const PolicyShape shape = shape_of(14, 128);
  pb::Ppo settings;
  settings.set_initialisation(pb::INIT_VARIANCE_SCALING);
  const std::vector<float> p = initial_parameters(shape, settings, 3);
  const ParameterLayout layout = parameter_layout(shape);
  const auto deviation = [&](std::size_t from, std::size_t count) {
    return mean_deviation(std::span(p).subspan(from, count), {}, true).deviation;
  };
  EXPECT_NEAR(deviation(layout.actor.weights2, 128 * 128), std::sqrt(1.0 / 128),
              0.0015);  // 4 sigma of 16384 draws
  EXPECT_NEAR(deviation(layout.actor.head, 11 * 128), std::sqrt(0.01 / 128), 0.0005);
  const double cut = 2 * std::sqrt(1.0 / 128) / 0.8796;
  for (std::size_t i = 0; i < 128 * 128; ++i)
    EXPECT_LE(std::abs(p[layout.actor.weights2 + i]), cut * 1.0001);
  const double limit = std::sqrt(6.0 / 129);
  for (std::size_t i = 0; i < 128; ++i) EXPECT_LE(std::abs(p[layout.critic.head + i]), limit);
  EXPECT_NEAR(deviation(layout.critic.head, 128), limit / std::sqrt(3.0), 0.03);
}

TEST(Initialise, DependsOnTheSeed) {
  const PolicyShape shape = shape_of(8, 32);
  EXPECT_EQ(initial_parameters(shape, pb::Ppo(), 3), initial_parameters(shape, pb::Ppo(), 3));
  EXPECT_NE(initial_parameters(shape, pb::Ppo(), 3), initial_parameters(shape, pb::Ppo(), 4));
}

// --- segments
// -----------------------------------------------------------------------------------------------

struct Collected {
  PolicyShape shape = shape_of(6, 32);
  std::vector<RolloutTask> tasks;
  std::vector<RolloutSegment> segments;
  PolicyWeights weights;
};

Collected collect_walk(int slots = 3, std::uint32_t steps = 50, std::uint32_t limit = 20,
                       int batches = 2) {
  Collected c;
  c.weights.parameters = initial_parameters(c.shape, pb::Ppo(), 1);
  Policy policy(c.shape, c.weights);
  toy::Slots<toy::Reach> env(1, slots, limit);
  for (int i = 0; i < batches; ++i) {
    c.tasks.clear();
    c.segments = env.collect(policy, steps, &c.tasks);
  }
  return c;
}

TEST(Batch, OrderOfArrivalDoesNotMatter) {
  Collected c = collect_walk();
  const Batch forward = assemble(c.segments, c.shape);
  std::reverse(c.segments.begin(), c.segments.end());
  const Batch backward = assemble(c.segments, c.shape);
  EXPECT_EQ(forward.observations, backward.observations);
  EXPECT_EQ(forward.final_index, backward.final_index);
  EXPECT_EQ(forward.slot_ids, (std::vector<std::uint32_t>{0, 1, 2}));
  // 50 steps per segment, episodes of 20: the second segment starts at episode step 10.
  EXPECT_EQ(forward.episode_step[0], 10u);
  EXPECT_EQ(forward.episode_step[9], 19u);
  EXPECT_EQ(forward.episode_step[10], 0u);
}

TEST(CompleteBatch, DifferenceIsExactlyZero) {
  const Collected c = collect_walk();
  Batch batch = assemble(c.segments, c.shape);
  Policy policy(c.shape, c.weights);
  const LogProbCheck check = complete_batch(policy, batch);
  EXPECT_EQ(check.largest_log_prob_difference, 0.0);
  EXPECT_EQ(check.largest_value_difference, 0.0);
  EXPECT_EQ(batch.final_values.size() * 6, batch.final_observations.size());
}

TEST(CompleteBatch, OneFlippedBitIsFound) {
  const Collected c = collect_walk();
  Batch batch = assemble(c.segments, c.shape);
  batch.observations[static_cast<std::size_t>(60 * 6)] += 1e-3F;  // slot 1, step 10
  Policy policy(c.shape, c.weights);
  const LogProbCheck check = complete_batch(policy, batch);
  EXPECT_GT(check.largest_log_prob_difference, 0.0);
  EXPECT_EQ(check.slot, 1u);
  EXPECT_EQ(check.step, 10u);
}

}  // namespace
}  // namespace omentum
