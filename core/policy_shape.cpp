#include <fmt/core.h>

#include <algorithm>
#include <numeric>

#include "core/check.h"
#include "core/hash.h"
#include "core/policy.h"
#include "core/task.h"

namespace omentum {

namespace {

/// Lays one network out from `offset` on; returns the offset behind it.
std::size_t lay_out(const PolicyShape& shape, int outputs, bool has_head_bias, std::size_t offset,
                    NetworkLayout& network) {
  const auto inputs = static_cast<std::size_t>(shape.inputs());
  const auto hidden = static_cast<std::size_t>(shape.hidden);
  const auto count = static_cast<std::size_t>(outputs);
  network.outputs = outputs;
  network.has_head_bias = has_head_bias;
  network.filters1 = offset;
  const auto filters = [&](const Convolution& c, std::size_t weights, std::size_t& bias) {
    const auto size = static_cast<std::size_t>(c.filters);
    bias = weights + (shape.convolution ? static_cast<std::size_t>(c.patch()) * size : 0);
    return bias + (shape.convolution ? size : 0);
  };
  network.filters2 =
      filters(first_convolution(shape.picture), network.filters1, network.filters1_bias);
  network.weights1 =
      filters(second_convolution(shape.picture), network.filters2, network.filters2_bias);
  network.bias1 = network.weights1 + inputs * hidden;
  network.weights2 = network.bias1 + hidden;
  network.bias2 = network.weights2 + hidden * hidden;
  network.head = network.bias2 + hidden;
  network.head_bias = network.head + count * hidden;
  return network.head_bias + (has_head_bias ? count : 0);
}

}  // namespace

int PolicyShape::features() const {
  return convolution ? second_convolution(picture).outputs() : 0;
}

int PolicyShape::inputs() const { return convolution ? numbers() + features() : observations; }

int PolicyShape::logits() const {
  return continuous ? kContinuousDimensions : std::accumulate(branches.begin(), branches.end(), 0);
}

int PolicyShape::branch_count() const {
  return continuous ? kContinuousDimensions : static_cast<int>(branches.size());
}

ParameterLayout parameter_layout(const PolicyShape& shape) {
  ParameterLayout layout;
  layout.log_std = lay_out(shape, shape.logits(), shape.head_bias, 0, layout.actor);
  const std::size_t critic = layout.log_std + (shape.continuous ? kContinuousDimensions : 0);
  layout.count = lay_out(shape, 1, true, critic, layout.critic);
  return layout;
}

std::size_t PolicyShape::parameter_count() const { return parameter_layout(*this).count; }

std::uint64_t PolicyShape::layout_hash() const {
  std::string text = fmt::format(
      "policy layout 1: observations {} hidden {} activation {} head_bias {} continuous {}",
      observations, hidden, static_cast<int>(activation), head_bias, continuous);
  for (const int branch : branches) text += fmt::format(" {}", branch);
  if (picture.size > 0)
    text += fmt::format("; picture {} x {} convolution {}", picture.size, picture.channels,
                        convolution);
  return fnv1a64(text);
}

PolicyShape policy_shape(const pb::Config& config) {
  PolicyShape shape;
  shape.observations = observation_size(config.task());
  shape.picture = picture_shape(config.task());
  shape.convolution = config.ppo().network() == pb::NETWORK_CONVOLUTION ||
                      (config.ppo().network() == pb::NETWORK_AUTOMATIC && shape.picture.size > 0);
  shape.branches = action_branches(config.task());
  shape.continuous = shape.branches.empty();
  shape.hidden = static_cast<int>(config.ppo().hidden());
  shape.activation = config.ppo().activation();
  shape.head_bias = config.ppo().head_bias();
  return shape;
}

}  // namespace omentum
