#include "core/convolution.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "core/gemm.h"

namespace omentum {

namespace {

/// Calls row(first input, first patch entry, count) for every run of consecutive inputs of every
/// patch.
template <typename Row>
void for_each_run(const Convolution& c, Row&& row) {
  const int run = c.kernel * c.planes;
  int entry = 0;
  for (int y = 0; y < c.side(); ++y) {
    for (int x = 0; x < c.side(); ++x) {
      for (int dy = 0; dy < c.kernel; ++dy, entry += run)
        row(((y * c.stride + dy) * c.size + x * c.stride) * c.planes, entry, run);
    }
  }
}

}  // namespace

bool can_convolve(const PictureShape& picture) {
  return picture.size >= kConvolutionMinSize && picture.size % kConvolutionStep == 0;
}

Convolution first_convolution(const PictureShape& picture) {
  return {picture.size, picture.planes(), kConvolutionStep, kConvolutionStep, 16};
}

Convolution second_convolution(const PictureShape& picture) {
  const Convolution first = first_convolution(picture);
  return {first.side(), first.filters, 3, 2, 32};
}

float feature_scale(const PictureShape& picture) {
  return 1.0F / static_cast<float>(second_convolution(picture).positions());
}

void make_planes(const PictureShape& picture, const float* pixels, float* planes) {
  if (picture.channels != 1) {
    std::copy_n(pixels, picture.values(), planes);
    return;
  }
  for (int i = 0; i < picture.values(); ++i) {
    const float id = pixels[i] * static_cast<float>(kObjectIds);
    for (int k = 1; k <= kObjectIds; ++k)
      *planes++ = std::abs(id - static_cast<float>(k)) < 0.5F ? 1.0F : 0.0F;
  }
}

void gather_patches(const Convolution& convolution, const float* inputs, float* patches) {
  for_each_run(convolution, [&](int input, int entry, int count) {
    std::copy_n(inputs + input, count, patches + entry);
  });
}

void scatter_patches(const Convolution& convolution, const float* patches, float* inputs) {
  for_each_run(convolution, [&](int input, int entry, int count) {
    for (int i = 0; i < count; ++i) inputs[input + i] += patches[entry + i];
  });
}

void convolve(const Convolution& convolution, const float* patches, const float* weights,
              const float* bias, float* outputs) {
  gemm(convolution.positions(), convolution.filters, convolution.patch(),
       {patches, convolution.patch(), 1, weights, convolution.filters, kPanel, outputs,
        convolution.filters, bias});
}

}  // namespace omentum
