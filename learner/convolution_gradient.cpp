#include "learner/convolution_gradient.h"

#include <algorithm>

#include "core/gemm.h"
#include "learner/activate.h"
#include "learner/loss.h"

namespace omentum {

namespace {

std::size_t size_of(int count) { return static_cast<std::size_t>(count); }

/// Null where there are no values: slopes of tanh.
float* row(AlignedFloats& values, int index, int width) {
  return values.empty() ? nullptr : values.data() + static_cast<std::ptrdiff_t>(index) * width;
}

}  // namespace

ConvolutionGradient::ConvolutionGradient(const PolicyShape& shape, const TrainingLayout& layout)
    : shape_(shape),
      first_(first_convolution(shape.picture)),
      second_(second_convolution(shape.picture)) {
  networks_[0].blocks = &layout.blocks().actor;
  networks_[1].blocks = &layout.blocks().critic;
  for (Network& network : networks_) {
    network.inputs.resize(size_of(kChunk * shape.inputs()));
    network.feature_gradient.resize(size_of(kChunk * shape.features()));
    network.y1.resize(size_of(kChunk * first_.outputs()));
    network.y2.resize(size_of(kChunk * second_.outputs()));
    if (shape.activation == pb::ACTIVATION_SWISH) {
      network.s1.resize(network.y1.size());
      network.s2.resize(network.y2.size());
    }
  }
  planes_.resize(size_of(first_.inputs()));
  patches1_.resize(size_of(first_.positions() * first_.patch()));
  patches2_.resize(size_of(second_.positions() * second_.patch()));
  d1_.resize(size_of(first_.outputs()));
  patches2_gradient_.resize(patches2_.size());
  product_.resize(
      size_of(std::max(first_.patch() * first_.filters, second_.patch() * second_.filters)));
}

/// The patches of the first convolution, the same for both networks.
void ConvolutionGradient::see(const float* x, int sample) {
  const float* observation = x + static_cast<std::ptrdiff_t>(sample) * shape_.observations;
  make_planes(shape_.picture, observation + shape_.numbers(), planes_.data());
  gather_patches(first_, planes_.data(), patches1_.data());
}

void ConvolutionGradient::forward(const float* x, const float* parameters, int count) {
  for (int i = 0; i < count; ++i) {
    see(x, i);
    for (Network& network : networks_) {
      const NetworkLayout& blocks = *network.blocks;
      const auto layer = [&](const Convolution& c, const float* patches, std::size_t filters,
                             std::size_t bias, AlignedFloats& y, AlignedFloats& s) {
        float* outputs = row(y, i, c.outputs());
        convolve(c, patches, parameters + filters, parameters + bias, outputs);
        activate(shape_.activation, outputs, row(s, i, c.outputs()), c.outputs());
        return outputs;
      };
      const float* y1 = layer(first_, patches1_.data(), blocks.filters1, blocks.filters1_bias,
                              network.y1, network.s1);
      gather_patches(second_, y1, patches2_.data());
      const float* y2 = layer(second_, patches2_.data(), blocks.filters2, blocks.filters2_bias,
                              network.y2, network.s2);
      float* inputs = row(network.inputs, i, shape_.inputs());
      std::copy_n(x + static_cast<std::ptrdiff_t>(i) * shape_.observations, shape_.numbers(),
                  inputs);
      const float scale = feature_scale(shape_.picture);
      std::transform(y2, y2 + second_.outputs(), inputs + shape_.numbers(),
                     [scale](float feature) { return feature * scale; });
    }
  }
}

/// filters += patches^T d, bias += column sums of d (positions x filters).
void ConvolutionGradient::add_layer(const Convolution& c, const float* patches, const float* d,
                                    float* filters, float* bias) {
  gemm(c.patch(), c.filters, c.positions(),
       {patches, 1, c.patch(), d, c.filters, kPanel, product_.data(), c.filters, nullptr});
  for (int i = 0; i < c.patch() * c.filters; ++i) filters[i] += product_[size_of(i)];
  for (int position = 0; position < c.positions(); ++position) {
    for (int f = 0; f < c.filters; ++f) bias[f] += d[position * c.filters + f];
  }
}

void ConvolutionGradient::add_sample(Network& network, const float* filters2_transposed, int i,
                                     float* gradient) {
  const NetworkLayout& blocks = *network.blocks;
  const float* y1 = row(network.y1, i, first_.outputs());
  float* d2 = row(network.feature_gradient, i, second_.outputs());
  const float scale = feature_scale(shape_.picture);
  std::transform(d2, d2 + second_.outputs(), d2, [scale](float d) { return d * scale; });
  multiply_by_slope(shape_.activation, row(network.y2, i, second_.outputs()),
                    row(network.s2, i, second_.outputs()), second_.outputs(), d2);
  gather_patches(second_, y1, patches2_.data());
  add_layer(second_, patches2_.data(), d2, gradient + blocks.filters2,
            gradient + blocks.filters2_bias);
  gemm(second_.positions(), second_.patch(), second_.filters,
       {d2, second_.filters, 1, filters2_transposed, kPanel,
        static_cast<std::ptrdiff_t>(second_.filters) * kPanel, patches2_gradient_.data(),
        second_.patch(), nullptr});
  std::fill(d1_.begin(), d1_.end(), 0.0F);
  scatter_patches(second_, patches2_gradient_.data(), d1_.data());
  multiply_by_slope(shape_.activation, y1, row(network.s1, i, first_.outputs()), first_.outputs(),
                    d1_.data());
  add_layer(first_, patches1_.data(), d1_.data(), gradient + blocks.filters1,
            gradient + blocks.filters1_bias);
}

void ConvolutionGradient::backward(const float* x, std::array<const float*, 2> filters2_transposed,
                                   int count, float* gradient) {
  for (const Network& network : networks_)
    std::fill(gradient + network.blocks->filters1, gradient + network.blocks->weights1, 0.0F);
  for (int i = 0; i < count; ++i) {
    see(x, i);
    for (std::size_t n = 0; n < networks_.size(); ++n)
      add_sample(networks_[n], filters2_transposed[n], i, gradient);
  }
}

}  // namespace omentum
