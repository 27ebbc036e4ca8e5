#include "learner/gradient.h"

#include <algorithm>

#include "core/activation.h"
#include "core/check.h"
#include "core/gemm.h"
#include "learner/activate.h"

namespace omentum {

using lanes::Lane;

PackedWeights::PackedWeights(const PolicyShape& shape, const TrainingLayout& layout)
    : shape_(shape), layout_(layout) {
  const auto hidden = static_cast<std::size_t>(layout.hidden());
  for (Network* network : {&actor_, &critic_}) {
    network->weights1.resize(static_cast<std::size_t>(shape.inputs()) * hidden);
    network->weights2.resize(hidden * hidden);
    network->weights2_transposed.resize(hidden * hidden);
    const auto outputs = static_cast<std::size_t>(
        padded_columns(network == &actor_ ? shape.logits() : layout.blocks().critic.outputs));
    network->head.resize(hidden * outputs);
    network->head_bias.resize(outputs);
    if (!shape.convolution) continue;
    const Convolution second = second_convolution(shape.picture);
    network->features_transposed.resize(static_cast<std::size_t>(shape.features()) * hidden);
    network->filters2_transposed.resize(
        static_cast<std::size_t>(second.filters * padded_columns(second.patch())));
  }
}

void PackedWeights::pack_network(const NetworkLayout& blocks, Network& network) const {
  const int hidden = layout_.hidden();
  pack_panels(parameters_ + blocks.weights1, shape_.inputs(), hidden, hidden,
              network.weights1.data());
  pack_panels(parameters_ + blocks.weights2, hidden, hidden, hidden, network.weights2.data());
  pack_panels_transposed(parameters_ + blocks.weights2, hidden, hidden, hidden,
                         network.weights2_transposed.data());
  pack_panels_transposed(parameters_ + blocks.head, blocks.outputs, hidden, hidden,
                         network.head.data());
  if (blocks.has_head_bias)
    std::copy_n(parameters_ + blocks.head_bias, blocks.outputs, network.head_bias.begin());
  if (!shape_.convolution) return;
  const Convolution second = second_convolution(shape_.picture);
  pack_panels_transposed(
      parameters_ + blocks.weights1 + static_cast<std::ptrdiff_t>(shape_.numbers()) * hidden,
      shape_.features(), hidden, hidden, network.features_transposed.data());
  pack_panels_transposed(parameters_ + blocks.filters2, second.patch(), second.filters,
                         second.filters, network.filters2_transposed.data());
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
  if (shape.convolution) convolutions_.emplace(shape, layout);
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
  const auto logits = static_cast<std::size_t>(kChunk * padded_columns(shape.logits()));
  logits_.resize(logits);
  logit_gradient_.resize(logits);
  values_.resize(kChunk * 8);
  value_gradient_.resize(kChunk * 8);
}

void ChunkGradient::gather(const MinibatchView& m, int first, int count) {
  const Batch& batch = *m.batch;
  const auto width = static_cast<std::size_t>(shape_.observations);
  const std::size_t columns = shape_.columns();
  for (int i = 0; i < kChunk; ++i) {
    // Rows behind the end repeat the first sample; they enter no sum.
    const std::size_t row = m.rows[static_cast<std::size_t>(first + (i < count ? i : 0))];
    if (i < count)
      std::copy_n(m.inputs.data() + row * width, width,
                  x_.data() + static_cast<std::size_t>(i) * width);
    for (std::size_t b = 0; b < columns; ++b) {
      inputs_.branch[b][i] = batch.branches[row * columns + b];
      inputs_.old_branch_log_prob[b][i] = batch.branch_log_probs[row * columns + b];
    }
    for (std::size_t d = 0; shape_.continuous && d < kContinuousDimensions; ++d)
      inputs_.continuous[d][i] = batch.continuous[row * kContinuousDimensions + d];
    inputs_.old_log_prob[i] = batch.log_probs[row];
    inputs_.old_value[i] = batch.values[row];
    inputs_.target[i] = m.returns[row];
    inputs_.advantage[i] = static_cast<float>(
        (static_cast<double>(m.advantages[row]) - m.advantage_mean) * m.advantage_scale);
  }
}

void ChunkGradient::activate_rows(float* values, float* slopes, int count) const {
  for (int row = 0; row < count; ++row) {
    float* slope = slopes == nullptr ? nullptr : slopes + row * leading_;
    activate(shape_.activation, values + row * leading_, slope, layout_.hidden());
  }
}

void ChunkGradient::forward(const PackedWeights::Network& w, const NetworkLayout& blocks,
                            const float* parameters, const float* x, int count, Activations& a,
                            int columns, float* outputs) {
  const int hidden = layout_.hidden();
  const int inputs = shape_.inputs();
  gemm(count, hidden, inputs,
       {x, inputs, 1, w.weights1.data(), kPanel, static_cast<std::ptrdiff_t>(inputs) * kPanel,
        a.y1.data(), leading_, parameters + blocks.bias1});
  activate_rows(a.y1.data(), a.s1.data(), count);
  gemm(count, hidden, hidden,
       {a.y1.data(), leading_, 1, w.weights2.data(), kPanel,
        static_cast<std::ptrdiff_t>(hidden) * kPanel, a.y2.data(), leading_,
        parameters + blocks.bias2});
  activate_rows(a.y2.data(), a.s2.data(), count);
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
                             const float* parameters, const float* x, int count,
                             const Activations& a, int columns, const float* output_gradient,
                             float* gradient) {
  const int hidden = layout_.hidden();
  const int inputs = shape_.inputs();
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
  gemm(inputs, hidden, count,
       {x, 1, inputs, d1_.data(), leading_, kPanel, gradient + blocks.weights1, hidden, nullptr});
}

/// From the first layer of the network that backward() was just run for to its features.
void ChunkGradient::to_features(const PackedWeights::Network& w, int count,
                                float* feature_gradient) const {
  const int hidden = layout_.hidden();
  gemm(
      count, shape_.features(), hidden,
      {d1_.data(), leading_, 1, w.features_transposed.data(), kPanel,
       static_cast<std::ptrdiff_t>(hidden) * kPanel, feature_gradient, shape_.features(), nullptr});
}

LossSums ChunkGradient::operator()(const PackedWeights& weights, const LossSettings& settings,
                                   const MinibatchView& minibatch, int first, int count,
                                   std::span<float> gradient) {
  OMENTUM_CHECK(count >= 1 && count <= kChunk && gradient.size() == layout_.count());
  const ParameterLayout& blocks = layout_.blocks();
  const float* parameters = weights.parameters();
  gather(minibatch, first, count);
  const float* actor_x = x_.data();
  const float* critic_x = x_.data();
  if (convolutions_) {
    convolutions_->forward(x_.data(), parameters, count);
    actor_x = convolutions_->actor().inputs.data();
    critic_x = convolutions_->critic().inputs.data();
  }
  const int logits = padded_columns(shape_.logits());
  forward(weights.actor(), blocks.actor, parameters, actor_x, count, actor_, logits,
          logits_.data());
  forward(weights.critic(), blocks.critic, parameters, critic_x, count, critic_, 8, values_.data());
  if (shape_.continuous) std::fill_n(gradient.data() + blocks.log_std, kPanel, 0.0F);
  const LossSums sums =
      loss_(settings, weights.gaussian(), inputs_, count, logits_.data(), values_.data(),
            logit_gradient_.data(), value_gradient_.data(), gradient.data() + blocks.log_std);
  backward(weights.actor(), blocks.actor, parameters, actor_x, count, actor_, logits,
           logit_gradient_.data(), gradient.data());
  if (convolutions_)
    to_features(weights.actor(), count, convolutions_->actor().feature_gradient.data());
  backward(weights.critic(), blocks.critic, parameters, critic_x, count, critic_, 8,
           value_gradient_.data(), gradient.data());
  if (convolutions_) {
    to_features(weights.critic(), count, convolutions_->critic().feature_gradient.data());
    convolutions_->backward(
        x_.data(),
        {weights.actor().filters2_transposed.data(), weights.critic().filters2_transposed.data()},
        count, gradient.data());
  }
  return sums;
}

}  // namespace omentum
