#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/types.h"
#include "proto/config.pb.h"

namespace omentum {

/// Shape of actor and critic: two separate networks O -> hidden -> hidden -> heads, and -> 1.
/// With `continuous` the actor head is 4 means and 4 state-independent log standard deviations follow.
struct PolicyShape {
  int observations = 0;
  std::vector<int> branches;  ///< sizes of the discrete branches, e.g. 3 3 3 2; empty with `continuous`
  bool continuous = false;
  int hidden = 128;
  pb::Activation activation = pb::ACTIVATION_TANH;
  bool head_bias = true;

  int logits() const;                ///< sum of branches, or 4
  std::size_t parameter_count() const;
  std::uint64_t layout_hash() const; ///< over every field above
};

/// The random counter of one sampled action (learner.md 4.3).
struct ActionCounter {
  std::uint64_t run_seed = 0;
  std::uint32_t slot = 0;
  std::uint64_t episode = 0;
  std::uint32_t episode_step = 0;
};

/// What the policy decided for one environment.
struct Decision {
  std::array<std::uint8_t, 4> branch{};
  std::array<float, 4> continuous{};
  float log_prob = 0;  ///< joint, of the action taken (also when greedy)
  float value = 0;
};

/// The behaviour policy: normaliser, actor, critic, sampling. One kernel for workers, learner and gateway, in panels
/// of lanes with every output accumulated in ascending input order by fused multiply-add, so the result for one
/// observation is bit-identical whatever batch it came in. Not thread-safe (scratch memory); make one per thread.
class Policy {
 public:
  /// Aborts if weights.parameters.size() != shape.parameter_count().
  Policy(const PolicyShape& shape, PolicyWeights weights);

  const PolicyShape& shape() const { return shape_; }
  const PolicyWeights& weights() const { return weights_; }

  /// Decides for n environments: observations n x O raw, one counter each. `greedy` takes the arg max (lowest index
  /// wins a tie) or the mean. `masks` (n, bit per action in branch order, 1 = allowed) may be empty.
  void act(std::span<const float> observations, std::span<const ActionCounter> counters, bool greedy,
           std::span<const std::uint16_t> masks, std::span<Decision> decisions);

  /// Joint log-probability of given actions and the value, for the learner's integrity check and for replay:
  /// the same bits that act() returned.
  void evaluate(std::span<const float> observations, std::span<const std::uint8_t> branches_taken,
                std::span<const float> continuous_taken, std::span<const std::uint16_t> masks,
                std::span<float> log_probs, std::span<float> values);

 private:
  void forward(const float* observations, int count);  ///< one panel of up to 8 observations -> logits_, values_

  PolicyShape shape_;
  PolicyWeights weights_;
  std::vector<float> scratch_;
};

/// SHA-256 over parameters and normaliser in canonical little-endian bytes.
Sha256 hash_weights(std::span<const float> parameters, std::span<const float> obs_mean,
                    std::span<const float> obs_inv_std);

/// Observation and action layout of a task configuration.
PolicyShape policy_shape(const pb::Config& config);
std::vector<std::string> observation_names(const pb::Task& task);
std::vector<std::string> action_names(const pb::Task& task);

}  // namespace omentum
