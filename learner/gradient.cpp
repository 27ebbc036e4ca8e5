#include "learner/gradient.h"

#include <algorithm>

#include "core/activation.h"
#include "core/check.h"
#include "core/gemm.h"

namespace omentum {

using lanes::Lane;

PackedWeights::PackedWeights(const PolicyShape& shape, const TrainingLayout& layout)
    : shape_(shape), layout_(layout) {
  const auto hidden = static_cast<std::size_t>(layout.hidden());
  for (Network* network : {&actor_, &critic_}) {
    network->weights1.resize(static_cast<std::size_t>(shape.observations) * hidden);
    network->weights2.resize(hidden * hidden);
    network->weights2_transposed.resize(hidden * hidden);
    network->head.resize(hidden * kPanel);
    network->head_bias.resize(kPanel);
  }
}

void PackedWeights::pack_network(const NetworkLayout& blocks, Network& network) const {
  const int hidden = layout_.hidden();
  pack_panels(parameters_ + blocks.weights1, shape_.observations, hidden, hidden,
              network.weights1.data());
  pack_panels(parameters_ + blocks.weights2, hidden, hidden, hidden, network.weights2.data());
  pack_panels_transposed(parameters_ + blocks.weights2, hidden, hidden, hidden,
                         network.weights2_transposed.data());
  pack_panels_transposed(parameters_ + blocks.head, blocks.outputs, hidden, hidden,
                         network.head.data());
  if (blocks.has_head_bias)
    std::copy_n(parameters_ + blocks.head_bias, blocks.outputs, network.head_bias.begin());
}

void PackedWeights::pack(std::span<const float> parameters) {
  OMENTUM_CHECK(parameters.size() == layout_.count());
  parameters_ = parameters.data();
  pack_network(layout_.blocks().actor, actor_);
  pack_network(layout_.blocks().critic, critic_);
  if (!shape_.continuous) return;
  for (std::size_t d = 0; d < 4; ++d) {
    gaussian_.log_std[d] = parameters[layout_.blocks().log_std + d];
    gaussian_.inverse_std[d] = lanes::exp(-gaussian_.log_std[d]);
  }
}

ChunkGradient::ChunkGradient(const PolicyShape& shape, const TrainingLayout& layout)
    : shape_(shape), layout_(layout), loss_(shape), leading_(layout.hidden() + kPanel) {
  // No power of two as leading dimension: entries of a column would map to a few cache sets.
  const auto size = static_cast<std::size_t>(kChunk * leading_);
  x_.resize(static_cast<std::size_t>(kChunk * shape.observations));
  for (Activations* a : {&actor_, &critic_}) {
    a->y1.resize(size);
    a->y2.resize(size);
    if (shape.activation == pb::ACTIVATION_SWISH) {
      a->s1.resize(size);
      a->s2.resize(size);
    }
  }
  d1_.resize(size);
  d2_.resize(size);
  logits_.resize(kChunk * kPanel);
  logit_gradient_.resize(kChunk * kPanel);
  values_.resize(kChunk * 8);
  value_gradient_.resize(kChunk * 8);
}

void ChunkGradient::gather(const MinibatchView& m, int first, int count) {
  const Batch& batch = *m.batch;
  const auto width = static_cast<std::size_t>(shape_.observations);
  for (int i = 0; i < kChunk; ++i) {
    // Rows behind the end repeat the first sample; they enter no sum.
    const std::size_t row = m.rows[static_cast<std::size_t>(first + (i < count ? i : 0))];
    if (i < count)
      std::copy_n(m.inputs.data() + row * width, width,
                  x_.data() + static_cast<std::size_t>(i) * width);
    for (std::size_t b = 0; b < 4; ++b) {
      inputs_.branch[b][i] = batch.branches[row * 4 + b];
      inputs_.continuous[b][i] = shape_.continuous ? batch.continuous[row * 4 + b] : 0.0F;
      inputs_.old_branch_log_prob[b][i] = batch.branch_log_probs[row * 4 + b];
    }
    inputs_.old_log_prob[i] = batch.log_probs[row];
    inputs_.old_value[i] = batch.values[row];
    inputs_.target[i] = m.returns[row];
    inputs_.advantage[i] = static_cast<float>(
        (static_cast<double>(m.advantages[row]) - m.advantage_mean) * m.advantage_scale);
  }
}

void ChunkGradient::activate(float* values, float* slopes, int count) const {
  const int hidden = layout_.hidden();
  for (int row = 0; row < count; ++row) {
    float* y = values + row * leading_;
    if (shape_.activation == pb::ACTIVATION_TANH) {
      int i = 0;
      for (; i + 32 <= hidden; i += 32) {
        Lane t[4];
        for (int j = 0; j < 4; ++j) t[j] = lanes::tanh(_mm256_load_ps(y + i + 8 * j));
        for (int j = 0; j < 4; ++j) _mm256_store_ps(y + i + 8 * j, t[j]);
      }
      for (; i < hidden; i += 8) _mm256_store_ps(y + i, lanes::tanh(_mm256_load_ps(y + i)));
      continue;
    }
    // swish y = x s, y' = s + y (1 - s)
    float* slope = slopes + row * leading_;
    for (int i = 0; i < hidden; i += 16) {
      for (int j = i; j < i + 16; j += 8) {
        const Lane x = _mm256_load_ps(y + j);
        const Lane s = lanes::sigmoid(x);
        const Lane out = _mm256_mul_ps(x, s);
        _mm256_store_ps(y + j, out);
        _mm256_store_ps(slope + j, lanes::fma(out, _mm256_sub_ps(lanes::splat(1.0F), s), s));
      }
    }
  }
}

void ChunkGradient::forward(const PackedWeights::Network& w, const NetworkLayout& blocks,
                            const float* parameters, int count, Activations& a, int columns,
                            float* outputs) {
  const int hidden = layout_.hidden();
  const int observations = shape_.observations;
  gemm(count, hidden, observations,
       {x_.data(), observations, 1, w.weights1.data(), kPanel,
        static_cast<std::ptrdiff_t>(observations) * kPanel, a.y1.data(), leading_,
        parameters + blocks.bias1});
  activate(a.y1.data(), a.s1.data(), count);
  gemm(count, hidden, hidden,
       {a.y1.data(), leading_, 1, w.weights2.data(), kPanel,
        static_cast<std::ptrdiff_t>(hidden) * kPanel, a.y2.data(), leading_,
        parameters + blocks.bias2});
  activate(a.y2.data(), a.s2.data(), count);
  gemm(count, columns, hidden,
       {a.y2.data(), leading_, 1, w.head.data(), kPanel,
        static_cast<std::ptrdiff_t>(hidden) * kPanel, outputs, columns, w.head_bias.data()});
}

// gradient *= activation'(.), and its column sums are the bias gradient.
void ChunkGradient::differentiate(float* gradient, const float* outputs, const float* slopes,
                                  int count, float* bias_gradient) const {
  const Lane one = lanes::splat(1.0F);
  const bool tanh = shape_.activation == pb::ACTIVATION_TANH;
  for (int i = 0; i < layout_.hidden(); i += 16) {
    Lane sum[2] = {_mm256_setzero_ps(), _mm256_setzero_ps()};
    for (int row = 0; row < count; ++row) {
      for (int j = 0; j < 2; ++j) {
        const int at = row * leading_ + i + 8 * j;
        const Lane y = _mm256_load_ps((tanh ? outputs : slopes) + at);
        const Lane slope = tanh ? _mm256_fnmadd_ps(y, y, one) : y;
        const Lane d = _mm256_mul_ps(_mm256_load_ps(gradient + at), slope);
        _mm256_store_ps(gradient + at, d);
        sum[j] = _mm256_add_ps(sum[j], d);
      }
    }
    _mm256_storeu_ps(bias_gradient + i, sum[0]);
    _mm256_storeu_ps(bias_gradient + i + 8, sum[1]);
  }
}

void ChunkGradient::backward(const PackedWeights::Network& w, const NetworkLayout& blocks,
                             const float* parameters, int count, const Activations& a, int columns,
                             const float* output_gradient, float* gradient) {
  const int hidden = layout_.hidden();
  const int observations = shape_.observations;
  const int outputs = blocks.outputs;
  // head: dW = dL^T y2, db = sum dL, dy2 = dL W
  gemm(outputs, hidden, count,
       {output_gradient, 1, columns, a.y2.data(), leading_, kPanel, gradient + blocks.head, hidden,
        nullptr});
  if (blocks.has_head_bias) {
    for (int o = 0; o < outputs; ++o) {
      float sum = 0;
      for (int row = 0; row < count; ++row) sum += output_gradient[row * columns + o];
      gradient[blocks.head_bias + static_cast<std::size_t>(o)] = sum;
    }
  }
  gemm(count, hidden, outputs,
       {output_gradient, columns, 1, parameters + blocks.head, hidden, kPanel, d2_.data(), leading_,
        nullptr});
  differentiate(d2_.data(), a.y2.data(), a.s2.data(), count, gradient + blocks.bias2);
  // second layer: dW = y1^T dz2, dy1 = dz2 W^T
  gemm(hidden, hidden, count,
       {a.y1.data(), 1, leading_, d2_.data(), leading_, kPanel, gradient + blocks.weights2, hidden,
        nullptr});
  gemm(count, hidden, hidden,
       {d2_.data(), leading_, 1, w.weights2_transposed.data(), kPanel,
        static_cast<std::ptrdiff_t>(hidden) * kPanel, d1_.data(), leading_, nullptr});
  differentiate(d1_.data(), a.y1.data(), a.s1.data(), count, gradient + blocks.bias1);
  // first layer: dW = x^T dz1
  gemm(observations, hidden, count,
       {x_.data(), 1, observations, d1_.data(), leading_, kPanel, gradient + blocks.weights1,
        hidden, nullptr});
}

LossSums ChunkGradient::operator()(const PackedWeights& weights, const LossSettings& settings,
                                   const MinibatchView& minibatch, int first, int count,
                                   std::span<float> gradient) {
  OMENTUM_CHECK(count >= 1 && count <= kChunk && gradient.size() == layout_.count());
  const ParameterLayout& blocks = layout_.blocks();
  const float* parameters = weights.parameters();
  gather(minibatch, first, count);
  forward(weights.actor(), blocks.actor, parameters, count, actor_, kPanel, logits_.data());
  forward(weights.critic(), blocks.critic, parameters, count, critic_, 8, values_.data());
  if (shape_.continuous) std::fill_n(gradient.data() + blocks.log_std, kPanel, 0.0F);
  const LossSums sums =
      loss_(settings, weights.gaussian(), inputs_, count, logits_.data(), values_.data(),
            logit_gradient_.data(), value_gradient_.data(), gradient.data() + blocks.log_std);
  backward(weights.actor(), blocks.actor, parameters, count, actor_, kPanel, logit_gradient_.data(),
           gradient.data());
  backward(weights.critic(), blocks.critic, parameters, count, critic_, 8, value_gradient_.data(),
           gradient.data());
  return sums;
}

}  // namespace omentum
