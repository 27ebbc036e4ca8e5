#include "core/policy.h"

#include <algorithm>
#include <bit>
#include <utility>

#include "core/activation.h"
#include "core/check.h"
#include "core/fp_mode.h"
#include "core/gemm.h"

namespace omentum {

using lanes::Lane;

namespace {

constexpr int kBlock = 24;  // rows at a time: four register groups of six, three panels of eight
constexpr float kHalfLog2Pi = 0.918938533F;

int branch_size(const PolicyShape& shape, int branch) {
  return shape.branches[static_cast<std::size_t>(branch)];
}

}  // namespace

struct Policy::Panel {
  alignas(32) float logits[kMaxLogits][lanes::kWidth];
  alignas(32) float uniform[kActionBranches][lanes::kWidth];
  alignas(32) std::int32_t branch[kActionBranches][lanes::kWidth];
  alignas(32) float continuous[kContinuousDimensions][lanes::kWidth];
  alignas(32) float branch_log_prob[kActionBranches][lanes::kWidth];
  alignas(32) float log_prob[lanes::kWidth];
};

Policy::Policy(const PolicyShape& shape, PolicyWeights weights)
    : shape_(shape),
      weights_(std::move(weights)),
      padded_hidden_(padded_columns(shape.hidden)),
      padded_logits_(padded_columns(shape.logits())) {
  OMENTUM_CHECK(fp_mode_is_default());
  const ParameterLayout layout = parameter_layout(shape_);
  OMENTUM_CHECK(weights_.parameters.size() == layout.count, "{} parameters for a layout of {}",
                weights_.parameters.size(), layout.count);
  OMENTUM_CHECK(shape_.logits() >= 1 && shape_.logits() <= kMaxLogits &&
                shape_.branch_count() <= static_cast<int>(kActionBranches));
  OMENTUM_CHECK(weights_.obs_inv_std.size() == weights_.obs_mean.size());
  OMENTUM_CHECK(weights_.obs_mean.empty() || std::ssize(weights_.obs_mean) == shape_.numbers());
  actor_ = pack(layout.actor);
  critic_ = pack(layout.critic);
  if (shape_.continuous) {
    for (std::size_t d = 0; d < 4; ++d) {
      log_std_[d] = weights_.parameters[layout.log_std + d];
      std_[d] = lanes::exp(log_std_[d]);
      inverse_std_[d] = lanes::exp(-log_std_[d]);
    }
  }
  const auto rows = static_cast<std::size_t>(kBlock);
  const auto hidden = static_cast<std::size_t>(padded_hidden_);
  if (!weights_.obs_mean.empty())
    normalised_.resize(rows * static_cast<std::size_t>(shape_.observations));
  if (shape_.convolution) {
    convolution1_ = first_convolution(shape_.picture);
    convolution2_ = second_convolution(shape_.picture);
    planes_.resize(static_cast<std::size_t>(convolution1_.inputs()));
    patches_.resize(static_cast<std::size_t>(convolution1_.positions() * convolution1_.patch()));
    outputs1_.resize(static_cast<std::size_t>(convolution1_.outputs()));
    patches2_.resize(static_cast<std::size_t>(convolution2_.positions() * convolution2_.patch()));
    outputs2_.resize(static_cast<std::size_t>(convolution2_.outputs()));
    inputs_.resize(rows * static_cast<std::size_t>(shape_.inputs()));
  }
  hidden1_.resize(rows * hidden);
  hidden2_.resize(rows * hidden);
  logits_.resize(rows * static_cast<std::size_t>(padded_logits_));
  values_.resize(rows * 8);
}

Policy::Packed Policy::pack(const NetworkLayout& layout) const {
  const int hidden = shape_.hidden;
  const auto padded = static_cast<std::size_t>(padded_hidden_);
  const float* p = weights_.parameters.data();
  const auto copy = [&](std::size_t from, int count, std::size_t size) {
    AlignedFloats values(size, 0.0F);
    std::copy_n(p + from, count, values.begin());
    return values;
  };
  const auto all = [&](std::size_t from, std::size_t to) {
    return AlignedFloats(p + from, p + to);
  };
  Packed packed;
  packed.filters1 = all(layout.filters1, layout.filters1_bias);
  packed.filters1_bias = all(layout.filters1_bias, layout.filters2);
  packed.filters2 = all(layout.filters2, layout.filters2_bias);
  packed.filters2_bias = all(layout.filters2_bias, layout.weights1);
  packed.weights1.resize(static_cast<std::size_t>(shape_.inputs()) * padded);
  pack_panels(p + layout.weights1, shape_.inputs(), hidden, hidden, packed.weights1.data());
  packed.bias1 = copy(layout.bias1, hidden, padded);
  packed.weights2.resize(static_cast<std::size_t>(hidden) * padded);
  pack_panels(p + layout.weights2, hidden, hidden, hidden, packed.weights2.data());
  packed.bias2 = copy(layout.bias2, hidden, padded);
  const int outputs = padded_columns(layout.outputs);
  packed.head.resize(static_cast<std::size_t>(hidden * outputs));
  pack_panels_transposed(p + layout.head, layout.outputs, hidden, hidden, packed.head.data());
  packed.head_bias = copy(layout.head_bias, layout.has_head_bias ? layout.outputs : 0,
                          static_cast<std::size_t>(outputs));
  return packed;
}

const float* Policy::normalise(const float* observations, int count) {
  if (weights_.obs_mean.empty()) return observations;
  const auto size = static_cast<std::size_t>(shape_.observations);
  const std::size_t numbers = weights_.obs_mean.size();
  for (std::size_t row = 0; row < static_cast<std::size_t>(count); ++row) {
    std::copy_n(observations + row * size + numbers, size - numbers,
                normalised_.data() + row * size + numbers);  // pixels stay as they are
    for (std::size_t i = 0; i < numbers; ++i) {
      const float x =
          (observations[row * size + i] - weights_.obs_mean[i]) * weights_.obs_inv_std[i];
      const float above = x < -kObservationClip ? -kObservationClip : x;
      normalised_[row * size + i] = above > kObservationClip ? kObservationClip : above;
    }
  }
  return normalised_.data();
}

void Policy::activate(float* values, int total) const {
  // Four independent evaluations at a time hide the latency of polynomial and division.
  const auto apply = [&](auto function) {
    int i = 0;
    for (; i + 32 <= total; i += 32) {
      Lane y[4];
      for (int j = 0; j < 4; ++j) y[j] = function(_mm256_load_ps(values + i + 8 * j));
      for (int j = 0; j < 4; ++j) _mm256_store_ps(values + i + 8 * j, y[j]);
    }
    for (; i < total; i += 8) _mm256_store_ps(values + i, function(_mm256_load_ps(values + i)));
  };
  if (shape_.activation == pb::ACTIVATION_TANH) {
    apply([](Lane x) { return lanes::tanh(x); });
  } else {
    apply([](Lane x) { return _mm256_mul_ps(x, lanes::sigmoid(x)); });
  }
}

// The inputs of the first hidden layer: behind its numbers each row gets the outputs of the
// convolutions over its picture.
const float* Policy::see(const Packed& network, const float* observations, int count) {
  if (!shape_.convolution) return observations;
  for (int row = 0; row < count; ++row) {
    const float* observation =
        observations + static_cast<std::ptrdiff_t>(row) * shape_.observations;
    make_planes(shape_.picture, observation + shape_.numbers(), planes_.data());
    gather_patches(convolution1_, planes_.data(), patches_.data());
    convolve(convolution1_, patches_.data(), network.filters1.data(), network.filters1_bias.data(),
             outputs1_.data());
    activate(outputs1_.data(), convolution1_.outputs());
    gather_patches(convolution2_, outputs1_.data(), patches2_.data());
    convolve(convolution2_, patches2_.data(), network.filters2.data(), network.filters2_bias.data(),
             outputs2_.data());
    activate(outputs2_.data(), convolution2_.outputs());
    float* to = inputs_.data() + static_cast<std::ptrdiff_t>(row) * shape_.inputs();
    std::copy_n(observation, shape_.numbers(), to);
    const float scale = feature_scale(shape_.picture);
    std::transform(outputs2_.begin(), outputs2_.end(), to + shape_.numbers(),
                   [scale](float feature) { return feature * scale; });
  }
  return inputs_.data();
}

void Policy::forward(const Packed& network, const float* inputs, int count, int output_columns,
                     float* outputs) {
  const int hidden = shape_.hidden;
  const auto layer = [count](const float* from, int size, int leading, const AlignedFloats& weights,
                             const AlignedFloats& bias, int columns, float* to) {
    gemm(count, columns, size,
         {from, leading, 1, weights.data(), kPanel, static_cast<std::ptrdiff_t>(size) * kPanel, to,
          columns, bias.data()});
  };
  layer(inputs, shape_.inputs(), shape_.inputs(), network.weights1, network.bias1, padded_hidden_,
        hidden1_.data());
  activate(hidden1_.data(), count * padded_hidden_);
  layer(hidden1_.data(), hidden, padded_hidden_, network.weights2, network.bias2, padded_hidden_,
        hidden2_.data());
  activate(hidden2_.data(), count * padded_hidden_);
  layer(hidden2_.data(), hidden, padded_hidden_, network.head, network.head_bias, output_columns,
        outputs);
}

Policy::Panel Policy::load_panel(int first, int count) const {
  Panel panel;
  const int logits = shape_.logits();
  for (int lane = 0; lane < lanes::kWidth; ++lane) {
    const int row = first + (lane < count ? lane : 0);
    const float* source = logits_.data() + row * padded_logits_;
    for (int j = 0; j < logits; ++j) panel.logits[j][lane] = source[j];
  }
  return panel;
}

// Softmax by shifted exponentials e_i = exp(l_i - max), total = sum in ascending order. The draw
// compares u total with the running sum, which needs no division; log p = (l - max) - log(total).
void Policy::sample_discrete(Panel& panel, bool greedy) const {
  int base = 0;
  for (int b = 0; b < shape_.branch_count(); ++b) {
    const int size = branch_size(shape_, b);
    Lane best = _mm256_load_ps(panel.logits[base]);
    __m256i chosen = _mm256_setzero_si256();
    for (int j = 1; j < size; ++j) {
      const Lane logit = _mm256_load_ps(panel.logits[base + j]);
      const Lane better = lanes::less(best, logit);
      best = lanes::select(better, logit, best);
      if (greedy) {
        chosen = _mm256_blendv_epi8(chosen, _mm256_set1_epi32(j), _mm256_castps_si256(better));
      }
    }
    if (!greedy) {
      Lane e[kMaxLogits];
      Lane total = _mm256_setzero_ps();
      for (int j = 0; j < size; ++j) {
        e[j] = lanes::exp(_mm256_sub_ps(_mm256_load_ps(panel.logits[base + j]), best));
        total = _mm256_add_ps(total, e[j]);
      }
      const Lane threshold = _mm256_mul_ps(_mm256_load_ps(panel.uniform[b]), total);
      Lane sum = _mm256_setzero_ps();
      for (int j = 0; j + 1 < size; ++j) {
        sum = _mm256_add_ps(sum, e[j]);
        // Not yet reached: the action is at least j + 1. Comparison is -1 where true.
        const Lane behind = _mm256_cmp_ps(sum, threshold, _CMP_LE_OQ);
        chosen = _mm256_sub_epi32(chosen, _mm256_castps_si256(behind));
      }
    }
    _mm256_store_si256(reinterpret_cast<__m256i*>(panel.branch[b]), chosen);
    base += size;
  }
}

void Policy::sample_gaussian(Panel& panel, bool greedy) const {
  for (std::size_t d = 0; d < 4; ++d) {
    const Lane mean = _mm256_load_ps(panel.logits[d]);
    Lane action = mean;
    if (!greedy) {
      // Centre of the cell of u; the last cell would round to 1.
      const Lane p =
          lanes::smaller(_mm256_add_ps(_mm256_load_ps(panel.uniform[d]), lanes::splat(0x1p-25F)),
                         lanes::splat(1.0F - 0x1p-24F));
      action = lanes::fma(lanes::normal_quantile(p), lanes::splat(std_[d]), mean);
    }
    _mm256_store_ps(panel.continuous[d], action);
  }
}

void Policy::score(Panel& panel) const {
  Lane joint = _mm256_setzero_ps();
  int base = 0;
  for (int b = 0; b < shape_.branch_count(); ++b) {
    Lane log_prob;
    if (shape_.continuous) {
      const auto d = static_cast<std::size_t>(b);
      const Lane z = _mm256_mul_ps(
          _mm256_sub_ps(_mm256_load_ps(panel.continuous[b]), _mm256_load_ps(panel.logits[b])),
          lanes::splat(inverse_std_[d]));
      log_prob = lanes::fma(_mm256_mul_ps(z, z), lanes::splat(-0.5F),
                            lanes::splat(-log_std_[d] - kHalfLog2Pi));
    } else {
      const int size = branch_size(shape_, b);
      const __m256i chosen = _mm256_load_si256(reinterpret_cast<const __m256i*>(panel.branch[b]));
      Lane best = _mm256_load_ps(panel.logits[base]);
      Lane taken = best;
      for (int j = 1; j < size; ++j) {
        const Lane logit = _mm256_load_ps(panel.logits[base + j]);
        best = lanes::larger(best, logit);
        const __m256i here = _mm256_cmpeq_epi32(chosen, _mm256_set1_epi32(j));
        taken = lanes::select(_mm256_castsi256_ps(here), logit, taken);
      }
      Lane total = _mm256_setzero_ps();
      for (int j = 0; j < size; ++j) {
        total = _mm256_add_ps(
            total, lanes::exp(_mm256_sub_ps(_mm256_load_ps(panel.logits[base + j]), best)));
      }
      log_prob = _mm256_sub_ps(_mm256_sub_ps(taken, best), lanes::log(total));
      base += size;
    }
    _mm256_store_ps(panel.branch_log_prob[b], log_prob);
    joint = _mm256_add_ps(joint, log_prob);
  }
  _mm256_store_ps(panel.log_prob, joint);
}

// Runs networks for `rows` observations from row `start` on: values_, and logits_ if wanted.
void Policy::run_block(std::span<const float> observations, int start, int rows, bool logits) {
  const float* seen = normalise(
      observations.data() + static_cast<std::ptrdiff_t>(start) * shape_.observations, rows);
  if (logits) forward(actor_, see(actor_, seen, rows), rows, padded_logits_, logits_.data());
  forward(critic_, see(critic_, seen, rows), rows, 8, values_.data());
}

void Policy::act(std::span<const float> observations, std::span<const ActionCounter> counters,
                 bool greedy, std::span<Decision> decisions) {
  check_sizes(observations, decisions.size());
  OMENTUM_CHECK(counters.size() == decisions.size());
  const int total = static_cast<int>(decisions.size());
  const auto branches = static_cast<std::size_t>(shape_.branch_count());
  for (int start = 0; start < total; start += kBlock) {
    const int rows = std::min(kBlock, total - start);
    run_block(observations, start, rows, true);
    for (int first = 0; first < rows; first += lanes::kWidth) {
      const int count = std::min(lanes::kWidth, rows - first);
      Panel panel = load_panel(first, count);
      for (int lane = 0; lane < lanes::kWidth && !greedy; ++lane) {
        const ActionCounter& c =
            counters[static_cast<std::size_t>(start + first + (lane < count ? lane : 0))];
        PhiloxWords words{};
        for (std::size_t b = 0; b < branches; ++b) {
          const auto draw = static_cast<std::uint32_t>(b / words.size());
          if (b % words.size() == 0)
            words = random_words(c.run_seed, c.slot, c.purpose, draw, c.episode, c.episode_step);
          panel.uniform[b][lane] = uniform_24(words[b % words.size()]);
        }
      }
      if (shape_.continuous) {
        sample_gaussian(panel, greedy);
      } else {
        sample_discrete(panel, greedy);
      }
      score(panel);
      for (int lane = 0; lane < count; ++lane) {
        Decision& decision = decisions[static_cast<std::size_t>(start + first + lane)];
        decision = Decision{};
        for (std::size_t b = 0; b < branches; ++b) {
          if (shape_.continuous) {
            decision.continuous[b] = panel.continuous[b][lane];
          } else {
            decision.branch[b] = static_cast<std::uint8_t>(panel.branch[b][lane]);
          }
        }
        decision.log_prob = panel.log_prob[lane];
        decision.value = values_[static_cast<std::size_t>((first + lane) * 8)];
      }
    }
  }
}

void Policy::evaluate(std::span<const float> observations,
                      std::span<const std::uint8_t> branches_taken,
                      std::span<const float> continuous_taken, std::span<float> log_probs,
                      std::span<float> values, std::span<float> branch_log_probs) {
  check_sizes(observations, log_probs.size());
  const std::size_t taken = shape_.continuous ? continuous_taken.size() : branches_taken.size();
  const std::size_t columns = shape_.columns();
  OMENTUM_CHECK(taken == log_probs.size() * columns && values.size() == log_probs.size());
  OMENTUM_CHECK(branch_log_probs.empty() || branch_log_probs.size() == log_probs.size() * columns);
  const int total = static_cast<int>(log_probs.size());
  const auto branches = static_cast<std::size_t>(shape_.branch_count());
  for (int start = 0; start < total; start += kBlock) {
    const int rows = std::min(kBlock, total - start);
    run_block(observations, start, rows, true);
    for (int first = 0; first < rows; first += lanes::kWidth) {
      const int count = std::min(lanes::kWidth, rows - first);
      Panel panel = load_panel(first, count);
      for (int lane = 0; lane < lanes::kWidth; ++lane) {
        const auto row = static_cast<std::size_t>(start + first + (lane < count ? lane : 0));
        for (std::size_t b = 0; b < branches; ++b) {
          if (shape_.continuous) {
            panel.continuous[b][lane] = continuous_taken[row * columns + b];
          } else {
            panel.branch[b][lane] = branches_taken[row * columns + b];
          }
        }
      }
      score(panel);
      for (int lane = 0; lane < count; ++lane) {
        const auto row = static_cast<std::size_t>(start + first + lane);
        log_probs[row] = panel.log_prob[lane];
        values[row] = values_[static_cast<std::size_t>((first + lane) * 8)];
        for (std::size_t b = 0; b < columns && !branch_log_probs.empty(); ++b)
          branch_log_probs[row * columns + b] = b < branches ? panel.branch_log_prob[b][lane] : 0;
      }
    }
  }
}

void Policy::estimate(std::span<const float> observations, std::span<float> values) {
  check_sizes(observations, values.size());
  const int total = static_cast<int>(values.size());
  for (int start = 0; start < total; start += kBlock) {
    const int rows = std::min(kBlock, total - start);
    run_block(observations, start, rows, false);
    for (int row = 0; row < rows; ++row)
      values[static_cast<std::size_t>(start + row)] = values_[static_cast<std::size_t>(row * 8)];
  }
}

void Policy::check_sizes(std::span<const float> observations, std::size_t rows) const {
  OMENTUM_CHECK(observations.size() == rows * static_cast<std::size_t>(shape_.observations));
}

Sha256 hash_weights(std::span<const float> parameters, std::span<const float> obs_mean,
                    std::span<const float> obs_inv_std) {
  static_assert(std::endian::native == std::endian::little);
  const std::array<std::uint64_t, 2> sizes = {parameters.size(), obs_mean.size()};
  Bytes bytes;
  const auto append = [&](std::span<const std::byte> piece) {
    bytes.insert(bytes.end(), piece.begin(), piece.end());
  };
  append(std::as_bytes(std::span(sizes)));
  append(bytes_of(parameters));
  append(bytes_of(obs_mean));
  append(bytes_of(obs_inv_std));
  return sha256(bytes);
}

}  // namespace omentum
