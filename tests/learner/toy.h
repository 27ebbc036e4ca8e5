#pragma once

// Small environments and the loop that turns them into segments, for tests of the learner alone.
// The loop keeps the contract of core/rollout.h: resets inside the segment, final observations at
// truncations, counters by slot, episode and step.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/policy.h"
#include "core/rng.h"
#include "core/segment_fields.h"
#include "core/types.h"

namespace omentum::toy {

struct Step {
  float reward = 0;
  bool terminated = false;
};

class Environment {
 public:
  virtual ~Environment() = default;
  virtual void reset(std::uint64_t seed, std::uint32_t slot, std::uint64_t episode) = 0;
  virtual void observe(std::span<float> out) const = 0;
  virtual Step step(const Decision& action) = 0;
};

/// Four branches: bring a point to a goal with steps of -1, 0, +1 per axis and close the gripper
/// only near the goal. Six observations: point and goal.
class Reach : public Environment {
 public:
  void reset(std::uint64_t seed, std::uint32_t slot, std::uint64_t episode) override {
    for (std::uint32_t half = 0; half < 2; ++half) {
      const PhiloxWords words = random_words(seed, slot, Purpose::kReset, half, episode, 0);
      for (std::size_t axis = 0; axis < 3; ++axis) {
        (half == 0 ? point_ : goal_)[axis] = 2 * uniform_24(words[axis]) - 1;
      }
    }
  }
  void observe(std::span<float> out) const override {
    std::copy(point_.begin(), point_.end(), out.begin());
    std::copy(goal_.begin(), goal_.end(), out.begin() + 3);
  }
  Step step(const Decision& action) override {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      point_[axis] += 0.1F * (static_cast<float>(action.branch[axis]) - 1);
      point_[axis] = std::clamp(point_[axis], -1.2F, 1.2F);
    }
    const float d = distance();
    const bool closed = action.branch[3] == 1;
    return {-0.2F * d + (closed == (d < 0.3F) ? 0.0F : -0.2F), false};
  }
  float distance() const {
    float sum = 0;
    for (std::size_t axis = 0; axis < 3; ++axis)
      sum += (point_[axis] - goal_[axis]) * (point_[axis] - goal_[axis]);
    return std::sqrt(sum);
  }

 protected:
  std::array<float, 3> point_{}, goal_{};
};

/// The same with the Gaussian head: increments in [-1, 1], jaw closed when > 0.
class ContinuousReach : public Reach {
 public:
  Step step(const Decision& action) override {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      point_[axis] += 0.1F * std::clamp(action.continuous[axis], -1.0F, 1.0F);
    }
    const float d = distance();
    const bool closed = action.continuous[3] > 0;
    return {-0.2F * d + (closed == (d < 0.3F) ? 0.0F : -0.2F), false};
  }
};

/// The cart and pole of [Barto83] with the usual constants; one branch of two; reward 1 until it
/// falls.
class CartPole : public Environment {
 public:
  void reset(std::uint64_t seed, std::uint32_t slot, std::uint64_t episode) override {
    const PhiloxWords words = random_words(seed, slot, Purpose::kReset, 0, episode, 0);
    for (std::size_t i = 0; i < 4; ++i) state_[i] = 0.1F * (uniform_24(words[i]) - 0.5F);
  }
  void observe(std::span<float> out) const override {
    std::copy(state_.begin(), state_.end(), out.begin());
  }
  Step step(const Decision& action) override {
    auto& [x, v, angle, rate] = state_;
    const float force = action.branch[0] == 1 ? 10.0F : -10.0F;
    const float c = std::cos(angle), s = std::sin(angle);
    const float push = (force + 0.05F * rate * rate * s) / 1.1F;
    const float spin = (9.8F * s - c * push) / (0.5F * (4.0F / 3 - 0.1F * c * c / 1.1F));
    const float pull = push - 0.05F * spin * c / 1.1F;
    x += 0.02F * v;
    v += 0.02F * pull;
    angle += 0.02F * rate;
    rate += 0.02F * spin;
    return {1.0F, std::abs(x) > 2.4F || std::abs(angle) > 0.2095F};
  }

 private:
  std::array<float, 4> state_{};
};

/// E slots of one environment kind that survive from batch to batch.
template <typename Kind>
class Slots {
 public:
  Slots(std::uint64_t seed, int slots, std::uint32_t episode_limit)
      : seed_(seed), limit_(episode_limit), slots_(static_cast<std::size_t>(slots)) {
    for (std::size_t s = 0; s < slots_.size(); ++s) {
      slots_[s].environment.reset(seed_, static_cast<std::uint32_t>(s), 0);
    }
  }

  /// One segment per slot, and the task it answers.
  std::vector<RolloutSegment> collect(Policy& policy, std::uint32_t steps,
                                      std::vector<RolloutTask>* tasks = nullptr) {
    std::vector<RolloutSegment> segments;
    for (std::size_t s = 0; s < slots_.size(); ++s) {
      RolloutTask task;
      task.slot = static_cast<std::uint32_t>(s);
      task.segment = segment_;
      task.steps = steps;
      task.episode = slots_[s].episode;
      task.episode_step = slots_[s].step;
      task.policy_version = policy.weights().policy_version;
      if (tasks != nullptr) tasks->push_back(task);
      segments.push_back(run(policy, task));
    }
    ++segment_;
    return segments;
  }

  const std::vector<double>& finished_returns() const { return finished_; }

 private:
  struct Slot {
    Kind environment;
    std::uint64_t episode = 0;
    std::uint32_t step = 0;
    double episode_return = 0;
  };

  RolloutSegment run(Policy& policy, const RolloutTask& task) {
    Slot& slot = slots_[task.slot];
    const auto width = static_cast<std::size_t>(policy.shape().observations);
    RolloutSegment segment;
    segment.slot = task.slot;
    segment.segment = task.segment;
    segment.steps = task.steps;
    segment.policy_version = task.policy_version;
    std::vector<float> observation(width);
    for (std::uint32_t i = 0; i < task.steps; ++i) {
      slot.environment.observe(observation);
      const ActionCounter counter{seed_, task.slot, slot.episode, slot.step, Purpose::kAction};
      Decision decision;
      policy.act(observation, std::span(&counter, 1), false, std::span(&decision, 1));
      const Step outcome = slot.environment.step(decision);
      segment.observations.insert(segment.observations.end(), observation.begin(),
                                  observation.end());
      segment.actions.insert(segment.actions.end(), decision.branch.begin(),
                             decision.branch.begin() + 4);
      if (policy.shape().continuous) {
        segment.actions_continuous.insert(segment.actions_continuous.end(),
                                          decision.continuous.begin(), decision.continuous.end());
      }
      segment.log_probs.push_back(decision.log_prob);
      segment.values.push_back(decision.value);
      segment.rewards.push_back(outcome.reward);
      std::uint8_t flags = slot.step == 0 ? step_flag::kFirst : 0;
      slot.episode_return += static_cast<double>(outcome.reward);
      ++slot.step;
      const bool truncated = !outcome.terminated && slot.step == limit_;
      if (outcome.terminated) flags |= step_flag::kTerminated;
      if (truncated) flags |= step_flag::kTruncated;
      segment.flags.push_back(flags);
      if (outcome.terminated || truncated)
        end_episode(slot, task.slot, i, truncated, segment, width);
    }
    segment.bootstrap_observation.resize(width);
    slot.environment.observe(segment.bootstrap_observation);
    segment.end_episode = slot.episode;
    segment.end_episode_step = slot.step;
    segment.end_state.assign(8, std::byte{1});  // never loaded: the environments live on in slots_
    segment.end_hash = hash_state(segment.end_state);
    segment.payload_crc32c = segment_crc(segment);
    return segment;
  }

  void end_episode(Slot& slot, std::uint32_t id, std::uint32_t step, bool truncated,
                   RolloutSegment& segment, std::size_t width) {
    if (truncated) {
      std::vector<float> observation(width);
      slot.environment.observe(observation);
      segment.final_observations.insert(segment.final_observations.end(), observation.begin(),
                                        observation.end());
    }
    segment.episode_end_step.push_back(step);
    segment.episode_return.push_back(slot.episode_return);
    segment.episode_length.push_back(slot.step);
    segment.episode_outcome.push_back(
        static_cast<std::uint8_t>(truncated ? Outcome::kTruncated : Outcome::kGraspLost));
    segment.episode_exposure.push_back(0);
    segment.episode_grasped.push_back(0);
    segment.episode_held.push_back(0);
    for (int i = 0; i < 3; ++i) {
      segment.episode_grasp_position_in_world_m.push_back(std::nanf(""));
      segment.episode_start_position_in_world_m.push_back(0);
    }
    finished_.push_back(slot.episode_return);
    slot.environment.reset(seed_, id, ++slot.episode);
    slot.step = 0;
    slot.episode_return = 0;
  }

  std::uint64_t seed_ = 0;
  std::uint32_t limit_ = 0;
  std::uint64_t segment_ = 0;
  std::vector<Slot> slots_;
  std::vector<double> finished_;
};

}  // namespace omentum::toy
