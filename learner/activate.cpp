#include "learner/activate.h"

#include "core/activation.h"

namespace omentum {

using lanes::Lane;

void activate(pb::Activation activation, float* values, float* slopes, int count) {
  if (activation == pb::ACTIVATION_TANH) {
    // Four independent evaluations at a time hide the latency of polynomial and division.
    int i = 0;
    for (; i + 32 <= count; i += 32) {
      Lane t[4];
      for (int j = 0; j < 4; ++j) t[j] = lanes::tanh(_mm256_load_ps(values + i + 8 * j));
      for (int j = 0; j < 4; ++j) _mm256_store_ps(values + i + 8 * j, t[j]);
    }
    for (; i < count; i += 8) _mm256_store_ps(values + i, lanes::tanh(_mm256_load_ps(values + i)));
    return;
  }
  // swish y = x s, y' = s + y (1 - s)
  for (int i = 0; i < count; i += 8) {
    const Lane x = _mm256_load_ps(values + i);
    const Lane s = lanes::sigmoid(x);
    const Lane out = _mm256_mul_ps(x, s);
    _mm256_store_ps(values + i, out);
    _mm256_store_ps(slopes + i, lanes::fma(out, _mm256_sub_ps(lanes::splat(1.0F), s), s));
  }
}

void multiply_by_slope(pb::Activation activation, const float* outputs, const float* slopes,
                       int count, float* gradient) {
  const bool tanh = activation == pb::ACTIVATION_TANH;
  const Lane one = lanes::splat(1.0F);
  for (int i = 0; i < count; i += 8) {
    const Lane y = _mm256_load_ps((tanh ? outputs : slopes) + i);
    const Lane slope = tanh ? _mm256_fnmadd_ps(y, y, one) : y;
    _mm256_store_ps(gradient + i, _mm256_mul_ps(_mm256_load_ps(gradient + i), slope));
  }
}

}  // namespace omentum
