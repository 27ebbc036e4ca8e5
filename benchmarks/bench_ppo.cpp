// Speed of learning and of the behaviour policy on one core: thread CPU time, best of several
// repetitions.
//   ppo.us_per_sample_epoch   one minibatch step (forward, four-branch loss, backward, Adam,
//   gradient norm, shuffle,
//                             GAE and normaliser included) per sample, 14 observations, 2 x 128,
//                             minibatch 256
//   policy.us_per_row         act(): actor, critic, sampling, log-probability, per row at 16 rows
//   machine.fma_peak_gflops   measured: independent fused multiply-adds, eight lanes (AVX2). Where
//   the CPU has AVX-512 the
//                             products run sixteen lanes wide with the same bits and may pass this
//                             figure.
// Peer: benchmarks/torch_ppo.py with the same shapes and loss.

#include <fmt/core.h>
#include <immintrin.h>

#include <algorithm>
#include <functional>
#include <string>

#include "core/clock.h"
#include "core/gemm.h"
#include "core/policy.h"
#include "learner/ppo.h"

namespace omentum {
namespace {

double seconds(clockid_t clock) { return 1e-9 * static_cast<double>(clock_ns(clock)); }

/// Smallest time of `repetitions` calls [s].
double best_time(int repetitions, clockid_t clock, const std::function<void()>& work) {
  double best = 1e30;
  for (int i = 0; i < repetitions; ++i) {
    const double start = seconds(clock);
    work();
    best = std::min(best, seconds(clock) - start);
  }
  return best;
}

float noise(std::uint32_t i, std::uint32_t stream) {
  return 2 * uniform_24(philox({i, stream, 0, 0}, {7, 7})[0]) - 1;
}

Batch make_batch(Policy& policy, int slots, int steps) {
  const int width = policy.shape().observations;
  std::vector<RolloutSegment> segments(static_cast<std::size_t>(slots));
  std::uint32_t n = 0;
  for (std::size_t slot = 0; slot < segments.size(); ++slot) {
    RolloutSegment& s = segments[slot];
    s.slot = static_cast<std::uint32_t>(slot);
    s.steps = static_cast<std::uint32_t>(steps);
    s.end_episode_step = s.steps;
    for (int i = 0; i < steps * width; ++i) s.observations.push_back(noise(n++, 1));
    s.bootstrap_observation.assign(static_cast<std::size_t>(width), 0.5F);
    std::vector<ActionCounter> counters(s.steps);
    for (std::uint32_t i = 0; i < s.steps; ++i) counters[i] = {1, s.slot, 0, i, Purpose::kAction};
    std::vector<Decision> decisions(s.steps);
    policy.act(s.observations, counters, false, decisions);
    for (const Decision& d : decisions) {
      s.actions.insert(s.actions.end(), d.branch.begin(), d.branch.begin() + 4);
      s.log_probs.push_back(d.log_prob);
      s.values.push_back(d.value);
      s.rewards.push_back(noise(n++, 2));
      s.flags.push_back(0);
    }
  }
  Batch batch = assemble(segments, policy.shape());
  complete_batch(policy, batch);
  return batch;
}

/// Twelve chains in named registers: enough to hide a latency of four cycles at two per cycle, with
/// room to spare.
double fma_peak_gflops() {
  constexpr int kTurns = 4'000'000;
  __m256 s0 = _mm256_set1_ps(0.5F), s1 = s0, s2 = s0, s3 = s0, s4 = s0, s5 = s0;
  __m256 s6 = s0, s7 = s0, s8 = s0, s9 = s0, s10 = s0, s11 = s0;
  const __m256 a = _mm256_set1_ps(0.999F), b = _mm256_set1_ps(0.001F);
  const double time = best_time(5, CLOCK_THREAD_CPUTIME_ID, [&] {
    __m256 t0 = s0, t1 = s1, t2 = s2, t3 = s3, t4 = s4, t5 = s5, t6 = s6, t7 = s7, t8 = s8, t9 = s9,
           t10 = s10, t11 = s11;
    for (int turn = 0; turn < kTurns; ++turn) {
      t0 = _mm256_fmadd_ps(t0, a, b), t1 = _mm256_fmadd_ps(t1, a, b),
      t2 = _mm256_fmadd_ps(t2, a, b);
      t3 = _mm256_fmadd_ps(t3, a, b), t4 = _mm256_fmadd_ps(t4, a, b),
      t5 = _mm256_fmadd_ps(t5, a, b);
      t6 = _mm256_fmadd_ps(t6, a, b), t7 = _mm256_fmadd_ps(t7, a, b),
      t8 = _mm256_fmadd_ps(t8, a, b);
      t9 = _mm256_fmadd_ps(t9, a, b), t10 = _mm256_fmadd_ps(t10, a, b),
      t11 = _mm256_fmadd_ps(t11, a, b);
    }
    s0 = t0, s1 = t1, s2 = t2, s3 = t3, s4 = t4, s5 = t5, s6 = t6, s7 = t7, s8 = t8, s9 = t9,
    s10 = t10, s11 = t11;
    asm volatile("" ::"x"(s0), "x"(s1), "x"(s2), "x"(s3), "x"(s4), "x"(s5), "x"(s6), "x"(s7),
                 "x"(s8), "x"(s9), "x"(s10), "x"(s11));
  });
  return 2.0 * 8 * 12 * kTurns / time * 1e-9;
}

pb::Config config_of(std::uint32_t minibatch, int slots) {
  pb::Config config;
  config.mutable_ppo()->set_minibatch(minibatch);
  config.mutable_ppo()->set_epochs(3);
  config.mutable_rollout()->set_slots(static_cast<std::uint32_t>(slots));
  return config;
}

/// Multiply-adds of one sample, forward and backward, without the gradient of the inputs; times
/// two.
double flop_per_sample(const PolicyShape& shape) {
  const double h = shape.hidden, o = shape.observations;
  const auto network = [&](double outputs) {
    return 2 * (2 * o * h + 3 * h * h + 3 * h * outputs);
  };
  return network(shape.logits()) + network(1);
}

/// The same with a picture of 32 px object ids and its convolutions.
void measure_picture() {
  constexpr int kSlots = 16, kSteps = 64;
  pb::Config config = config_of(256, kSlots);
  config.mutable_task()->set_observation(pb::OBSERVATION_IMAGE);
  const PolicyShape shape = policy_shape(config);
  Ppo ppo(config, shape, 1);
  Policy policy(shape, ppo.weights());
  Batch batch = make_batch(policy, kSlots, kSteps);
  const auto rows = static_cast<double>(batch.rows());
  const double update = best_time(5, CLOCK_THREAD_CPUTIME_ID, [&] { ppo.update(batch); });
  fmt::print("ppo.us_per_sample_epoch.picture_32 {:.1f} us\n", update * 1e6 / (3 * rows));
  const double check =
      best_time(5, CLOCK_THREAD_CPUTIME_ID, [&] { complete_batch(policy, batch); });
  fmt::print("policy.check_us_per_step.picture_32 {:.1f} us\n", check * 1e6 / rows);
}

int run() {
  constexpr int kSlots = 32, kSteps = 320;
  const double peak = fma_peak_gflops();
  fmt::print("machine.fma_peak_gflops {:.1f} GFLOP/s   # products use {}\n", peak,
             gemm_has_avx512() ? "AVX-512" : "AVX2");
  for (const std::uint32_t minibatch : {64u, 256u, 1024u}) {
    for (const int threads : {1, 2}) {
      const pb::Config config = config_of(minibatch, kSlots);
      const PolicyShape shape = policy_shape(config);
      Ppo ppo(config, shape, threads);
      Policy policy(shape, ppo.weights());
      const Batch batch = make_batch(policy, kSlots, kSteps);
      const clockid_t clock = threads == 1 ? CLOCK_THREAD_CPUTIME_ID : CLOCK_MONOTONIC;
      const double time = best_time(8, clock, [&] { ppo.update(batch); });
      const double us = time * 1e6 / (3.0 * kSlots * kSteps);
      const std::string suffix = (minibatch == 256 ? "" : fmt::format(".minibatch_{}", minibatch)) +
                                 (threads == 1 ? "" : fmt::format(".threads_{}", threads));
      const double gflops = flop_per_sample(shape) / us * 1e-3;
      fmt::print(
          "ppo.us_per_sample_epoch{} {:.3f} us   # {:.0f} GFLOP/s, {:.0f} % of the AVX2 peak of "
          "one "
          "core\n",
          suffix, us, gflops, 100 * gflops / peak);
    }
  }
  const pb::Config config = config_of(256, kSlots);
  const PolicyShape shape = policy_shape(config);
  Ppo ppo(config, shape, 1);
  Policy policy(shape, ppo.weights());
  const Batch batch = make_batch(policy, kSlots, kSteps);
  for (const std::size_t rows : {1u, 2u, 8u, 16u, 64u}) {
    std::vector<Decision> decisions(rows);
    std::vector<ActionCounter> counters(rows);
    const std::span<const float> observations =
        std::span(batch.observations).first(rows * static_cast<std::size_t>(shape.observations));
    constexpr int kCalls = 2000;
    const double time = best_time(10, CLOCK_THREAD_CPUTIME_ID, [&] {
      for (int i = 0; i < kCalls; ++i) policy.act(observations, counters, false, decisions);
    });
    fmt::print("policy.us_per_row{} {:.3f} us\n", rows == 16 ? "" : fmt::format(".rows_{}", rows),
               time * 1e6 / kCalls / static_cast<double>(rows));
    if (rows != 8 && rows != 16) continue;
    std::vector<float> values(rows);
    const double critic = best_time(10, CLOCK_THREAD_CPUTIME_ID, [&] {
      for (int i = 0; i < kCalls; ++i) policy.estimate(observations, values);
    });
    fmt::print("policy.actor_us_per_row.rows_{} {:.3f} us   # act() without the critic\n", rows,
               (time - critic) * 1e6 / kCalls / static_cast<double>(rows));
  }
  Batch checked = batch;
  const double check =
      best_time(5, CLOCK_THREAD_CPUTIME_ID, [&] { complete_batch(policy, checked); });
  fmt::print("policy.check_us_per_step {:.3f} us\n",
             check * 1e6 / static_cast<double>(batch.rows()));
  measure_picture();
  return 0;
}

}  // namespace
}  // namespace omentum

int main() { return omentum::run(); }
