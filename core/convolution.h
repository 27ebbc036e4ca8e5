#pragma once

#include "core/picture_shape.h"

// The two convolutions through which a policy sees a picture (docs/learner.md 4.1): patches of the
// inputs, one per output position, times the filters. Sums are those of core/gemm.h, so the bits of
// a picture's features depend on that picture and the weights alone.

namespace omentum {

/// One convolution without padding. Inputs [y][x][plane], outputs [y][x][filter], weights
/// [dy][dx][plane][filter].
struct Convolution {
  int size = 0;  ///< inputs per side
  int planes = 0;
  int kernel = 0;
  int stride = 0;
  int filters = 0;  ///< a multiple of 16

  int side() const { return (size - kernel) / stride + 1; }  ///< outputs per side
  int positions() const { return side() * side(); }
  int inputs() const { return size * size * planes; }
  int patch() const { return kernel * kernel * planes; }  ///< inputs of one output
  int outputs() const { return positions() * filters; }
};

/// Pixels per side that the convolutions can take: multiples of 4 from 12 on.
inline constexpr int kConvolutionStep = 4;
inline constexpr int kConvolutionMinSize = 12;
bool can_convolve(const PictureShape& picture);

// Precondition of these three: can_convolve(picture).

/// 16 filters of 4 x 4 pixels, side by side.
Convolution first_convolution(const PictureShape& picture);
/// 32 filters over 3 x 3 outputs of the first, every second one.
Convolution second_convolution(const PictureShape& picture);

/// What features, the outputs of the second, are multiplied by: 1 / positions. The first hidden
/// layer then sums a mean over the picture, and a step of Adam moves it no more than one on the
/// numbers does, whatever the size of the picture.
float feature_scale(const PictureShape& picture);

/// The inputs of first_convolution(): from the pixels of a picture, as observed. `pixels` has
/// values() numbers, `planes` inputs() of first_convolution().
void make_planes(const PictureShape& picture, const float* pixels, float* planes);

/// positions x patch: the inputs of every output.
void gather_patches(const Convolution& convolution, const float* inputs, float* patches);
/// The transpose: adds every number of `patches` to the input it came from, in their order.
void scatter_patches(const Convolution& convolution, const float* patches, float* inputs);

/// outputs = bias + patches x weights.
void convolve(const Convolution& convolution, const float* patches, const float* weights,
              const float* bias, float* outputs);

}  // namespace omentum
