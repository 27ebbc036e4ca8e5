#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/aligned.h"
#include "core/convolution.h"
#include "core/rng.h"
#include "core/types.h"
#include "proto/config.pb.h"

namespace omentum {

/// Normalised observations are clipped to +- this (docs/learner.md 4, row 19).
inline constexpr float kObservationClip = 10.0F;

/// Dimensions of the Gaussian head: three increments and the jaw.
inline constexpr int kContinuousDimensions = 4;

/// Outputs of the actor at most: 3 + 3 + 3 + 2 + 3 + 3 + 3.
inline constexpr int kMaxLogits = 20;

/// Shape of actor and critic: two separate networks O -> hidden -> hidden -> heads, and -> 1.
/// With `continuous` the actor head is 4 means and 4 state-independent log standard deviations
/// follow. With `convolution` each network has two convolutions over the picture, whose outputs
/// take the place of the pixels.
struct PolicyShape {
  int observations = 0;       ///< O: numbers, then the values of the picture
  PictureShape picture;       ///< of size 0 where there is none
  bool convolution = false;   ///< needs a picture that can_convolve()
  std::vector<int> branches;  ///< sizes of the discrete ones, as 3 3 3 2; empty with `continuous`
  bool continuous = false;
  int hidden = 128;
  pb::Activation activation = pb::ACTIVATION_TANH;
  bool head_bias = true;

  int numbers() const { return observations - picture.values(); }
  int features() const;      ///< of the picture, by the convolutions; 0 without
  int inputs() const;        ///< of the first hidden layer: numbers and features, or O
  int logits() const;        ///< sum of branches (at most kMaxLogits), or 4
  int branch_count() const;  ///< branches, or 4: terms of the joint log-probability
  std::size_t columns() const { return action_columns(branches.size()); }  ///< of actions
  std::size_t parameter_count() const;
  std::uint64_t layout_hash() const;  ///< over every field above
};

/// Offsets of one network inside PolicyWeights::parameters. I inputs, H hidden, L outputs; the
/// convolutions as in core/convolution.h, absent without PolicyShape::convolution.
struct NetworkLayout {
  int outputs = 0;
  bool has_head_bias = true;
  std::size_t filters1 = 0;       ///< patch x filters of the first convolution, row = input
  std::size_t filters1_bias = 0;  ///< filters
  std::size_t filters2 = 0;       ///< of the second
  std::size_t filters2_bias = 0;
  std::size_t weights1 = 0;   ///< I x H, row = input
  std::size_t bias1 = 0;      ///< H
  std::size_t weights2 = 0;   ///< H x H, row = input
  std::size_t bias2 = 0;      ///< H
  std::size_t head = 0;       ///< L x H, row = output
  std::size_t head_bias = 0;  ///< L, absent without has_head_bias
};

/// The canonical order of all parameters: actor, log_std (4, Gaussian head only), critic. It
/// reaches wire, disk and hashes: do not change without a new layout_hash.
struct ParameterLayout {
  NetworkLayout actor;
  std::size_t log_std = 0;
  NetworkLayout critic;
  std::size_t count = 0;
};
ParameterLayout parameter_layout(const PolicyShape& shape);

/// The random counter of one sampled action (docs/learner.md 3.2).
struct ActionCounter {
  std::uint64_t run_seed = 0;
  std::uint32_t slot = 0;
  std::uint64_t episode = 0;
  std::uint32_t episode_step = 0;
  Purpose purpose = Purpose::kAction;  ///< kEvaluation in evaluate tasks
};

/// What the policy decided for one environment.
struct Decision {
  std::array<std::uint8_t, kActionBranches> branch{};
  std::array<float, 4> continuous{};
  float log_prob = 0;  ///< joint, of the action taken (also when greedy)
  float value = 0;
};

/// The behaviour policy: normaliser, actor, critic, sampling. One kernel for workers, learner and
/// gateway in which every output accumulates in ascending input order by fused multiply-add
/// (core/gemm.h) and the head works on eight samples as lanes, so the result for one observation is
/// bit-identical whatever batch it came in. No call allocates. Not thread-safe (scratch memory);
/// make one per thread. Copies are independent.
class Policy {
 public:
  /// Aborts if the sizes of `weights` do not fit `shape`, for which callers check layout_hash
  /// first, if the head has more than kMaxLogits outputs, or if this thread rounds otherwise than
  /// IEEE's default (core/fp_mode.h).
  Policy(const PolicyShape& shape, PolicyWeights weights);

  const PolicyShape& shape() const { return shape_; }
  const PolicyWeights& weights() const { return weights_; }

  /// Decides for n = decisions.size() environments: observations n x O raw, one counter each, also
  /// when greedy; other sizes abort. `greedy` takes the arg max (lowest index wins a tie) or the
  /// mean. Sampling: one random_words() call gives one word per branch, a second one (draw 1) those
  /// of the branches behind the fourth; u = uniform_24(word); the first action whose cumulative
  /// probability exceeds u, the last one takes the remainder. Gaussian: mean + std times the normal
  /// quantile of (u + 2^-25).
  void act(std::span<const float> observations, std::span<const ActionCounter> counters,
           bool greedy, std::span<Decision> decisions);

  /// Joint log-probability of given actions and the value, for the learner's integrity check and
  /// for replay: the same bits that act() returned. branches_taken: n x columns() (discrete head);
  /// continuous_taken: n x 4 (Gaussian). `branch_log_probs`, n x columns(), may be empty; unused
  /// branches get 0; their ascending sum is the joint value. n = log_probs.size(); other sizes
  /// abort. An index at or beyond the size of its branch counts as 0.
  void evaluate(std::span<const float> observations, std::span<const std::uint8_t> branches_taken,
                std::span<const float> continuous_taken, std::span<float> log_probs,
                std::span<float> values, std::span<float> branch_log_probs = {});

  /// Values alone, for bootstrapping: the same bits that act() and evaluate() return. Aborts unless
  /// there are values.size() x O observations.
  void estimate(std::span<const float> observations, std::span<float> values);

 private:
  /// Weights of one network, packed for gemm().
  struct Packed {
    AlignedFloats filters1, filters1_bias, filters2, filters2_bias;
    AlignedFloats weights1, bias1, weights2, bias2, head, head_bias;
  };
  /// Eight samples with the sample as the innermost index.
  struct Panel;

  Packed pack(const NetworkLayout& layout) const;
  void check_sizes(std::span<const float> observations, std::size_t rows) const;
  void run_block(std::span<const float> observations, int start, int rows, bool logits);
  const float* see(const Packed& network, const float* observations, int count);
  void forward(const Packed& network, const float* inputs, int count, int output_columns,
               float* outputs);
  void activate(float* values, int count) const;
  const float* normalise(const float* observations, int count);
  Panel load_panel(int first, int count) const;
  void sample_discrete(Panel& panel, bool greedy) const;
  void sample_gaussian(Panel& panel, bool greedy) const;
  void score(Panel& panel) const;

  PolicyShape shape_;
  PolicyWeights weights_;
  int padded_hidden_ = 0;
  int padded_logits_ = 0;
  Packed actor_, critic_;
  std::array<float, 4> std_{}, inverse_std_{}, log_std_{};
  Convolution convolution1_, convolution2_;
  AlignedFloats planes_, patches_, outputs1_, patches2_, outputs2_;  ///< of one picture
  AlignedFloats normalised_, inputs_, hidden1_, hidden2_, logits_, values_;
};

/// SHA-256 over parameters and normaliser in canonical little-endian bytes.
Sha256 hash_weights(std::span<const float> parameters, std::span<const float> obs_mean,
                    std::span<const float> obs_inv_std);

/// Shape of the policy of a configuration, for the observations and actions of its task
/// (core/task.h).
PolicyShape policy_shape(const pb::Config& config);

}  // namespace omentum
