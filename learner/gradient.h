#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "core/aligned.h"
#include "learner/batch.h"
#include "learner/convolution_gradient.h"
#include "learner/loss.h"
#include "learner/training_layout.h"

namespace omentum {

/// Weights of one minibatch step in the forms the products want; shared read-only by all threads.
class PackedWeights {
 public:
  /// `layout` must outlive it.
  PackedWeights(const PolicyShape& shape, const TrainingLayout& layout);

  /// Repacks from `parameters` (training layout, else it aborts), which must outlive the next use.
  void pack(std::span<const float> parameters);

  struct Network {
    AlignedFloats weights1;             // panels
    AlignedFloats weights2;             // panels
    AlignedFloats weights2_transposed;  // panels of the transpose
    AlignedFloats head;                 // panels of the transpose: hidden x outputs
    AlignedFloats head_bias;            // padded outputs, zero without bias
    AlignedFloats features_transposed;  // convolution: panels, of the rows of weights1 for features
    AlignedFloats filters2_transposed;  // convolution: panels
  };
  const Network& actor() const { return actor_; }
  const Network& critic() const { return critic_; }
  const GaussianHead& gaussian() const { return gaussian_; }
  const float* parameters() const { return parameters_; }

 private:
  void pack_network(const NetworkLayout& blocks, Network& network) const;

  PolicyShape shape_;
  const TrainingLayout& layout_;
  Network actor_, critic_;
  GaussianHead gaussian_;
  const float* parameters_ = nullptr;
};

/// What a minibatch is made of. Arrays are over the whole batch; `rows` picks and orders the
/// samples.
struct MinibatchView {
  const Batch* batch = nullptr;
  std::span<const float> inputs;  ///< n x O, normalised
  std::span<const float> advantages;
  double advantage_mean = 0;   ///< subtracted
  double advantage_scale = 1;  ///< then multiplied
  std::span<const float> returns;
  std::span<const std::uint32_t> rows;
};

/// Forward, loss and backward of one chunk of up to 64 samples: the training kernel. Activations
/// are row-major with a padded leading dimension, all products go through core/gemm.h, so a chunk's
/// gradient depends on its samples and the weights alone. Not thread-safe (workspace): one per
/// thread.
class ChunkGradient {
 public:
  /// `layout` must outlive it.
  ChunkGradient(const PolicyShape& shape, const TrainingLayout& layout);

  /// Overwrites `gradient` (training layout) with the gradient of samples [first, first + count) of
  /// the minibatch. Aborts unless 1 <= count <= kChunk and `gradient` has the size of the layout.
  LossSums operator()(const PackedWeights& weights, const LossSettings& settings,
                      const MinibatchView& minibatch, int first, int count,
                      std::span<float> gradient);

 private:
  struct Activations {
    AlignedFloats y1, y2;  // 64 x leading
    AlignedFloats s1, s2;  // swish only: derivative
  };
  void gather(const MinibatchView& minibatch, int first, int count);
  void forward(const PackedWeights::Network& weights, const NetworkLayout& blocks,
               const float* parameters, const float* x, int count, Activations& a, int columns,
               float* outputs);
  void backward(const PackedWeights::Network& weights, const NetworkLayout& blocks,
                const float* parameters, const float* x, int count, const Activations& a,
                int columns, const float* output_gradient, float* gradient);
  void to_features(const PackedWeights::Network& weights, int count, float* feature_gradient) const;
  void activate_rows(float* values, float* slopes, int count) const;
  void differentiate(float* gradient, const float* outputs, const float* slopes, int count,
                     float* bias_gradient) const;

  PolicyShape shape_;
  const TrainingLayout& layout_;
  Loss loss_;
  int leading_ = 0;
  LossInputs inputs_{};
  AlignedFloats x_;  // 64 x O
  std::optional<ConvolutionGradient> convolutions_;
  Activations actor_, critic_;
  AlignedFloats d1_, d2_;  // 64 x leading
  AlignedFloats logits_, values_, logit_gradient_, value_gradient_;
};

}  // namespace omentum
