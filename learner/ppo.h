#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/aligned.h"
#include "core/policy.h"
#include "core/result.h"
#include "learner/adam.h"
#include "learner/batch.h"
#include "learner/gradient.h"
#include "learner/normaliser.h"
#include "learner/thread_pool.h"
#include "learner/training_layout.h"
#include "proto/checkpoint.pb.h"
#include "proto/config.pb.h"

namespace omentum {

/// What one update did. Losses are means over all samples of all minibatches that were used.
struct UpdateStats {
  std::uint64_t version = 0;  ///< of the weights it produced
  double learning_rate = 0, clip = 0, entropy_coefficient = 0;
  double policy_loss = 0, value_loss = 0;
  double entropy = 0;  ///< sum over branches
  std::array<double, kActionBranches> branch_entropy{};
  std::array<double, kActionBranches> branch_kl{};
  double approx_kl = 0, old_approx_kl = 0;  ///< k3 and k1 estimators
  double approx_kl_max = 0;                 ///< largest minibatch mean
  double clip_fraction = 0;
  double explained_variance = 0;  ///< of the behaviour values against the returns
  double gradient_norm = 0;       ///< mean over minibatches, before clipping
  double ratio_mean = 0, ratio_min = 0, ratio_max = 0;
  double adam_max_second_moment = 0;
  double value_delta = 0;                     ///< mean |new - behaviour value|
  std::uint32_t minibatches = 0, epochs = 0;  ///< done; fewer with target_kl
  bool stopped_by_kl = false;
};

/// What cloning did: means over the samples of the first and of the last pass.
struct CloningStats {
  /// Negative log likelihood of the shown actions, summed over branches.
  double first_surprise = 0, surprise = 0;
  double first_value_error = 0,
         value_error = 0;  ///< rms of value - return, rewards as PPO has them
  std::uint32_t minibatches = 0;
};

/// PPO on complete batches (docs/learner.md 4), with the switches of pb::Ppo. Owns parameters,
/// Adam, normaliser and schedule position; no random state (counters only). One thread calls it;
/// `threads` - 1 helpers are started once. Results do not depend on `threads`: chunks of 64
/// samples, fixed summation tree, elementwise Adam.
///
///   Ppo ppo(config, policy_shape(config), threads);
///   loop: complete_batch(behaviour, batch); ppo.update(batch, serve); publish(ppo.weights());
class Ppo {
 public:
  /// `shape` is that of the configuration. Aborts below 1 thread, and on a thread that does not
  /// round by the default (core/fp_mode.h).
  Ppo(const pb::Config& config, const PolicyShape& shape, int threads);
  ~Ppo();
  Ppo(const Ppo&) = delete;
  Ppo& operator=(const Ppo&) = delete;

  const PolicyShape& shape() const { return shape_; }
  std::uint64_t version() const { return updates_; }
  std::uint64_t steps_total() const { return steps_total_; }

  /// Parameters, frozen normaliser, version, weights_hash and layout_hash; the caller adds
  /// policy_id, learner_epoch, config_hash and published_at_ns.
  PolicyWeights weights() const;

  /// Learns from a batch of rollout.slots slots; aborts for one that complete_batch() has not seen.
  /// `between_minibatches` is called on the
  /// calling thread after every minibatch (serve_workers); it must not touch this object. May be
  /// empty.
  UpdateStats update(const Batch& batch, const std::function<void()>& between_minibatches = {});

  /// Counts the batch and learns nothing: the next weights() are the same under a new version
  /// (run.updates = false, benchmarks of collecting alone). The batch need not be completed.
  UpdateStats skip_update(const Batch& batch);

  /// Behaviour cloning (learner/cloning.cpp, docs/learner.md 9): fits the policy to the actions of
  /// demonstrations by maximum likelihood and the critic to their discounted returns by least
  /// squares, with the knobs of pb::Cloning. Normaliser and scale of the rewards begin with the
  /// demonstrations; Adam starts fresh afterwards. `demonstrations`: one slot, whole episodes one
  /// after the other, each ended by a flag; of what a batch has, observations, actions, rewards and
  /// flags. Precondition: no update yet.
  CloningStats clone(Batch demonstrations);

  /// The whole optimiser state. load() fails, changing nothing, when sizes or layout do not fit.
  void save(pb::PpoState& state) const;
  Result<void> load(const pb::PpoState& state);

  /// Takes parameters and frozen normaliser of another run (`--initialize-from`); optimiser and
  /// counters start fresh.
  Result<void> initialise_from(const pb::PpoState& state);

 private:
  struct Schedule {
    double learning_rate, clip, entropy;
  };
  /// How one minibatch is learnt from.
  struct Step {
    LossSettings loss;
    double learning_rate = 0;
    double largest_norm = 0;  ///< the gradient is cut to this norm; 0 = never
  };
  Schedule schedule() const;
  void prepare(const Batch& batch);
  void normalise_inputs(const Batch& batch);
  LossSettings loss_settings(const Schedule& now, std::size_t samples) const;
  MinibatchView view_of(const Batch& batch, std::span<const std::uint32_t> rows) const;
  LossSums minibatch_step(const MinibatchView& minibatch, const Step& step, double& norm);
  /// The critic learns alone in this update (cloning.critic_updates).
  bool critic_alone() const { return updates_ < cloning_.critic_updates(); }
  void compute_chunks(const MinibatchView& minibatch, const LossSettings& settings);
  void reduce_range(std::size_t first_block, std::size_t last_block, std::size_t chunks);
  void refresh_normaliser();

  pb::Ppo settings_;
  pb::Cloning cloning_;
  std::uint64_t run_seed_ = 0, max_steps_ = 0;
  PolicyShape shape_;
  TrainingLayout layout_;
  std::unique_ptr<ThreadPool> pool_;

  AlignedFloats parameters_;  // training layout
  Adam adam_;
  RunningMoments observation_moments_;
  RewardScaler reward_scaler_;
  FrozenNormaliser normaliser_;  // empty vectors = off
  std::uint64_t updates_ = 0, steps_total_ = 0;
  double adaptive_rate_ = 0;

  // Work of one update.
  PackedWeights packed_;
  std::vector<std::unique_ptr<ChunkGradient>> kernels_;  // per thread
  std::vector<AlignedFloats> chunk_gradients_;
  std::vector<LossSums> chunk_sums_;
  std::vector<double> block_squares_;
  std::vector<float> inputs_, rewards_, advantages_, returns_;
};

}  // namespace omentum
