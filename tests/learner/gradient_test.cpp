// The training kernel against central differences of the same loss written as plain loops in
// double.

#include "learner/gradient.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numeric>
#include <string>

#include "learner/initialise.h"
#include "tests/support/plain_convolution.h"

namespace omentum {
namespace {

struct Case {
  std::string name;
  PolicyShape shape;
  LossSettings settings;
};

float noise(std::uint32_t i, std::uint32_t stream) {
  return 2 * uniform_24(philox({i, stream, 0, 0}, {3, 9})[0]) - 1;
}

/// Samples whose old log-probabilities differ from the present ones, so that some ratios are
/// clipped.
struct Problem {
  Batch batch;
  std::vector<float> inputs, advantages, returns;
  std::vector<std::uint32_t> rows;
  std::vector<float> parameters;
};

Problem make_problem(const Case& c, int samples) {
  Problem p;
  p.parameters = initial_parameters(c.shape, pb::Ppo(), 5);
  for (std::size_t i = 0; i < p.parameters.size(); ++i) {
    p.parameters[i] +=
        0.15F * noise(static_cast<std::uint32_t>(i), 1);  // biases and heads away from 0
  }
  const auto n = static_cast<std::size_t>(samples);
  Batch& b = p.batch;
  b.slots = 1;
  b.steps = samples;
  b.observation_size = c.shape.observations;
  for (std::size_t i = 0; i < n * static_cast<std::size_t>(c.shape.observations); ++i) {
    p.inputs.push_back(1.5F * noise(static_cast<std::uint32_t>(i), 2));
  }
  const std::size_t columns = c.shape.columns();
  b.branches.assign(n * columns, 0);
  if (c.shape.continuous) b.continuous.assign(n * 4, 0);
  for (std::uint32_t i = 0; i < n; ++i) {
    for (std::uint32_t d = 0; d < columns; ++d) {
      if (c.shape.continuous) b.continuous[i * 4 + d] = 1.2F * noise(i * 4 + d, 3);
      if (!c.shape.continuous && d < c.shape.branches.size()) {
        b.branches[i * columns + d] = static_cast<std::uint8_t>((i + d) % 2);
      }
    }
    p.advantages.push_back(2 * noise(i, 4));
    p.returns.push_back(noise(i, 5));
    b.values.push_back(noise(i, 6));
  }
  PolicyWeights weights;
  weights.parameters = p.parameters;
  Policy policy(c.shape, weights);
  b.log_probs.resize(n);
  b.branch_log_probs.resize(n * columns);
  std::vector<float> values(n);
  policy.evaluate(p.inputs, b.branches, b.continuous, b.log_probs, values, b.branch_log_probs);
  for (std::uint32_t i = 0; i < n; ++i) {
    float sum = 0;
    for (std::uint32_t d = 0; d < static_cast<std::uint32_t>(c.shape.branch_count()); ++d) {
      b.branch_log_probs[i * columns + d] += 0.25F * noise(i * 4 + d, 7);
      sum += b.branch_log_probs[i * columns + d];
    }
    b.log_probs[i] = sum;
  }
  p.rows.resize(n);
  std::iota(p.rows.begin(), p.rows.end(), 0u);
  return p;
}

// --- the reference, in double
// ---------------------------------------------------------------------------------

std::vector<double> network(const PolicyShape& shape, const NetworkLayout& net,
                            const std::vector<double>& p, const float* x) {
  const auto hidden = static_cast<std::size_t>(shape.hidden);
  const auto activation = [&](double v) {
    return shape.activation == pb::ACTIVATION_TANH ? std::tanh(v) : v / (1 + std::exp(-v));
  };
  std::vector<double> input = test::plain_inputs(
      shape, net, p, std::vector<double>(x, x + shape.observations),
      [](double a, double b, double sum) { return a * b + sum; }, activation);
  for (const auto& [w, b] :
       {std::pair{net.weights1, net.bias1}, std::pair{net.weights2, net.bias2}}) {
    std::vector<double> out(hidden);
    for (std::size_t j = 0; j < hidden; ++j) {
      double sum = p[b + j];
      for (std::size_t k = 0; k < input.size(); ++k) sum += input[k] * p[w + k * hidden + j];
      out[j] = activation(sum);
    }
    input = out;
  }
  std::vector<double> out(static_cast<std::size_t>(net.outputs));
  for (std::size_t o = 0; o < out.size(); ++o) {
    out[o] = net.has_head_bias ? p[net.head_bias + o] : 0;
    for (std::size_t k = 0; k < hidden; ++k) out[o] += input[k] * p[net.head + o * hidden + k];
  }
  return out;
}

double clipped_surrogate(double log_ratio, double advantage, const LossSettings& s) {
  const double r = std::exp(log_ratio);
  const double bounded =
      std::clamp(r, static_cast<double>(s.ratio_low), static_cast<double>(s.ratio_high));
  return -std::min(r * advantage, bounded * advantage);
}

double sample_loss(const Case& c, const Problem& problem, const std::vector<double>& p,
                   std::size_t i) {
  const ParameterLayout layout = parameter_layout(c.shape);
  const float* x = problem.inputs.data() + i * static_cast<std::size_t>(c.shape.observations);
  const std::vector<double> logits = network(c.shape, layout.actor, p, x);
  const double value = network(c.shape, layout.critic, p, x)[0];
  const Batch& b = problem.batch;
  std::vector<double> log_prob;
  double entropy = 0;
  std::size_t base = 0;
  for (std::size_t branch = 0; branch < static_cast<std::size_t>(c.shape.branch_count());
       ++branch) {
    if (c.shape.continuous) {
      const double log_std = p[layout.log_std + branch];
      const double z =
          (static_cast<double>(b.continuous[i * 4 + branch]) - logits[branch]) / std::exp(log_std);
      log_prob.push_back(-0.5 * z * z - log_std - 0.5 * std::log(2 * M_PI));
      entropy += log_std + 0.5 * std::log(2 * M_PI * M_E);
      continue;
    }
    const auto size = static_cast<std::size_t>(c.shape.branches[branch]);
    double total = 0;
    std::vector<double> l;
    for (std::size_t j = 0; j < size; ++j) {
      l.push_back(logits[base + j]);
      total += std::exp(l[j]);
    }
    for (const double v : l) {
      const double q = std::exp(v) / total;
      if (q > 0) entropy -= q * std::log(q);
    }
    log_prob.push_back(l[b.branches[i * c.shape.columns() + branch]] - std::log(total));
    base += size;
  }
  const auto advantage = static_cast<double>(problem.advantages[i]);
  double policy = 0;
  if (c.settings.likelihood) {
    policy = -std::accumulate(log_prob.begin(), log_prob.end(), 0.0);
  } else if (c.settings.ratio == pb::RATIO_JOINT) {
    const double joint = std::accumulate(log_prob.begin(), log_prob.end(), 0.0);
    policy = clipped_surrogate(joint - static_cast<double>(b.log_probs[i]), advantage, c.settings);
  } else {
    for (std::size_t branch = 0; branch < log_prob.size(); ++branch) {
      const double d = log_prob[branch] -
                       static_cast<double>(b.branch_log_probs[i * c.shape.columns() + branch]);
      policy += clipped_surrogate(d, advantage, c.settings) / static_cast<double>(log_prob.size());
    }
  }
  const double target = static_cast<double>(problem.returns[i]),
               old = static_cast<double>(b.values[i]);
  double value_loss = (value - target) * (value - target);
  if (c.settings.value_clip) {
    const auto range = static_cast<double>(c.settings.value_range);
    const double clipped = old + std::clamp(value - old, -range, range) - target;
    value_loss = std::max(value_loss, clipped * clipped);
  }
  return policy - static_cast<double>(c.settings.entropy) * entropy +
         static_cast<double>(c.settings.value_coefficient) * value_loss;
}

double reference_loss(const Case& c, const Problem& problem, const std::vector<double>& p) {
  double sum = 0;
  for (std::size_t i = 0; i < problem.rows.size(); ++i) sum += sample_loss(c, problem, p, i);
  return sum / static_cast<double>(problem.rows.size());
}

// -----------------------------------------------------------------------------------------------

class KernelGradient : public testing::TestWithParam<Case> {};

TEST_P(KernelGradient, EqualsCentralDifferences) {
  const Case& c = GetParam();
  const int samples = 37;  // not a multiple of eight
  const Problem problem = make_problem(c, samples);
  const TrainingLayout layout(c.shape);
  AlignedFloats padded(layout.count());
  layout.spread(problem.parameters, padded);
  PackedWeights packed(c.shape, layout);
  packed.pack(padded);
  ChunkGradient kernel(c.shape, layout);
  AlignedFloats padded_gradient(layout.count(), 0.0F);
  LossSettings settings = c.settings;
  settings.per_sample = 1.0F / static_cast<float>(samples);
  MinibatchView view{&problem.batch,  problem.inputs, problem.advantages, 0, 1,
                     problem.returns, problem.rows};
  const LossSums sums = kernel(packed, settings, view, 0, samples, padded_gradient);
  std::vector<float> gradient(problem.parameters.size());
  layout.collect(padded_gradient, gradient);

  std::vector<double> p(problem.parameters.begin(), problem.parameters.end());
  const double total = (sums.policy_loss -
                        static_cast<double>(settings.entropy) *
                            std::accumulate(sums.entropy.begin(), sums.entropy.end(), 0.0) +
                        static_cast<double>(settings.value_coefficient) * sums.value_loss) /
                       samples;
  EXPECT_NEAR(total, reference_loss(c, problem, p), 2e-6);  // f32 rounding of terms of size 1

  const ParameterLayout blocks = parameter_layout(c.shape);
  std::vector<std::pair<std::string, std::pair<std::size_t, std::size_t>>> ranges;
  const auto hidden = static_cast<std::size_t>(c.shape.hidden);
  const auto add = [&](const std::string& name, const NetworkLayout& net) {
    const auto outputs = static_cast<std::size_t>(net.outputs);
    if (c.shape.convolution) {
      ranges.push_back({name + ".filters1", {net.filters1, net.filters1_bias}});
      ranges.push_back({name + ".filters1_bias", {net.filters1_bias, net.filters2}});
      ranges.push_back({name + ".filters2", {net.filters2, net.filters2_bias}});
      ranges.push_back({name + ".filters2_bias", {net.filters2_bias, net.weights1}});
    }
    ranges.push_back({name + ".weights1", {net.weights1, net.bias1}});
    ranges.push_back({name + ".bias1", {net.bias1, net.weights2}});
    ranges.push_back({name + ".weights2", {net.weights2, net.bias2}});
    ranges.push_back({name + ".bias2", {net.bias2, net.head}});
    ranges.push_back({name + ".head", {net.head, net.head + outputs * hidden}});
    if (net.has_head_bias)
      ranges.push_back({name + ".head_bias", {net.head_bias, net.head_bias + outputs}});
  };
  add("actor", blocks.actor);
  if (c.shape.continuous) ranges.push_back({"log_std", {blocks.log_std, blocks.log_std + 4}});
  add("critic", blocks.critic);
  for (const auto& [name, range] : ranges) {
    double largest = 0;
    for (std::size_t i = range.first; i < range.second; ++i) {
      largest = std::max(largest, std::abs(static_cast<double>(gradient[i])));
    }
    const std::size_t stride = std::max<std::size_t>(1, (range.second - range.first) / 9);
    for (std::size_t i = range.first; i < range.second; i += stride) {
      const double step = 1e-5, at = p[i];
      p[i] = at + step;
      const double above = reference_loss(c, problem, p);
      p[i] = at - step;
      const double below = reference_loss(c, problem, p);
      p[i] = at;
      // f32 kernel: a few hundred roundings of 6e-8 relative to the block's largest entry.
      EXPECT_NEAR(static_cast<double>(gradient[i]), (above - below) / (2 * step),
                  3e-5 * largest + 2e-8)
          << name << " parameter " << i - range.first;
    }
    EXPECT_GT(largest, 0) << name;
  }
}

std::vector<Case> cases() {
  PolicyShape discrete;
  discrete.observations = 6;
  discrete.branches = {3, 3, 3, 2};
  discrete.hidden = 32;
  PolicyShape gaussian = discrete;
  gaussian.branches.clear();
  gaussian.continuous = true;
  LossSettings base;
  base.entropy = 0.05F;
  std::vector<Case> all;
  const auto add = [&](const std::string& name, auto change) {
    Case c{name, discrete, base};
    change(c);
    all.push_back(c);
  };
  add("Joint", [](Case&) {});
  add("PerBranch", [](Case& c) { c.settings.ratio = pb::RATIO_PER_BRANCH; });
  add("ValueClip", [](Case& c) { c.settings.value_clip = true; });
  add("Swish", [](Case& c) { c.shape.activation = pb::ACTIVATION_SWISH; });
  add("NoHeadBias", [](Case& c) { c.shape.head_bias = false; });
  add("OddWidth", [](Case& c) { c.shape.hidden = 21; });
  add("Wide", [](Case& c) { c.shape.hidden = 80; });
  add("SevenBranches", [](Case& c) { c.shape.branches = {3, 3, 3, 2, 3, 3, 3}; });
  add("SevenBranchesPerBranchSwish", [](Case& c) {
    c.shape.branches = {3, 3, 3, 2, 3, 3, 3};
    c.shape.activation = pb::ACTIVATION_SWISH;
    c.settings.ratio = pb::RATIO_PER_BRANCH;
  });
  add("OneBranch", [](Case& c) { c.shape.branches = {2}; });
  add("ReciprocalClip",
      [](Case& c) { c.settings.ratio_low = 1 / 1.1F, c.settings.ratio_high = 1.1F; });
  add("Gaussian", [&](Case& c) { c.shape = gaussian; });
  add("GaussianPerBranchSwish", [&](Case& c) {
    c.shape = gaussian;
    c.shape.activation = pb::ACTIVATION_SWISH;
    c.settings.ratio = pb::RATIO_PER_BRANCH;
  });
  add("Likelihood", [](Case& c) { c.settings.likelihood = true; });
  add("LikelihoodPerBranchSwish", [](Case& c) {
    c.settings.likelihood = true;
    c.settings.ratio = pb::RATIO_PER_BRANCH;  // is not asked for
    c.shape.activation = pb::ACTIVATION_SWISH;
  });
  add("LikelihoodGaussian", [&](Case& c) {
    c.shape = gaussian;
    c.settings.likelihood = true;
  });
  const auto see = [](Case& c, int size, int channels) {
    c.shape.hidden = 16;
    c.shape.picture = {size, channels};
    c.shape.observations += c.shape.picture.values();
    c.shape.convolution = true;
  };
  add("PictureOfIds", [&](Case& c) { see(c, 12, 1); });
  add("PictureOfIdsOddWidth", [&](Case& c) { see(c, 12, 1), c.shape.hidden = 21; });
  add("ShadedPictureSwish", [&](Case& c) {
    see(c, 20, 3);
    c.shape.activation = pb::ACTIVATION_SWISH;
  });
  return all;
}

INSTANTIATE_TEST_SUITE_P(Switches, KernelGradient, testing::ValuesIn(cases()),
                         [](const testing::TestParamInfo<Case>& i) { return i.param.name; });

// --- unit values of the ratio, docs/learner.md 6
// -----------------------------------------------------------

struct RatioResult {
  double loss = 0, ratio = 0;
  std::array<double, 4> weight{};  // d loss / d log-prob of each branch
};

RatioResult ratio_result(pb::RatioKind kind, float advantage) {
  PolicyShape shape;
  shape.observations = 1;
  shape.branches = {3, 3, 3, 2};
  LossSettings settings;
  settings.ratio = kind;
  settings.entropy = 0;
  LossInputs inputs{};
  const float d[4] = {0.30F, -0.10F, 0.05F, 0.00F};
  const double uniform[4] = {-std::log(3.0), -std::log(3.0), -std::log(3.0), -std::log(2.0)};
  double joint = 0;
  for (int b = 0; b < 4; ++b) {
    const double old = uniform[b] - static_cast<double>(d[b]);
    joint += old;
    inputs.old_branch_log_prob[b][0] = static_cast<float>(old);
  }
  inputs.old_log_prob[0] = static_cast<float>(joint);
  inputs.advantage[0] = advantage;
  const std::vector<float> logits(16, 0.0F),
      values(8, 0.0F);  // uniform policy, action 0 everywhere
  std::vector<float> gradient(16), value_gradient(8);
  const LossSums sums = Loss(shape)(settings, {}, inputs, 1, logits.data(), values.data(),
                                    gradient.data(), value_gradient.data(), nullptr);
  RatioResult result;
  result.loss = sums.policy_loss;
  result.ratio = sums.ratio;
  for (std::size_t b = 0; b < 4; ++b) {
    const double other = b < 3 ? 2.0 / 3 : 0.5;  // 1 - p of the action taken
    result.weight[b] = static_cast<double>(gradient[b * 3]) / other;
  }
  return result;
}

TEST(Ratio, UnitValues) {
  const double tolerance = 1e-6;  // f32 exp and log-probabilities of size 1
  const RatioResult joint_up = ratio_result(pb::RATIO_JOINT, 1);
  EXPECT_NEAR(joint_up.ratio, 1.284025417, tolerance);
  EXPECT_NEAR(joint_up.loss, -1.2, tolerance);
  for (const double weight : joint_up.weight) EXPECT_EQ(weight, 0);
  const RatioResult joint_down = ratio_result(pb::RATIO_JOINT, -1);
  EXPECT_NEAR(joint_down.loss, 1.284025417, tolerance);
  for (const double weight : joint_down.weight) EXPECT_NEAR(weight, 1.284025417, tolerance);

  const RatioResult up = ratio_result(pb::RATIO_PER_BRANCH, 1);
  EXPECT_NEAR(up.loss, -1.039027129, tolerance);
  const double up_weights[4] = {0, -0.226209355, -0.262817774, -0.25};
  const RatioResult down = ratio_result(pb::RATIO_PER_BRANCH, -1);
  EXPECT_NEAR(down.loss, 1.076491830, tolerance);
  const double down_weights[4] = {0.337464702, 0.226209355, 0.262817774, 0.25};
  for (std::size_t b = 0; b < 4; ++b) {
    EXPECT_NEAR(up.weight[b], up_weights[b], tolerance);
    EXPECT_NEAR(down.weight[b], down_weights[b], tolerance);
  }
}

TEST(TrainingLayout, SpreadAndCollectAreInverse) {
  PolicyShape shape;
  shape.observations = 5;
  shape.branches = {3, 2};
  shape.hidden = 21;
  const TrainingLayout layout(shape);
  std::vector<float> canonical(shape.parameter_count());
  std::iota(canonical.begin(), canonical.end(), 1.0F);
  AlignedFloats padded(layout.count());
  layout.spread(canonical, padded);
  std::vector<float> back(canonical.size());
  layout.collect(padded, back);
  EXPECT_EQ(back, canonical);
  EXPECT_EQ(std::count_if(padded.begin(), padded.end(), [](float v) { return v != 0; }),
            std::ssize(canonical));
}

}  // namespace
}  // namespace omentum
