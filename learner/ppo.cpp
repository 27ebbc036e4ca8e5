#include "learner/ppo.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "learner/advantage.h"
#include "learner/initialise.h"

namespace omentum {

namespace {

/// Parameters per unit of shared work; fixed, because squares are summed per block.
constexpr std::size_t kBlock = 1024;

double linear(double from, double to, double progress) { return from + (to - from) * progress; }

std::size_t blocks_of(std::size_t count) { return (count + kBlock - 1) / kBlock; }

/// Range [first, last) of `count` items for one of `threads`.
std::pair<std::size_t, std::size_t> part(std::size_t count, int thread, int threads) {
  const auto t = static_cast<std::size_t>(thread);
  const auto n = static_cast<std::size_t>(threads);
  return {count * t / n, count * (t + 1) / n};
}

double explained_variance(std::span<const float> values, std::span<const float> returns) {
  std::vector<float> errors(values.size());
  for (std::size_t i = 0; i < values.size(); ++i) errors[i] = returns[i] - values[i];
  const double target = mean_deviation(returns, {}, true).deviation;
  const double error = mean_deviation(errors, {}, true).deviation;
  return target > 0 ? 1 - error * error / (target * target) : 0;
}

template <typename T>
void assign(google::protobuf::RepeatedField<T>* to, std::span<const T> from) {
  to->Assign(from.begin(), from.end());
}

void save_moments(const RunningMoments& moments, pb::Moments& to) {
  to.set_count(moments.count());
  assign(to.mutable_mean(), std::span<const double>(moments.mean()));
  assign(to.mutable_squares(), std::span<const double>(moments.squares()));
}

RunningMoments load_moments(const pb::Moments& from, int dimensions) {
  RunningMoments moments(dimensions);
  moments.restore(from.count(), {from.mean().begin(), from.mean().end()},
                  {from.squares().begin(), from.squares().end()});
  return moments;
}

bool fits(const pb::Moments& moments, int dimensions) {
  return moments.mean_size() == dimensions && moments.squares_size() == dimensions &&
         moments.count() >= 0;
}

}  // namespace

Ppo::Ppo(const pb::Config& config, const PolicyShape& shape, int threads)
    : settings_(config.ppo()),
      cloning_(config.cloning()),
      run_seed_(config.rollout().run_seed()),
      max_steps_(config.rollout().max_steps()),
      shape_(shape),
      layout_(shape_),
      pool_(std::make_unique<ThreadPool>(threads)),
      parameters_(layout_.count()),
      adam_(settings_, layout_.count()),
      observation_moments_(shape.numbers()),
      reward_scaler_(static_cast<int>(config.rollout().slots()), settings_.gamma()),
      adaptive_rate_(settings_.learning_rate()),
      packed_(shape_, layout_) {
  layout_.spread(initial_parameters(shape_, settings_, run_seed_), parameters_);
  for (int thread = 0; thread < threads; ++thread)
    kernels_.push_back(std::make_unique<ChunkGradient>(shape_, layout_));
  block_squares_.resize(blocks_of(layout_.count()));
  refresh_normaliser();
}

Ppo::~Ppo() = default;

void Ppo::refresh_normaliser() {
  if (settings_.normalise_observations()) normaliser_ = freeze(observation_moments_);
}

PolicyWeights Ppo::weights() const {
  PolicyWeights weights;
  weights.policy_version = updates_;
  weights.layout_hash = shape_.layout_hash();
  weights.parameters.resize(shape_.parameter_count());
  layout_.collect(parameters_, weights.parameters);
  weights.obs_mean = normaliser_.mean;
  weights.obs_inv_std = normaliser_.inverse_deviation;
  weights.weights_hash = hash_weights(weights.parameters, weights.obs_mean, weights.obs_inv_std);
  return weights;
}

Ppo::Schedule Ppo::schedule() const {
  const double progress =
      std::min(1.0, static_cast<double>(steps_total_) / static_cast<double>(max_steps_));
  Schedule now{settings_.learning_rate(), linear(settings_.clip(), settings_.clip_end(), progress),
               linear(settings_.entropy(), settings_.entropy_end(), progress)};
  if (settings_.learning_rate_schedule() == pb::SCHEDULE_LINEAR) {
    now.learning_rate = linear(settings_.learning_rate(), settings_.learning_rate_end(), progress);
  } else if (settings_.learning_rate_schedule() == pb::SCHEDULE_KL_ADAPTIVE) {
    now.learning_rate = adaptive_rate_;
  }
  return now;
}

void Ppo::normalise_inputs(const Batch& batch) {
  const std::size_t rows = batch.rows();
  const auto width = static_cast<std::size_t>(shape_.observations);
  inputs_ = batch.observations;
  if (!settings_.normalise_observations()) return;
  observation_moments_.merge(batch.observations, width);
  refresh_normaliser();
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t i = 0; i < normaliser_.mean.size(); ++i) {  // the numbers, not the pixels
      float& input = inputs_[row * width + i];
      const float x = (input - normaliser_.mean[i]) * normaliser_.inverse_deviation[i];
      input = std::clamp(x, -kObservationClip, kObservationClip);
    }
  }
}

void Ppo::prepare(const Batch& batch) {
  const std::size_t rows = batch.rows();
  normalise_inputs(batch);
  rewards_ = batch.rewards;
  if (settings_.scale_rewards()) reward_scaler_.scale(batch, rewards_);
  advantages_.resize(rows);
  returns_.resize(rows);
  estimate_advantages(batch, rewards_,
                      {settings_.gamma(), settings_.lambda(), settings_.time_horizon(),
                       settings_.bootstrap_truncation()},
                      advantages_, returns_);
  if (settings_.advantage_norm() == pb::ADVANTAGE_BATCH) {
    const MeanDeviation moments = mean_deviation(advantages_, {}, true);
    for (float& advantage : advantages_) {
      advantage = static_cast<float>((static_cast<double>(advantage) - moments.mean) /
                                     (moments.deviation + 1e-10));
    }
  }
}

LossSettings Ppo::loss_settings(const Schedule& now, std::size_t samples) const {
  LossSettings loss;
  loss.ratio = settings_.ratio();
  loss.ratio_high = static_cast<float>(1 + now.clip);
  loss.ratio_low =
      static_cast<float>(settings_.clip_reciprocal() ? 1 / (1 + now.clip) : 1 - now.clip);
  loss.value_clip = settings_.value_clip();
  loss.value_range = static_cast<float>(
      settings_.value_clip_range() > 0 ? settings_.value_clip_range() : now.clip);
  loss.value_coefficient = static_cast<float>(settings_.value_coefficient());
  loss.entropy = static_cast<float>(now.entropy);
  loss.per_sample = static_cast<float>(1.0 / static_cast<double>(samples));
  if (critic_alone()) loss.policy_coefficient = loss.entropy = 0;
  return loss;
}

MinibatchView Ppo::view_of(const Batch& batch, std::span<const std::uint32_t> rows) const {
  MinibatchView view{&batch, inputs_, advantages_, 0, 1, returns_, rows};
  if (settings_.advantage_norm() == pb::ADVANTAGE_MINIBATCH) {
    const MeanDeviation moments = mean_deviation(advantages_, rows, false);
    view.advantage_mean = moments.mean;
    view.advantage_scale = 1 / (moments.deviation + 1e-8);
  }
  return view;
}

void Ppo::compute_chunks(const MinibatchView& minibatch, const LossSettings& settings) {
  const std::size_t samples = minibatch.rows.size();
  const std::size_t chunks = (samples + kChunk - 1) / kChunk;
  const auto threads = static_cast<std::size_t>(pool_->size());
  pool_->run([&](int thread) {
    const auto t = static_cast<std::size_t>(thread);
    for (std::size_t c = t; c < chunks; c += threads) {
      const std::size_t first = c * kChunk;
      const auto count = static_cast<int>(std::min<std::size_t>(kChunk, samples - first));
      chunk_sums_[c] = (*kernels_[t])(packed_, settings, minibatch, static_cast<int>(first), count,
                                      chunk_gradients_[c]);
    }
  });
}

// Pairwise tree over the chunk index, block of parameters by block: chunk 0 ends with the sum. Any
// assignment of blocks to threads has the same result.
void Ppo::reduce_range(std::size_t first_block, std::size_t last_block, std::size_t chunks) {
  for (std::size_t block = first_block; block < last_block; ++block) {
    const std::size_t from = block * kBlock;
    const std::size_t to = std::min(from + kBlock, layout_.count());
    for (std::size_t stride = 1; stride < chunks; stride *= 2) {
      for (std::size_t c = 0; c + stride < chunks; c += 2 * stride) {
        float* sum = chunk_gradients_[c].data();
        const float* other = chunk_gradients_[c + stride].data();
        for (std::size_t i = from; i < to; ++i) sum[i] += other[i];
      }
    }
    // Eight interleaved sums in double, then in order.
    const float* gradient = chunk_gradients_[0].data();
    double sums[8] = {};
    for (std::size_t i = from; i < to; i += 8) {
      for (std::size_t j = 0; j < 8; ++j) {
        const auto g = static_cast<double>(gradient[i + j]);
        sums[j] += g * g;
      }
    }
    double total = 0;
    for (const double sum : sums) total += sum;
    block_squares_[block] = total;
  }
}

LossSums Ppo::minibatch_step(const MinibatchView& minibatch, const Step& step, double& norm) {
  const std::size_t chunks = (minibatch.rows.size() + kChunk - 1) / kChunk;
  while (chunk_gradients_.size() < chunks) chunk_gradients_.emplace_back(layout_.count(), 0.0F);
  chunk_sums_.resize(std::max(chunk_sums_.size(), chunks));

  packed_.pack(parameters_);
  compute_chunks(minibatch, step.loss);

  const std::size_t blocks = block_squares_.size();
  const int threads = pool_->size();
  pool_->run([&](int thread) {
    const auto [first, last] = part(blocks, thread, threads);
    reduce_range(first, last, chunks);
  });
  double squares = 0;
  for (const double block : block_squares_) squares += block;
  norm = std::sqrt(squares);
  const double limit = step.largest_norm;
  const auto scale = static_cast<float>(limit > 0 && norm > limit ? limit / (norm + 1e-6) : 1.0);

  adam_.begin_step(step.learning_rate);
  pool_->run([&](int thread) {
    const auto [first, last] = part(blocks, thread, threads);
    adam_.apply(first * kBlock, std::min(last * kBlock, layout_.count()), scale,
                chunk_gradients_[0], parameters_);
  });

  LossSums sums;
  for (std::size_t c = 0; c < chunks; ++c) sums.add(chunk_sums_[c]);
  return sums;
}

UpdateStats Ppo::update(const Batch& batch, const std::function<void()>& between_minibatches) {
  OMENTUM_CHECK(batch.observation_size == shape_.observations &&
                    batch.branch_log_probs.size() == batch.rows() * shape_.columns(),
                "batch is not completed");
  const Schedule now = schedule();
  // The actor joins: its moments are zero but Adam's count is not, which would make its first steps
  // three times too long.
  if (updates_ > 0 && updates_ == cloning_.critic_updates())
    adam_ = Adam(settings_, layout_.count());
  prepare(batch);
  const auto rows = static_cast<std::uint32_t>(batch.rows());
  const std::uint32_t size = std::min(settings_.minibatch(), rows);

  UpdateStats stats;
  LossSums all;
  double norm_sum = 0;
  for (std::uint32_t epoch = 0; epoch < settings_.epochs() && !stats.stopped_by_kl; ++epoch) {
    const std::vector<std::uint32_t> order = shuffled_rows(run_seed_, updates_, epoch, rows);
    LossSums epoch_sums;
    for (std::uint32_t first = 0; first < rows; first += size) {
      const std::uint32_t count = std::min(size, rows - first);
      if (count < size && settings_.drop_remainder()) break;
      double norm = 0;
      const LossSums sums = minibatch_step(
          view_of(batch, std::span(order).subspan(first, count)),
          {loss_settings(now, count), now.learning_rate, settings_.max_gradient_norm()}, norm);
      epoch_sums.add(sums);
      stats.approx_kl_max = std::max(stats.approx_kl_max, sums.kl / sums.samples);
      norm_sum += norm;
      ++stats.minibatches;
      if (between_minibatches) between_minibatches();
    }
    all.add(epoch_sums);
    ++stats.epochs;
    stats.stopped_by_kl =
        settings_.target_kl() > 0 && epoch_sums.kl / epoch_sums.samples > settings_.target_kl();
  }
  ++updates_;
  steps_total_ += rows;

  const double n = all.samples;
  stats.version = updates_;
  stats.learning_rate = now.learning_rate;
  stats.clip = now.clip;
  stats.entropy_coefficient = now.entropy;
  stats.policy_loss = all.policy_loss / n;
  stats.value_loss = all.value_loss / n;
  for (std::size_t b = 0; b < kActionBranches; ++b) {
    stats.branch_entropy[b] = all.entropy[b] / n;
    stats.branch_kl[b] = all.branch_kl[b] / n;
    stats.entropy += stats.branch_entropy[b];
  }
  stats.approx_kl = all.kl / n;
  stats.old_approx_kl = all.old_kl / n;
  stats.clip_fraction = all.clipped / n;
  stats.explained_variance = explained_variance(batch.values, returns_);
  stats.gradient_norm = norm_sum / stats.minibatches;
  stats.ratio_mean = all.ratio / n;
  stats.ratio_min = all.ratio_min;
  stats.ratio_max = all.ratio_max;
  stats.adam_max_second_moment = static_cast<double>(adam_.largest_second_moment());
  stats.value_delta = all.value_delta / n;
  if (settings_.learning_rate_schedule() == pb::SCHEDULE_KL_ADAPTIVE) {
    constexpr double kStep = 1.5, kSmallest = 1e-6, kLargest = 1e-2;
    if (stats.approx_kl > 2 * settings_.kl_adaptive_target())
      adaptive_rate_ = std::max(kSmallest, adaptive_rate_ / kStep);
    if (stats.approx_kl < settings_.kl_adaptive_target() / 2)
      adaptive_rate_ = std::min(kLargest, adaptive_rate_ * kStep);
  }
  return stats;
}

UpdateStats Ppo::skip_update(const Batch& batch) {
  ++updates_;
  steps_total_ += batch.rows();
  UpdateStats stats;
  stats.version = updates_;
  return stats;
}

void Ppo::save(pb::PpoState& state) const {
  state.Clear();
  state.set_updates(updates_);
  state.set_steps_total(steps_total_);
  state.set_learning_rate(adaptive_rate_);
  const PolicyWeights now = weights();
  pb::Weights& weights = *state.mutable_weights();
  weights.set_policy_version(now.policy_version);
  weights.set_layout_hash(now.layout_hash);
  weights.set_weights_hash(now.weights_hash.data(), now.weights_hash.size());
  assign(weights.mutable_parameters(), std::span<const float>(now.parameters));
  assign(weights.mutable_obs_mean(), std::span<const float>(now.obs_mean));
  assign(weights.mutable_obs_inv_std(), std::span<const float>(now.obs_inv_std));
  pb::AdamState& adam = *state.mutable_adam();
  adam.set_steps(adam_.steps());
  adam.set_beta1_power(adam_.beta1_power());
  adam.set_beta2_power(adam_.beta2_power());
  std::vector<float> moment(shape_.parameter_count());
  layout_.collect(adam_.first(), moment);
  assign(adam.mutable_first(), std::span<const float>(moment));
  layout_.collect(adam_.second(), moment);
  assign(adam.mutable_second(), std::span<const float>(moment));
  save_moments(observation_moments_, *state.mutable_observation_moments());
  save_moments(reward_scaler_.moments(), *state.mutable_reward_moments());
  assign(state.mutable_discounted_rewards(), std::span<const double>(reward_scaler_.discounted()));
}

Result<void> Ppo::initialise_from(const pb::PpoState& state) {
  const pb::Weights& weights = state.weights();
  if (weights.layout_hash() != shape_.layout_hash() ||
      static_cast<std::size_t>(weights.parameters_size()) != shape_.parameter_count()) {
    return Failure{fmt::format(
        "weights of another network: layout {:016x} with {} parameters, here {:016x} with {}",
        weights.layout_hash(), weights.parameters_size(), shape_.layout_hash(),
        shape_.parameter_count())};
  }
  const auto width = static_cast<int>(normaliser_.mean.size());
  if (weights.obs_mean_size() != weights.obs_inv_std_size() ||
      (weights.obs_mean_size() != width && weights.obs_mean_size() != 0)) {
    return Failure{
        fmt::format("normaliser of {} observations, here {}", weights.obs_mean_size(), width)};
  }
  const std::vector<float> parameters(weights.parameters().begin(), weights.parameters().end());
  layout_.spread(parameters, parameters_);
  if (settings_.normalise_observations() && fits(state.observation_moments(), shape_.numbers())) {
    observation_moments_ = load_moments(state.observation_moments(), shape_.numbers());
    refresh_normaliser();
  }
  return {};
}

Result<void> Ppo::load(const pb::PpoState& state) {
  const std::size_t count = shape_.parameter_count();
  const pb::AdamState& adam = state.adam();
  if (static_cast<std::size_t>(adam.first_size()) != count ||
      static_cast<std::size_t>(adam.second_size()) != count) {
    return Failure{fmt::format("Adam moments of {} and {} parameters instead of {}",
                               adam.first_size(), adam.second_size(), count)};
  }
  if (!fits(state.observation_moments(), shape_.numbers()) || !fits(state.reward_moments(), 1) ||
      static_cast<std::size_t>(state.discounted_rewards_size()) !=
          reward_scaler_.discounted().size()) {
    return Failure{"normaliser or reward moments of another size"};
  }
  if (Result<void> result = initialise_from(state); !result) return result;
  AlignedFloats first(layout_.count()), second(layout_.count());
  layout_.spread(std::vector<float>(adam.first().begin(), adam.first().end()), first);
  layout_.spread(std::vector<float>(adam.second().begin(), adam.second().end()), second);
  adam_.restore(adam.steps(), adam.beta1_power(), adam.beta2_power(), std::move(first),
                std::move(second));
  reward_scaler_.restore(load_moments(state.reward_moments(), 1),
                         {state.discounted_rewards().begin(), state.discounted_rewards().end()});
  updates_ = state.updates();
  steps_total_ = state.steps_total();
  adaptive_rate_ = state.learning_rate();
  return {};
}

}  // namespace omentum
