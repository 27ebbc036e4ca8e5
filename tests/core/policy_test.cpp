#include "core/policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <bit>
#include <cmath>
#include <cstdlib>
#include <new>
#include <numeric>

#include "core/activation.h"
#include "tests/support/plain_convolution.h"

namespace {
std::atomic<std::size_t> allocations{0};  // of this program, by the operators below
}  // namespace

// Not inlined: g++ would see malloc meet operator delete and warn.
__attribute__((noinline)) void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size == 0 ? 1 : size)) return memory;
  throw std::bad_alloc();
}
__attribute__((noinline)) void operator delete(void* memory) noexcept { std::free(memory); }
__attribute__((noinline)) void operator delete(void* memory, std::size_t) noexcept {
  std::free(memory);
}

namespace omentum {
namespace {

PolicyShape discrete_shape(int observations, pb::Activation activation, int hidden = 128) {
  PolicyShape shape;
  shape.observations = observations;
  shape.branches = {3, 3, 3, 2};
  shape.activation = activation;
  shape.hidden = hidden;
  return shape;
}

/// With roll, pitch and yaw: more logits than a panel has columns.
PolicyShape oriented_shape(int observations, pb::Activation activation) {
  PolicyShape shape = discrete_shape(observations, activation);
  shape.branches = {3, 3, 3, 2, 3, 3, 3};
  return shape;
}

PolicyShape gaussian_shape(int observations) {
  PolicyShape shape;
  shape.observations = observations;
  shape.continuous = true;
  shape.hidden = 64;
  return shape;
}

/// Three numbers and a picture of `size` pixels, seen by convolutions.
PolicyShape picture_shape_of(int size, int channels, pb::Activation activation) {
  PolicyShape shape = discrete_shape(3, activation, 24);
  shape.picture = {size, channels};
  shape.observations += shape.picture.values();
  shape.convolution = true;
  return shape;
}

/// Numbers in [-size, size] from the counters, so that tests need no generator state.
std::vector<float> noise(std::size_t count, std::uint32_t stream, float size) {
  std::vector<float> values(count);
  for (std::size_t i = 0; i < count; ++i) {
    const PhiloxWords words = philox({static_cast<std::uint32_t>(i), stream, 0, 0}, {1, 2});
    values[i] = size * (2 * uniform_24(words[0]) - 1);
  }
  return values;
}

PolicyWeights random_weights(const PolicyShape& shape, float size = 0.3F, bool normalised = true) {
  PolicyWeights weights;
  weights.parameters = noise(shape.parameter_count(), 99, size);
  if (normalised) {
    weights.obs_mean = noise(static_cast<std::size_t>(shape.numbers()), 98, 0.5F);
    weights.obs_inv_std.assign(weights.obs_mean.size(), 1.7F);
  }
  return weights;
}

std::vector<ActionCounter> counters_for(std::size_t count) {
  std::vector<ActionCounter> counters(count);
  for (std::size_t i = 0; i < count; ++i) {
    counters[i] = {42, static_cast<std::uint32_t>(i % 5), i / 5, static_cast<std::uint32_t>(i),
                   Purpose::kAction};
  }
  return counters;
}

bool same_bits(float a, float b) {
  return std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b);
}

bool same(const Decision& a, const Decision& b) {
  bool equal =
      a.branch == b.branch && same_bits(a.log_prob, b.log_prob) && same_bits(a.value, b.value);
  for (std::size_t d = 0; d < 4; ++d) equal = equal && same_bits(a.continuous[d], b.continuous[d]);
  return equal;
}

/// A plain scalar forward pass with std::fma chains: what core/policy.h promises, written as loops.
struct ScalarOutput {
  std::vector<float> logits;
  float value = 0;
};
std::vector<float> scalar_network(const PolicyShape& shape, const PolicyWeights& weights,
                                  const NetworkLayout& net, const std::vector<float>& input) {
  const float* p = weights.parameters.data();
  const auto hidden = static_cast<std::size_t>(shape.hidden);
  const auto activation = [&](float sum) {
    return shape.activation == pb::ACTIVATION_TANH
               ? lanes::tanh(sum)
               : sum * _mm256_cvtss_f32(lanes::sigmoid(lanes::splat(sum)));
  };
  const auto multiply_add = [](float a, float b, float sum) { return std::fma(a, b, sum); };
  const auto layer = [&](const std::vector<float>& x, std::size_t w, std::size_t b) {
    std::vector<float> y(hidden);
    for (std::size_t j = 0; j < hidden; ++j) {
      float sum = p[b + j];
      for (std::size_t k = 0; k < x.size(); ++k) sum = std::fma(x[k], p[w + k * hidden + j], sum);
      y[j] = activation(sum);
    }
    return y;
  };
  const std::vector<float> inputs =
      test::plain_inputs(shape, net, weights.parameters, input, multiply_add, activation);
  const std::vector<float> h =
      layer(layer(inputs, net.weights1, net.bias1), net.weights2, net.bias2);
  std::vector<float> out(static_cast<std::size_t>(net.outputs));
  for (std::size_t o = 0; o < out.size(); ++o) {
    float sum = net.has_head_bias ? p[net.head_bias + o] : 0.0F;
    for (std::size_t k = 0; k < hidden; ++k)
      sum = std::fma(h[k], p[net.head + o * hidden + k], sum);
    out[o] = sum;
  }
  return out;
}

TEST(PolicyLayout, CountsAreThoseOfTheDesign) {
  // docs/learner.md: 37 644 parameters at 11 observations, 37 633 without head bias, + 256 with 12
  // observations.
  PolicyShape shape = discrete_shape(11, pb::ACTIVATION_TANH);
  EXPECT_EQ(shape.parameter_count(), 37644u);
  shape.head_bias = false;
  EXPECT_EQ(shape.parameter_count(), 37633u);
  shape.observations = 12;
  EXPECT_EQ(shape.parameter_count(), 37633u + 256u);
}

TEST(PolicyLayout, HashSeesEveryField) {
  const PolicyShape base = discrete_shape(14, pb::ACTIVATION_TANH);
  std::vector<PolicyShape> others(9, base);
  others[0].observations = 15;
  others[1].branches = {3, 3, 3};
  others[2].continuous = true;
  others[3].hidden = 64;
  others[4].activation = pb::ACTIVATION_SWISH;
  others[5].head_bias = false;
  others[6].picture = {2, 1};
  others[7].picture = {2, 3};
  others[8].picture = {2, 1};
  others[8].convolution = true;
  EXPECT_NE(others[6].layout_hash(), others[8].layout_hash());
  for (const PolicyShape& other : others) EXPECT_NE(other.layout_hash(), base.layout_hash());
}

TEST(PolicyShape, SizesOfThePresets) {
  pb::Config config;
  const auto observations = [&](pb::ObservationKind kind) {
    config.mutable_task()->set_observation(kind);
    return policy_shape(config).observations;
  };
  EXPECT_EQ(observations(pb::OBSERVATION_PAPER), 12);
  EXPECT_EQ(observations(pb::OBSERVATION_DERIVED), 12);
  EXPECT_EQ(observations(pb::OBSERVATION_DERIVED_HEAD), 8);
  EXPECT_EQ(observations(pb::OBSERVATION_OMENTUM), 20);
  config.mutable_task()->set_image_size(16);
  EXPECT_EQ(observations(pb::OBSERVATION_IMAGE), 20 + 256);
  config.mutable_task()->set_image(pb::IMAGE_SHADED);
  EXPECT_EQ(observations(pb::OBSERVATION_IMAGE), 20 + 3 * 256);
  EXPECT_THAT(policy_shape(config).branches, testing::ElementsAre(3, 3, 3, 2));
  config.mutable_task()->set_action(pb::ACTION_DERIVED_HEAD);
  EXPECT_THAT(policy_shape(config).branches, testing::ElementsAre(3, 3, 3));
  config.mutable_task()->set_action(pb::ACTION_CONTINUOUS);
  EXPECT_TRUE(policy_shape(config).continuous);
  EXPECT_EQ(policy_shape(config).logits(), 4);
}

class PolicyBatch : public testing::TestWithParam<PolicyShape> {};

TEST_P(PolicyBatch, SizeNeverChangesABit) {
  const PolicyShape& shape = GetParam();
  const std::size_t total = 256;
  Policy policy(shape, random_weights(shape));
  const std::vector<float> observations =
      noise(total * static_cast<std::size_t>(shape.observations), 1, 2.0F);
  const std::vector<ActionCounter> counters = counters_for(total);
  for (const bool greedy : {false, true}) {
    std::vector<Decision> whole(total);
    policy.act(observations, counters, greedy, whole);
    for (const std::size_t size : {1u, 2u, 3u, 7u, 8u, 16u, 63u, 255u}) {
      std::vector<Decision> parts(total);
      for (std::size_t first = 0; first < total; first += size) {
        const std::size_t n = std::min(size, total - first);
        const auto width = static_cast<std::size_t>(shape.observations);
        policy.act(std::span(observations).subspan(first * width, n * width),
                   std::span(counters).subspan(first, n), greedy,
                   std::span(parts).subspan(first, n));
      }
      for (std::size_t i = 0; i < total; ++i)
        ASSERT_TRUE(same(whole[i], parts[i])) << "batch " << size << " row " << i;
    }
  }
}

TEST_P(PolicyBatch, EvaluateRepeatsTheBitsOfAct) {
  const PolicyShape& shape = GetParam();
  const std::size_t columns = shape.columns();
  const std::size_t total = 77;
  Policy policy(shape, random_weights(shape));
  const std::vector<float> observations =
      noise(total * static_cast<std::size_t>(shape.observations), 5, 2.0F);
  std::vector<Decision> decisions(total);
  policy.act(observations, counters_for(total), false, decisions);
  std::vector<std::uint8_t> branches;
  std::vector<float> continuous;
  for (const Decision& d : decisions) {
    branches.insert(branches.end(), d.branch.begin(),
                    d.branch.begin() + static_cast<std::ptrdiff_t>(columns));
    continuous.insert(continuous.end(), d.continuous.begin(), d.continuous.end());
  }
  std::vector<float> log_probs(total), values(total), estimates(total), parts(total * columns);
  Policy other(shape,
               policy.weights());  // as the learner does: another object from the same weights
  other.evaluate(observations, branches, continuous, log_probs, values, parts);
  other.estimate(observations, estimates);
  for (std::size_t i = 0; i < total; ++i) {
    ASSERT_TRUE(same_bits(log_probs[i], decisions[i].log_prob));
    ASSERT_TRUE(same_bits(values[i], decisions[i].value));
    ASSERT_TRUE(same_bits(estimates[i], decisions[i].value));
    float sum = 0;
    for (std::size_t b = 0; b < columns; ++b) sum += parts[i * columns + b];
    ASSERT_TRUE(same_bits(sum, log_probs[i]));
  }
}

TEST_P(PolicyBatch, EqualsScalarLoops) {
  const PolicyShape& shape = GetParam();
  const std::size_t total = 9;
  const auto width = static_cast<std::size_t>(shape.observations);
  const PolicyWeights weights = random_weights(shape);
  Policy policy(shape, weights);
  const std::vector<float> observations = noise(total * width, 6, 2.0F);
  std::vector<Decision> decisions(total);
  policy.act(observations, counters_for(total), true, decisions);
  const ParameterLayout layout = parameter_layout(shape);
  for (std::size_t i = 0; i < total; ++i) {
    std::vector<float> x(width);
    for (std::size_t k = 0; k < width; ++k) {
      x[k] = observations[i * width + k];
      if (k >= weights.obs_mean.size()) continue;  // pixels stay as they are
      x[k] = (x[k] - weights.obs_mean[k]) * weights.obs_inv_std[k];
      x[k] = std::min(kObservationClip, std::max(-kObservationClip, x[k]));
    }
    EXPECT_TRUE(same_bits(decisions[i].value, scalar_network(shape, weights, layout.critic, x)[0]));
    const std::vector<float> logits = scalar_network(shape, weights, layout.actor, x);
    if (shape.continuous) {
      for (std::size_t d = 0; d < 4; ++d)
        EXPECT_TRUE(same_bits(decisions[i].continuous[d], logits[d]));
      continue;
    }
    double log_prob = 0;
    std::size_t base = 0;
    for (std::size_t b = 0; b < shape.branches.size(); ++b) {
      const auto size = static_cast<std::size_t>(shape.branches[b]);
      const auto first = logits.begin() + static_cast<std::ptrdiff_t>(base);
      const auto best = std::max_element(first, first + static_cast<std::ptrdiff_t>(size));
      EXPECT_EQ(decisions[i].branch[b], best - first);
      double sum = 0;
      for (std::size_t j = 0; j < size; ++j)
        sum += std::exp(static_cast<double>(logits[base + j] - *best));
      log_prob -= std::log(sum);
      base += size;
    }
    EXPECT_NEAR(static_cast<double>(decisions[i].log_prob), log_prob,
                2e-6);  // four f32 roundings of exp and log
  }
}

INSTANTIATE_TEST_SUITE_P(Shapes, PolicyBatch,
                         testing::Values(discrete_shape(14, pb::ACTIVATION_TANH),
                                         discrete_shape(12, pb::ACTIVATION_SWISH),
                                         discrete_shape(8, pb::ACTIVATION_TANH, 40),
                                         oriented_shape(29, pb::ACTIVATION_TANH),
                                         discrete_shape(1038, pb::ACTIVATION_TANH, 64),
                                         gaussian_shape(14),
                                         picture_shape_of(12, 1, pb::ACTIVATION_TANH),
                                         picture_shape_of(20, 3, pb::ACTIVATION_SWISH),
                                         picture_shape_of(32, 1, pb::ACTIVATION_TANH)));

TEST(PolicySampling, FrequenciesFollowTheProbabilities) {
  PolicyShape shape = discrete_shape(4, pb::ACTIVATION_TANH, 16);
  PolicyWeights weights = random_weights(shape, 0.0F, false);
  // All weights zero: the logits are the head biases.
  const std::vector<float> biases = {0.0F,  1.0F, -1.0F, 2.0F, 0.0F, 0.0F,
                                     -3.0F, 0.5F, 0.25F, 0.0F, 1.5F};
  const ParameterLayout layout = parameter_layout(shape);
  std::copy(biases.begin(), biases.end(),
            weights.parameters.begin() + static_cast<std::ptrdiff_t>(layout.actor.head_bias));
  Policy policy(shape, weights);
  const std::size_t total = 200'000;
  const std::vector<float> observations(total * 4, 0.5F);
  std::vector<Decision> decisions(total);
  policy.act(observations, counters_for(total), false, decisions);
  std::size_t base = 0;
  for (std::size_t b = 0; b < 4; ++b) {
    const auto size = static_cast<std::size_t>(shape.branches[b]);
    double sum = 0;
    for (std::size_t j = 0; j < size; ++j) sum += std::exp(static_cast<double>(biases[base + j]));
    for (std::size_t j = 0; j < size; ++j) {
      const double p = std::exp(static_cast<double>(biases[base + j])) / sum;
      const auto count = std::count_if(decisions.begin(), decisions.end(),
                                       [&](const Decision& d) { return d.branch[b] == j; });
      const double deviation = std::sqrt(p * (1 - p) / static_cast<double>(total));
      EXPECT_NEAR(static_cast<double>(count) / static_cast<double>(total), p,
                  4.5 * deviation);  // 11 looks at 4.5 sigma
    }
    base += size;
  }
}

TEST(PolicySampling, GaussianMomentsAndLogProbability) {
  const PolicyShape shape = gaussian_shape(4);
  PolicyWeights weights = random_weights(shape, 0.0F, false);
  const ParameterLayout layout = parameter_layout(shape);
  for (std::size_t d = 0; d < 4; ++d) {
    weights.parameters[layout.actor.head_bias + d] = 0.5F * static_cast<float>(d);
    weights.parameters[layout.log_std + d] = -0.5F - 0.1F * static_cast<float>(d);
  }
  Policy policy(shape, weights);
  const std::size_t total = 200'000;
  const std::vector<float> observations(total * 4, 0.0F);
  std::vector<Decision> decisions(total);
  policy.act(observations, counters_for(total), false, decisions);
  for (std::size_t d = 0; d < 4; ++d) {
    const double mean = 0.5 * static_cast<double>(d);
    const double deviation = std::exp(-0.5 - 0.1 * static_cast<double>(d));
    double sum = 0, squares = 0;
    for (const Decision& decision : decisions) {
      const double z = (static_cast<double>(decision.continuous[d]) - mean) / deviation;
      sum += z;
      squares += z * z;
    }
    EXPECT_NEAR(sum / static_cast<double>(total), 0, 0.01);  // 4.5 sigma of the mean of 2e5 draws
    EXPECT_NEAR(squares / static_cast<double>(total), 1, 0.015);
  }
  double log_prob = 0;
  for (std::size_t d = 0; d < 4; ++d) {
    const double log_std = -0.5 - 0.1 * static_cast<double>(d);
    const double z =
        (static_cast<double>(decisions[0].continuous[d]) - 0.5 * static_cast<double>(d)) /
        std::exp(log_std);
    log_prob += -0.5 * z * z - log_std - 0.5 * std::log(2 * M_PI);
  }
  EXPECT_NEAR(static_cast<double>(decisions[0].log_prob), log_prob,
              3e-6);  // f32 rounding of four terms of size 1
}

TEST(PolicySampling, DependsOnTheCounterAlone) {
  const PolicyShape shape = discrete_shape(4, pb::ACTIVATION_TANH, 16);
  Policy policy(shape, random_weights(shape));
  const std::vector<float> observations(8, 0.3F);
  const std::vector<ActionCounter> counters = {{1, 2, 3, 4, Purpose::kAction},
                                               {1, 2, 3, 4, Purpose::kAction}};
  std::vector<Decision> decisions(2);
  policy.act(observations, counters, false, decisions);
  EXPECT_TRUE(same(decisions[0], decisions[1]));
}

TEST(Policy, AllocatesNothing) {
  for (const PolicyShape& shape : {discrete_shape(14, pb::ACTIVATION_TANH), gaussian_shape(14)}) {
    Policy policy(shape, random_weights(shape));
    const std::vector<float> observations = noise(50 * 14, 1, 1.0F);
    const std::vector<ActionCounter> counters = counters_for(50);
    const std::vector<std::uint8_t> branches(50 * 4, 0);
    const std::vector<float> continuous(50 * 4, 0.0F);
    std::vector<Decision> decisions(50);
    std::vector<float> log_probs(50), values(50);
    const std::size_t before = allocations;
    policy.act(observations, counters, false, decisions);
    policy.evaluate(observations, branches, continuous, log_probs, values);
    policy.estimate(observations, values);
    EXPECT_EQ(allocations, before);
  }
}

TEST(HashWeights, SeesParametersAndNormaliser) {
  const std::vector<float> p = {1, 2, 3}, mean = {0.5F}, scale = {2};
  const Sha256 base = hash_weights(p, mean, scale);
  EXPECT_EQ(base, hash_weights(p, mean, scale));
  EXPECT_NE(base, hash_weights(p, {}, {}));
  EXPECT_NE(base, hash_weights(p, scale, mean));
  EXPECT_NE(base, hash_weights(std::vector<float>{1, 2, 4}, mean, scale));
}

}  // namespace
}  // namespace omentum
