#include "learner/loss.h"

#include <algorithm>

#include "core/activation.h"
#include "core/gemm.h"

namespace omentum {

using lanes::Lane;

namespace {

constexpr int kWidth = lanes::kWidth;
constexpr float kHalfLog2Pi = 0.918938533F;
constexpr float kHalfLog2PiE = 1.418938533F;

Lane load(const float* p) { return _mm256_load_ps(p); }

/// Eight samples in work: lanes are samples.
struct Group {
  alignas(32) float logits[kMaxLogits][kWidth];
  alignas(32) float gradient[kMaxLogits][kWidth];  // d loss / d logits
  Lane log_prob[kActionBranches];                  // of the action taken, per branch
  Lane entropy[kActionBranches];
  Lane weight[kActionBranches];  // d loss / d log_prob
  // discrete: probabilities and log-probabilities of all actions
  Lane p[kMaxLogits];
  Lane log_p[kMaxLogits];
  // Gaussian: standardised action
  Lane z[kContinuousDimensions];
};

struct Surrogate {
  Lane loss;    // -min(r A, clip(r) A)
  Lane weight;  // d loss / d log ratio
  Lane ratio;
  Lane clipped;  // mask
};

/// The clipped surrogate of one ratio. The gradient flows through r A where it is the smaller or
/// equal one.
Surrogate surrogate(Lane log_ratio, Lane advantage, const LossSettings& s) {
  Surrogate out;
  out.ratio = lanes::exp(log_ratio);
  const Lane bounded = lanes::larger(lanes::splat(s.ratio_low),
                                     lanes::smaller(lanes::splat(s.ratio_high), out.ratio));
  const Lane plain = _mm256_mul_ps(out.ratio, advantage);
  const Lane limited = _mm256_mul_ps(bounded, advantage);
  const Lane flows = _mm256_cmp_ps(plain, limited, _CMP_LE_OQ);
  const Lane zero = _mm256_setzero_ps();
  out.loss = _mm256_sub_ps(zero, lanes::select(flows, plain, limited));
  out.weight = lanes::select(flows, _mm256_sub_ps(zero, plain), zero);
  out.clipped = _mm256_cmp_ps(bounded, out.ratio, _CMP_NEQ_UQ);
  return out;
}

/// Maximum likelihood in the place of the surrogate: -log pi(action), which nothing clips.
Surrogate likelihood(Lane log_prob, Lane ratio) {
  const Lane zero = _mm256_setzero_ps();
  return {_mm256_sub_ps(zero, log_prob), lanes::splat(-1.0F), ratio, zero};
}

/// k3 estimator of the KL divergence: (r - 1) - log r, never negative.
Lane k3(Lane ratio, Lane log_ratio) {
  return _mm256_sub_ps(_mm256_sub_ps(ratio, lanes::splat(1.0F)), log_ratio);
}

void softmax_branch(Group& g, int branch, int base, int size, const std::int32_t* taken) {
  Lane best = load(g.logits[base]);
  for (int j = 1; j < size; ++j) best = lanes::larger(best, load(g.logits[base + j]));
  Lane e[kMaxLogits];
  Lane total = _mm256_setzero_ps();
  for (int j = 0; j < size; ++j) {
    e[j] = lanes::exp(_mm256_sub_ps(load(g.logits[base + j]), best));
    total = _mm256_add_ps(total, e[j]);
  }
  const Lane log_total = lanes::log(total);
  const Lane scale = _mm256_div_ps(lanes::splat(1.0F), total);
  const __m256i action = _mm256_load_si256(reinterpret_cast<const __m256i*>(taken));
  Lane entropy = _mm256_setzero_ps();
  Lane log_prob = _mm256_setzero_ps();
  for (int j = 0; j < size; ++j) {
    const Lane log_p = _mm256_sub_ps(_mm256_sub_ps(load(g.logits[base + j]), best), log_total);
    const Lane p = _mm256_mul_ps(e[j], scale);
    entropy = _mm256_fnmadd_ps(p, log_p, entropy);
    const __m256i here = _mm256_cmpeq_epi32(action, _mm256_set1_epi32(j));
    log_prob = lanes::select(_mm256_castsi256_ps(here), log_p, log_prob);
    g.log_p[base + j] = log_p;
    g.p[base + j] = p;
  }
  g.entropy[branch] = entropy;
  g.log_prob[branch] = log_prob;
}

// d log p_a / d l_j = [a = j] - p_j;  d H / d l_j = -p_j (log p_j + H).
void softmax_gradient(Group& g, int branch, int base, int size, const std::int32_t* taken,
                      Lane entropy_weight) {
  const __m256i action = _mm256_load_si256(reinterpret_cast<const __m256i*>(taken));
  for (int j = 0; j < size; ++j) {
    const Lane p = g.p[base + j];
    const Lane here = _mm256_castsi256_ps(_mm256_cmpeq_epi32(action, _mm256_set1_epi32(j)));
    const Lane one = _mm256_and_ps(here, lanes::splat(1.0F));
    const Lane surprise = _mm256_mul_ps(p, _mm256_add_ps(g.log_p[base + j], g.entropy[branch]));
    const Lane policy = _mm256_mul_ps(g.weight[branch], _mm256_sub_ps(one, p));
    _mm256_store_ps(g.gradient[base + j], lanes::fma(entropy_weight, surprise, policy));
  }
}

void gaussian_branch(Group& g, int d, const GaussianHead& head, const float* taken) {
  const auto i = static_cast<std::size_t>(d);
  g.z[d] = _mm256_mul_ps(_mm256_sub_ps(load(taken), load(g.logits[d])),
                         lanes::splat(head.inverse_std[i]));
  g.log_prob[d] = lanes::fma(_mm256_mul_ps(g.z[d], g.z[d]), lanes::splat(-0.5F),
                             lanes::splat(-head.log_std[i] - kHalfLog2Pi));
  g.entropy[d] = lanes::splat(head.log_std[i] + kHalfLog2PiE);
}

/// Adds lane by lane, so that only real samples count and the order is the samples'.
void add_lanes(double& sum, Lane values, int count) {
  alignas(32) float v[kWidth];
  _mm256_store_ps(v, values);
  for (int lane = 0; lane < count; ++lane) sum += static_cast<double>(v[lane]);
}

struct ValueTerm {
  Lane loss, gradient;  // before value_coefficient / samples
};

ValueTerm value_term(Lane value, Lane old_value, Lane target, const LossSettings& s) {
  const Lane error = _mm256_sub_ps(value, target);
  ValueTerm term{_mm256_mul_ps(error, error), _mm256_add_ps(error, error)};
  if (!s.value_clip) return term;
  const Lane step = _mm256_sub_ps(value, old_value);
  const Lane bounded = lanes::larger(lanes::splat(-s.value_range),
                                     lanes::smaller(lanes::splat(s.value_range), step));
  const Lane clipped_error = _mm256_sub_ps(_mm256_add_ps(old_value, bounded), target);
  const Lane clipped_loss = _mm256_mul_ps(clipped_error, clipped_error);
  // Inside the range both are the same number and the gradient flows; outside, the clipped one is
  // constant.
  const Lane constant = _mm256_and_ps(_mm256_cmp_ps(bounded, step, _CMP_NEQ_UQ),
                                      lanes::less(term.loss, clipped_loss));
  term.gradient = _mm256_andnot_ps(constant, term.gradient);
  term.loss = lanes::larger(clipped_loss, term.loss);
  return term;
}

}  // namespace

void LossSums::add(const LossSums& other) {
  samples += other.samples;
  policy_loss += other.policy_loss;
  value_loss += other.value_loss;
  for (std::size_t b = 0; b < kActionBranches; ++b) {
    entropy[b] += other.entropy[b];
    branch_kl[b] += other.branch_kl[b];
  }
  kl += other.kl;
  old_kl += other.old_kl;
  clipped += other.clipped;
  ratio += other.ratio;
  ratio_min = std::min(ratio_min, other.ratio_min);
  ratio_max = std::max(ratio_max, other.ratio_max);
  value_delta += other.value_delta;
}

LossSums Loss::operator()(const LossSettings& settings, const GaussianHead& gaussian,
                          const LossInputs& inputs, int count, const float* logits,
                          const float* values, float* logit_gradient, float* value_gradient,
                          float* log_std_gradient) const {
  const int branches = shape_.branch_count();
  const int width = shape_.logits();
  const int columns = padded_columns(width);
  const Lane zero = _mm256_setzero_ps();
  const Lane entropy_weight = lanes::splat(settings.entropy * settings.per_sample);
  LossSums sums;
  sums.samples = count;
  for (int first = 0; first < count; first += kWidth) {
    const int real = std::min(kWidth, count - first);
    Group g;
    alignas(32) float value[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) {
      const int row =
          first + (lane < real ? lane : 0);  // missing samples repeat the first and are not counted
      for (int j = 0; j < width; ++j) g.logits[j][lane] = logits[row * columns + j];
      value[lane] = values[row * 8];
    }

    Lane joint = zero;
    int base = 0;
    for (int b = 0; b < branches; ++b) {
      if (shape_.continuous) {
        gaussian_branch(g, b, gaussian, inputs.continuous[b] + first);
      } else {
        const int size = shape_.branches[static_cast<std::size_t>(b)];
        softmax_branch(g, b, base, size, inputs.branch[b] + first);
        base += size;
      }
      joint = _mm256_add_ps(joint, g.log_prob[b]);
    }

    const Lane advantage = load(inputs.advantage + first);
    const Lane log_ratio = _mm256_sub_ps(joint, load(inputs.old_log_prob + first));
    Surrogate whole = surrogate(log_ratio, advantage, settings);
    if (settings.likelihood) whole = likelihood(joint, whole.ratio);
    const bool per_branch = settings.ratio == pb::RATIO_PER_BRANCH && !settings.likelihood;
    Lane policy_loss = whole.loss;
    Lane clipped = _mm256_and_ps(whole.clipped, lanes::splat(1.0F));
    const float weight = settings.per_sample * settings.policy_coefficient;
    const float share = weight / static_cast<float>(branches);
    if (per_branch) policy_loss = clipped = zero;
    for (int b = 0; b < branches; ++b) {
      const Lane d = _mm256_sub_ps(g.log_prob[b], load(inputs.old_branch_log_prob[b] + first));
      const Surrogate part = surrogate(d, advantage, settings);
      const auto i = static_cast<std::size_t>(b);
      add_lanes(sums.branch_kl[i], k3(part.ratio, d), real);
      add_lanes(sums.entropy[i], g.entropy[b], real);
      if (!per_branch) {
        g.weight[b] = _mm256_mul_ps(whole.weight, lanes::splat(weight));
      } else {
        g.weight[b] = _mm256_mul_ps(part.weight, lanes::splat(share));
        const Lane fraction = lanes::splat(1.0F / static_cast<float>(branches));
        policy_loss = lanes::fma(part.loss, fraction, policy_loss);
        clipped = _mm256_add_ps(clipped, _mm256_and_ps(part.clipped, fraction));
      }
    }

    base = 0;
    for (int b = 0; b < branches; ++b) {
      if (shape_.continuous) {
        const auto i = static_cast<std::size_t>(b);
        const Lane slope = _mm256_mul_ps(g.z[b], lanes::splat(gaussian.inverse_std[i]));
        _mm256_store_ps(g.gradient[b], _mm256_mul_ps(g.weight[b], slope));
        // d log p / d log_std = z^2 - 1;  d H / d log_std = 1.
        alignas(32) float spread[kWidth];
        _mm256_store_ps(
            spread, _mm256_sub_ps(_mm256_mul_ps(g.weight[b], _mm256_fmsub_ps(g.z[b], g.z[b],
                                                                             lanes::splat(1.0F))),
                                  entropy_weight));
        for (int lane = 0; lane < real; ++lane) log_std_gradient[b] += spread[lane];
      } else {
        const int size = shape_.branches[static_cast<std::size_t>(b)];
        softmax_gradient(g, b, base, size, inputs.branch[b] + first, entropy_weight);
        base += size;
      }
    }

    const Lane new_value = load(value);
    const ValueTerm term = value_term(new_value, load(inputs.old_value + first),
                                      load(inputs.target + first), settings);
    alignas(32) float value_slope[kWidth];
    _mm256_store_ps(value_slope,
                    _mm256_mul_ps(term.gradient,
                                  lanes::splat(settings.value_coefficient * settings.per_sample)));

    for (int lane = 0; lane < real; ++lane) {
      float* to = logit_gradient + (first + lane) * columns;
      for (int j = 0; j < width; ++j) to[j] = g.gradient[j][lane];
      for (int j = width; j < columns; ++j) to[j] = 0;
      float* value_to = value_gradient + (first + lane) * 8;
      std::fill_n(value_to, 8, 0.0F);
      value_to[0] = value_slope[lane];
    }

    add_lanes(sums.policy_loss, policy_loss, real);
    add_lanes(sums.value_loss, term.loss, real);
    add_lanes(sums.kl, k3(whole.ratio, log_ratio), real);
    add_lanes(sums.old_kl, _mm256_sub_ps(zero, log_ratio), real);
    add_lanes(sums.clipped, clipped, real);
    add_lanes(sums.ratio, whole.ratio, real);
    add_lanes(sums.value_delta,
              _mm256_andnot_ps(lanes::splat(-0.0F),
                               _mm256_sub_ps(new_value, load(inputs.old_value + first))),
              real);
    alignas(32) float ratio[kWidth];
    _mm256_store_ps(ratio, whole.ratio);
    for (int lane = 0; lane < real; ++lane) {
      sums.ratio_min = std::min(sums.ratio_min, static_cast<double>(ratio[lane]));
      sums.ratio_max = std::max(sums.ratio_max, static_cast<double>(ratio[lane]));
    }
  }
  return sums;
}

}  // namespace omentum
