#pragma once

#include <array>
#include <cstdint>

#include "core/policy.h"
#include "proto/config.pb.h"

namespace omentum {

/// Samples of one gradient chunk (docs/learner.md 3.4). Another size has other rounding.
inline constexpr int kChunk = 64;

/// Switches and coefficients of the loss for one minibatch.
struct LossSettings {
  pb::RatioKind ratio = pb::RATIO_JOINT;
  float ratio_low = 0.8F;   ///< 1 - clip, or 1 / (1 + clip)
  float ratio_high = 1.2F;  ///< 1 + clip
  bool value_clip = false;
  float value_range = 0.2F;
  float value_coefficient = 0.5F;
  float entropy = 0.005F;
  float per_sample = 1.0F;          ///< 1 / samples of the minibatch
  bool likelihood = false;          ///< the policy's part is -log pi(action): maximum likelihood
  float policy_coefficient = 1.0F;  ///< 0 with entropy 0: the actor's gradient is exactly zero
};

/// Per-sample inputs of the loss, gathered in minibatch order.
struct LossInputs {
  alignas(64) std::int32_t branch[kActionBranches][kChunk];
  alignas(64) float continuous[kContinuousDimensions][kChunk];
  alignas(64) float old_branch_log_prob[kActionBranches][kChunk];
  alignas(64) float old_log_prob[kChunk];
  alignas(64) float advantage[kChunk];  // normalised
  alignas(64) float target[kChunk];     // return
  alignas(64) float old_value[kChunk];
};

/// Sums over samples, in double, in sample order; extrema. Added chunk by chunk in chunk order.
struct LossSums {
  double samples = 0;
  double policy_loss = 0;
  double value_loss = 0;
  std::array<double, kActionBranches> entropy{};    ///< per branch
  std::array<double, kActionBranches> branch_kl{};  ///< k3 estimator per branch
  double kl = 0;                                    ///< k3 = (r - 1) - log r of the joint ratio
  double old_kl = 0;                                ///< k1 = -log r
  double clipped = 0;  ///< samples (joint) or branch fractions (per branch) outside the clip range
  double ratio = 0;
  double ratio_min = 1e30, ratio_max = -1e30;
  double value_delta = 0;  ///< |new - old value|

  void add(const LossSums& other);
};

/// Parameters of the Gaussian head, once per minibatch.
struct GaussianHead {
  std::array<float, 4> log_std{};
  std::array<float, 4> inverse_std{};
};

/// The PPO loss of up to 64 samples and its derivatives, all in f32 lanes of eight samples.
///
///   loss = policy_coefficient mean(policy) - entropy mean(sum of H_b)
///          + value_coefficient mean(value)
///
///   policy, joint       -min(r A, clip(r) A), r = exp(sum of log ratios)
///
///   policy, per branch  -mean over branches of min(r_b A, clip(r_b) A)
///
///   policy, likelihood  -sum of the branches' log-probabilities, whatever `ratio` is
///
///   value               (v - R)^2; with value_clip the larger of it and
///                       (v_old + clip(v - v_old) - R)^2
///
/// logits: count x padded_columns(logits) raw head outputs; values: count x 8, column 0. Writes
/// d loss / d logits (as wide, other columns zero), d loss / d value (count x 8, other columns
/// zero) and, with the Gaussian head, adds to log_std_gradient. Precondition: 1 <= count <= kChunk.
class Loss {
 public:
  explicit Loss(const PolicyShape& shape) : shape_(shape) {}

  LossSums operator()(const LossSettings& settings, const GaussianHead& gaussian,
                      const LossInputs& inputs, int count, const float* logits, const float* values,
                      float* logit_gradient, float* value_gradient, float* log_std_gradient) const;

 private:
  PolicyShape shape_;
};

}  // namespace omentum
