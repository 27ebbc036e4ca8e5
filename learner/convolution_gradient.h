#pragma once

#include <array>

#include "core/aligned.h"
#include "core/convolution.h"
#include "learner/training_layout.h"

namespace omentum {

/// Forward and backward of the convolutions of actor and critic for one chunk of samples
/// (learner/gradient.h). Samples are worked on one after the other and their gradients added in
/// that order, so a chunk's gradient depends on its samples and the weights alone. Not thread-safe.
class ConvolutionGradient {
 public:
  /// Of a shape with PolicyShape::convolution; `layout` must outlive it.
  ConvolutionGradient(const PolicyShape& shape, const TrainingLayout& layout);

  /// What one network reads and writes between forward and backward.
  struct Network {
    const NetworkLayout* blocks = nullptr;
    AlignedFloats inputs;            ///< chunk x inputs(): numbers and features
    AlignedFloats feature_gradient;  ///< chunk x features(), filled by the caller of backward()
    AlignedFloats y1, s1, y2, s2;    ///< outputs of the convolutions; slopes with swish
  };
  Network& actor() { return networks_[0]; }
  Network& critic() { return networks_[1]; }

  /// x: count x O. Fills Network::inputs; parameters in the training layout.
  void forward(const float* x, const float* parameters, int count);

  /// Overwrites the blocks of the convolutions in `gradient` (training layout). Uses up
  /// feature_gradient. filters2: of actor and critic, pack_panels_transposed.
  void backward(const float* x, std::array<const float*, 2> filters2_transposed, int count,
                float* gradient);

 private:
  void see(const float* x, int sample);
  void add_sample(Network& network, const float* filters2_transposed, int sample, float* gradient);
  void add_layer(const Convolution& convolution, const float* patches, const float* d,
                 float* filters, float* bias);

  PolicyShape shape_;
  Convolution first_, second_;
  std::array<Network, 2> networks_;
  // Of one sample.
  AlignedFloats planes_, patches1_, patches2_, d1_, patches2_gradient_, product_;
};

}  // namespace omentum
