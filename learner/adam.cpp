#include "learner/adam.h"

#include <immintrin.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/check.h"

namespace omentum {

Adam::Adam(const pb::Ppo& settings, std::size_t count)
    : beta1_(settings.adam_beta1()),
      beta2_(settings.adam_beta2()),
      epsilon_(settings.adam_epsilon()),
      form_(settings.adam()),
      first_(count, 0.0F),
      second_(count, 0.0F) {
  OMENTUM_CHECK(count % 8 == 0, "{} parameters are not padded", count);
}

void Adam::begin_step(double learning_rate) {
  ++steps_;
  beta1_power_ *= beta1_;
  beta2_power_ *= beta2_;
  const double root = std::sqrt(1 - beta2_power_);
  if (form_ == pb::ADAM_TORCH) {
    rate_ = static_cast<float>(learning_rate / (1 - beta1_power_));
    root_scale_ = static_cast<float>(1 / root);
  } else {
    rate_ = static_cast<float>(learning_rate * root / (1 - beta1_power_));
    root_scale_ = 1;
  }
}

void Adam::apply(std::size_t first, std::size_t last, float scale, std::span<const float> gradient,
                 std::span<float> parameters) {
  const __m256 factor = _mm256_set1_ps(scale);
  const __m256 beta1 = _mm256_set1_ps(static_cast<float>(beta1_));
  const __m256 beta2 = _mm256_set1_ps(static_cast<float>(beta2_));
  const __m256 fresh1 = _mm256_set1_ps(static_cast<float>(1 - beta1_));
  const __m256 fresh2 = _mm256_set1_ps(static_cast<float>(1 - beta2_));
  const __m256 epsilon = _mm256_set1_ps(static_cast<float>(epsilon_));
  const __m256 root_scale = _mm256_set1_ps(root_scale_);
  const __m256 rate = _mm256_set1_ps(rate_);
  for (std::size_t i = first; i < last; i += 8) {
    const __m256 g = _mm256_mul_ps(_mm256_loadu_ps(gradient.data() + i), factor);
    const __m256 m =
        _mm256_fmadd_ps(beta1, _mm256_load_ps(first_.data() + i), _mm256_mul_ps(fresh1, g));
    const __m256 v = _mm256_fmadd_ps(beta2, _mm256_load_ps(second_.data() + i),
                                     _mm256_mul_ps(fresh2, _mm256_mul_ps(g, g)));
    const __m256 denominator = _mm256_fmadd_ps(_mm256_sqrt_ps(v), root_scale, epsilon);
    const __m256 p = _mm256_fnmadd_ps(rate, _mm256_div_ps(m, denominator),
                                      _mm256_loadu_ps(parameters.data() + i));
    _mm256_store_ps(first_.data() + i, m);
    _mm256_store_ps(second_.data() + i, v);
    _mm256_storeu_ps(parameters.data() + i, p);
  }
}

void Adam::restore(std::uint64_t steps, double beta1_power, double beta2_power, AlignedFloats first,
                   AlignedFloats second) {
  OMENTUM_CHECK(first.size() == first_.size() && second.size() == second_.size());
  steps_ = steps;
  beta1_power_ = beta1_power;
  beta2_power_ = beta2_power;
  first_ = std::move(first);
  second_ = std::move(second);
}

float Adam::largest_second_moment() const {
  return *std::max_element(second_.begin(), second_.end());
}

}  // namespace omentum
