#include <fmt/core.h>

#include <algorithm>
#include <numeric>

#include "core/check.h"
#include "core/hash.h"
#include "core/policy.h"

namespace omentum {

namespace {

/// Lays one network out from `offset` on; returns the offset behind it.
std::size_t lay_out(const PolicyShape& shape, int outputs, bool has_head_bias, std::size_t offset,
                    NetworkLayout& network) {
  const auto observations = static_cast<std::size_t>(shape.observations);
  const auto hidden = static_cast<std::size_t>(shape.hidden);
  const auto count = static_cast<std::size_t>(outputs);
  network.outputs = outputs;
  network.has_head_bias = has_head_bias;
  network.weights1 = offset;
  network.bias1 = network.weights1 + observations * hidden;
  network.weights2 = network.bias1 + hidden;
  network.bias2 = network.weights2 + hidden * hidden;
  network.head = network.bias2 + hidden;
  network.head_bias = network.head + count * hidden;
  return network.head_bias + (has_head_bias ? count : 0);
}

const std::vector<std::string> kAxes = {"x", "y", "z"};

void append_point(std::vector<std::string>& names, const std::string& point) {
  for (const std::string& axis : kAxes) names.push_back(fmt::format("{}_{}", point, axis));
}

std::vector<std::string> paper_names() {
  std::vector<std::string> names = {"held_flag"};
  append_point(names, "p");
  append_point(names, "q");
  append_point(names, "p_T");
  names.emplace_back("distance_p_q");
  names.emplace_back("distance_p_p_T");
  return names;
}

std::vector<std::string> omentum_names() {
  std::vector<std::string> names = paper_names();
  names.emplace_back("jaw_closed");
  names.emplace_back("exposure");
  append_point(names, "grasp");
  append_point(names, "near_goal");
  return names;
}

}  // namespace

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
  return fnv1a64(text);
}

std::vector<std::string> observation_names(const pb::Task& task) {
  switch (task.observation()) {
    case pb::OBSERVATION_PAPER:
    case pb::OBSERVATION_DERIVED:
      return paper_names();
    case pb::OBSERVATION_DERIVED_HEAD: {
      std::vector<std::string> names = {"held_flag"};
      append_point(names, "p");
      append_point(names, "goal");
      names.emplace_back("distance_p_goal");
      return names;
    }
    case pb::OBSERVATION_OMENTUM:
      return omentum_names();
    case pb::OBSERVATION_IMAGE:
      break;
  }
  std::vector<std::string> names = omentum_names();
  const std::vector<std::string> channels = task.image() == pb::IMAGE_OBJECT_IDS
                                                ? std::vector<std::string>{"object"}
                                                : std::vector<std::string>{"red", "green", "blue"};
  for (const std::string& channel : channels) {
    for (std::uint32_t row = 0; row < task.image_size(); ++row) {
      for (std::uint32_t column = 0; column < task.image_size(); ++column) {
        names.push_back(fmt::format("{}_{}_{}", channel, row, column));
      }
    }
  }
  return names;
}

std::vector<std::string> action_names(const pb::Task& task) {
  switch (task.action()) {
    case pb::ACTION_XYZ_GRIPPER:
      return {"x", "y", "z", "gripper"};
    case pb::ACTION_DERIVED:
      return {"unity_x", "unity_y", "unity_z"};
    case pb::ACTION_DERIVED_HEAD:
      return {"unity_y", "unity_z", "unity_x"};
    case pb::ACTION_CONTINUOUS:
      break;
  }
  return {"x", "y", "z", "jaw"};
}

PolicyShape policy_shape(const pb::Config& config) {
  PolicyShape shape;
  shape.observations = static_cast<int>(observation_names(config.task()).size());
  switch (config.task().action()) {
    case pb::ACTION_XYZ_GRIPPER:
      shape.branches = {3, 3, 3, 2};
      break;
    case pb::ACTION_DERIVED:
    case pb::ACTION_DERIVED_HEAD:
      shape.branches = {3, 3, 3};
      break;
    case pb::ACTION_CONTINUOUS:
      shape.continuous = true;
      break;
  }
  shape.hidden = static_cast<int>(config.ppo().hidden());
  shape.activation = config.ppo().activation();
  shape.head_bias = config.ppo().head_bias();
  return shape;
}

}  // namespace omentum
