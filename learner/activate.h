#pragma once

#include "proto/config.pb.h"

namespace omentum {

/// Applies the activation to `count` aligned values, a multiple of 16. With swish `slopes` gets the
/// derivative; that of tanh follows from its value and nothing is written.
void activate(pb::Activation activation, float* values, float* slopes, int count);

/// gradient *= derivative, from the outputs of activate() (tanh) or its slopes (swish).
void multiply_by_slope(pb::Activation activation, const float* outputs, const float* slopes,
                       int count, float* gradient);

}  // namespace omentum
