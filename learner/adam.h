#pragma once

#include <cstdint>
#include <span>

#include "core/aligned.h"
#include "proto/checkpoint.pb.h"
#include "proto/config.pb.h"

namespace omentum {

/// Adam [Kingma15] in two published forms, which differ in where epsilon enters:
///   torch        p -= lr / (1 - b1^t) * m / (sqrt(v) / sqrt(1 - b2^t) + eps)
///   tensorflow   p -= lr sqrt(1 - b2^t) / (1 - b1^t) * m / (sqrt(v) + eps)
/// Powers of the betas are products in double (no pow). Elementwise: any split into ranges has
/// the same bits.
class Adam {
 public:
  /// `count` parameters, padding included: a multiple of 8, else it aborts.
  Adam(const pb::Ppo& settings, std::size_t count);

  /// Once per step, before apply(): t + 1 and the step sizes at this learning rate.
  void begin_step(double learning_rate);
  /// Updates parameters [first, last), which must be multiples of 8 and at most `count`; the
  /// gradient is multiplied by `scale` first. Both spans have `count` entries. Nothing of it is
  /// checked.
  void apply(std::size_t first, std::size_t last, float scale, std::span<const float> gradient,
             std::span<float> parameters);

  std::uint64_t steps() const { return steps_; }
  double beta1_power() const { return beta1_power_; }
  double beta2_power() const { return beta2_power_; }
  const AlignedFloats& first() const { return first_; }
  const AlignedFloats& second() const { return second_; }
  /// For loading: moments in the layout of the parameters, `count` each, else it aborts.
  void restore(std::uint64_t steps, double beta1_power, double beta2_power, AlignedFloats first,
               AlignedFloats second);
  /// Largest entry of v.
  float largest_second_moment() const;

 private:
  double beta1_ = 0, beta2_ = 0, epsilon_ = 0;
  pb::AdamForm form_ = pb::ADAM_TORCH;
  std::uint64_t steps_ = 0;
  double beta1_power_ = 1, beta2_power_ = 1;
  float rate_ = 0;        // factor of m / denominator
  float root_scale_ = 1;  // factor of sqrt(v)
  AlignedFloats first_, second_;
};

}  // namespace omentum
