#include "learner/initialise.h"

#include <algorithm>
#include <cmath>

#include "core/activation.h"
#include "core/rng.h"

namespace omentum {

namespace {

/// Uniform in (0, 1): centres of 2^23 equal cells, exact in f32 and never 0 or 1.
double uniform(RandomStream& stream) {
  return static_cast<double>((static_cast<float>(stream.next() >> 9) + 0.5F) * 0x1p-23F);
}

/// A weight matrix as inputs x outputs with the strides it is stored with.
struct Matrix {
  float* data = nullptr;
  std::size_t inputs = 0, outputs = 0;
  std::size_t input_stride = 0, output_stride = 0;

  float& at(std::size_t input, std::size_t output) const {
    return data[input * input_stride + output * output_stride];
  }
};

/// min(inputs, outputs) orthonormal vectors of the longer side, times gain: normal numbers, then
/// Gram-Schmidt, run twice for orthogonality to rounding.
void fill_orthogonal(const Matrix& m, double gain, RandomStream stream) {
  const bool wide = m.outputs >= m.inputs;
  const std::size_t vectors = wide ? m.inputs : m.outputs;
  const std::size_t length = wide ? m.outputs : m.inputs;
  std::vector<double> q(vectors * length);
  for (double& value : q)
    value = static_cast<double>(lanes::normal_quantile(static_cast<float>(uniform(stream))));
  const auto dot = [&](const double* a, const double* b) {
    double sum = 0;
    for (std::size_t i = 0; i < length; ++i) sum += a[i] * b[i];
    return sum;
  };
  for (std::size_t v = 0; v < vectors; ++v) {
    double* own = q.data() + v * length;
    for (int pass = 0; pass < 2; ++pass) {
      for (std::size_t u = 0; u < v; ++u) {
        const double* other = q.data() + u * length;
        const double projection = dot(own, other);
        for (std::size_t i = 0; i < length; ++i) own[i] -= projection * other[i];
      }
      const double norm = std::sqrt(dot(own, own));
      for (std::size_t i = 0; i < length; ++i) own[i] /= norm;
    }
    for (std::size_t i = 0; i < length; ++i) {
      (wide ? m.at(v, i) : m.at(i, v)) = static_cast<float>(gain * own[i]);
    }
  }
}

/// Normal numbers cut at two deviations by the inverse distribution function, with variance scale /
/// fan-in after the cut.
void fill_variance_scaling(const Matrix& m, double scale, RandomStream stream) {
  constexpr double kDeviationAfterCut = 0.87962566103423978;  // of a unit normal cut at +-2
  constexpr double kBelowMinusTwo = 0.022750131948179195;     // its probability
  const double deviation = std::sqrt(scale / static_cast<double>(m.inputs)) / kDeviationAfterCut;
  for (std::size_t i = 0; i < m.inputs; ++i) {
    for (std::size_t o = 0; o < m.outputs; ++o) {
      const double p = kBelowMinusTwo + (1 - 2 * kBelowMinusTwo) * uniform(stream);
      const auto z = static_cast<double>(lanes::normal_quantile(static_cast<float>(p)));
      m.at(i, o) = static_cast<float>(deviation * std::clamp(z, -2.0, 2.0));
    }
  }
}

void fill_glorot_uniform(const Matrix& m, RandomStream stream) {
  const double limit = std::sqrt(6.0 / static_cast<double>(m.inputs + m.outputs));
  for (std::size_t i = 0; i < m.inputs; ++i) {
    for (std::size_t o = 0; o < m.outputs; ++o) {
      m.at(i, o) = static_cast<float>(limit * (2 * uniform(stream) - 1));
    }
  }
}

}  // namespace

std::vector<float> initial_parameters(const PolicyShape& shape, const pb::Ppo& settings,
                                      std::uint64_t run_seed) {
  constexpr double kPolicyHead = 0.01;
  const ParameterLayout layout = parameter_layout(shape);
  std::vector<float> parameters(layout.count, 0.0F);
  const auto hidden = static_cast<std::size_t>(shape.hidden);
  const auto inputs = static_cast<std::size_t>(shape.inputs());
  const bool orthogonal = settings.initialisation() == pb::INIT_ORTHOGONAL;
  std::uint32_t tensor = 0;
  for (const NetworkLayout* network : {&layout.actor, &layout.critic}) {
    const bool actor = network == &layout.actor;
    const auto outputs = static_cast<std::size_t>(network->outputs);
    const Matrix first{parameters.data() + network->weights1, inputs, hidden, hidden, 1};
    const Matrix second{parameters.data() + network->weights2, hidden, hidden, hidden, 1};
    const Matrix head{parameters.data() + network->head, hidden, outputs, 1, hidden};
    const auto stream = [&] { return RandomStream(run_seed, tensor++, Purpose::kWeights, 0); };
    const RandomStream draws[3] = {stream(), stream(), stream()};
    if (orthogonal) {
      fill_orthogonal(first, std::sqrt(2.0), draws[0]);
      fill_orthogonal(second, std::sqrt(2.0), draws[1]);
      fill_orthogonal(head, actor ? kPolicyHead : 1.0, draws[2]);
    } else {
      fill_variance_scaling(first, 1, draws[0]);
      fill_variance_scaling(second, 1, draws[1]);
      if (actor) {
        fill_variance_scaling(head, kPolicyHead, draws[2]);
      } else {
        fill_glorot_uniform(head, draws[2]);
      }
    }
  }
  const auto fill_filters = [&](const Convolution& c, std::size_t offset) {
    const auto filters = static_cast<std::size_t>(c.filters);
    const Matrix matrix{parameters.data() + offset, static_cast<std::size_t>(c.patch()), filters,
                        filters, 1};
    const RandomStream stream(run_seed, tensor++, Purpose::kWeights, 0);
    if (orthogonal) {
      fill_orthogonal(matrix, std::sqrt(2.0), stream);
    } else {
      fill_variance_scaling(matrix, 1, stream);
    }
  };
  for (const NetworkLayout* network : {&layout.actor, &layout.critic}) {
    if (!shape.convolution) break;
    fill_filters(first_convolution(shape.picture), network->filters1);
    fill_filters(second_convolution(shape.picture), network->filters2);
  }
  if (shape.continuous) {
    std::fill_n(parameters.begin() + static_cast<std::ptrdiff_t>(layout.log_std),
                kContinuousDimensions, static_cast<float>(settings.initial_log_std()));
  }
  return parameters;
}

}  // namespace omentum
