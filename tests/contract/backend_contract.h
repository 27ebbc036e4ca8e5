#pragma once

// What every Backend promises (core/backend.h), a robot included. Instantiate for a new back end
// with a case that makes one with a given number of lanes:  INSTANTIATE_TEST_SUITE_P(Mine,
// BackendContract, testing::Values(BackendCase{...})); one that has Snapshots instantiates
// contract/snapshots_contract.h as well. A robot has one lane: every test here takes one.

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <memory>
#include <string>

#include "core/backend.h"
#include "core/rng.h"
#include "core/rollout.h"

namespace omentum::test {

struct BackendCase {
  std::string name;
  std::function<std::unique_ptr<Backend>(int lanes)> make;
  PolicyShape shape;
};

inline void PrintTo(const BackendCase& c, std::ostream* out) { *out << c.name; }

class BackendContract : public testing::TestWithParam<BackendCase> {};

inline EpisodeStart training_start(std::uint32_t slot) {
  EpisodeStart start;
  start.run_seed = 77;
  start.slot = slot;
  return start;
}

/// Random but reproducible action of a slot at a step.
inline Action random_action(std::uint32_t slot, std::uint32_t step) {
  const PhiloxWords words = philox({slot, step, 0, 0}, {1, 1});
  const PhiloxWords more = philox({slot, step, 1, 0}, {1, 1});
  Action action;
  for (std::size_t b = 0; b < 4; ++b) {
    action.branch[b] = static_cast<std::uint8_t>(bounded(words[b], b < 3 ? 3 : 2));
    action.continuous[b] = 2 * uniform_24(words[b]) - 1;
    if (4 + b < action.branch.size())
      action.branch[4 + b] = static_cast<std::uint8_t>(bounded(more[b], 3));
  }
  return action;
}

/// Runs slots first ... in all lanes for some steps; lane k plays slot first + k.
inline void play(Backend& backend, std::uint32_t first, std::uint32_t from, std::uint32_t steps) {
  std::vector<Action> actions(static_cast<std::size_t>(backend.lanes()));
  std::vector<StepOutcome> outcomes(actions.size());
  for (std::uint32_t step = from; step < from + steps; ++step) {
    for (std::size_t k = 0; k < actions.size(); ++k)
      actions[k] = random_action(first + static_cast<std::uint32_t>(k), step);
    backend.step(actions, outcomes);
  }
}

TEST_P(BackendContract, ObservationsAreFiniteAndOfTheDeclaredSize) {
  const auto backend = GetParam().make(1);
  backend->reset(0, training_start(0));
  std::vector<float> observation(static_cast<std::size_t>(backend->observation_size()));
  for (std::uint32_t step = 0; step < 30; ++step) {
    play(*backend, 0, step, 1);
    backend->observe(0, observation);
    for (const float v : observation) ASSERT_TRUE(std::isfinite(v));
  }
  EXPECT_EQ(backend->observation_size(), GetParam().shape.observations);
}

TEST_P(BackendContract, ResetBeginsTheEpisodeThatIsAskedFor) {
  const auto backend = GetParam().make(1);
  play(*backend, 0, 0, 5);
  EpisodeStart start = training_start(3);
  start.episode = 8;
  start.episode_limit = 17;
  backend->reset(0, start);
  const EpisodeFacts facts = backend->clock(0);
  EXPECT_EQ(facts.episode, 8U);
  EXPECT_EQ(facts.episode_step, 0U);
  EXPECT_EQ(facts.episode_limit, 17U);
  EXPECT_EQ(facts.episode_return, 0);
  EXPECT_FALSE(facts.held || facts.grasped_ever || facts.reached || facts.lost_ever);
}

TEST_P(BackendContract, StepsAreCountedAndTheLastOneTruncates) {
  const auto backend = GetParam().make(1);
  EpisodeStart start = training_start(3);
  start.episode_limit = 6;
  backend->reset(0, start);
  std::vector<Action> actions(1);
  std::vector<StepOutcome> outcomes(1);
  double sum = 0;
  for (std::uint32_t step = 1; step <= 6; ++step) {
    actions[0] = random_action(3, step);
    backend->step(actions, outcomes);
    sum += static_cast<double>(outcomes[0].reward);
    EXPECT_EQ(backend->clock(0).episode_step, step);
    EXPECT_EQ(outcomes[0].truncated, step == 6 && !outcomes[0].terminated) << step;
  }
  EXPECT_NEAR(backend->clock(0).episode_return, sum, 1e-9);
  EXPECT_EQ(backend->facts(0).episode_return, backend->clock(0).episode_return);
}

TEST_P(BackendContract, HoldScriptChoosesActionsOfTheTask) {
  const auto backend = GetParam().make(1);
  backend->reset(0, training_start(5));
  std::vector<Action> actions(1);
  std::vector<StepOutcome> outcomes(1);
  const PolicyShape& shape = GetParam().shape;
  for (int step = 0; step < 30; ++step) {
    actions[0] = backend->hold_action(0);
    for (std::size_t b = 0; b < shape.branches.size(); ++b)
      ASSERT_LT(actions[0].branch[b], shape.branches[b]) << "branch " << b;
    for (const float v : actions[0].continuous) ASSERT_LE(std::fabs(v), 1.0F);
    backend->step(actions, outcomes);
  }
  EXPECT_TRUE(backend->healthy(0));
}

inline std::vector<RolloutTask> make_tasks(std::uint32_t count, std::uint32_t steps) {
  std::vector<RolloutTask> tasks(count);
  for (std::uint32_t i = 0; i < count; ++i) {
    tasks[i].slot = i;
    tasks[i].steps = steps;
    tasks[i].run_seed = 77;
    tasks[i].reset = true;
    tasks[i].task_hash = hash_task(tasks[i]);
  }
  return tasks;
}

inline Policy make_policy(const PolicyShape& shape) {
  PolicyWeights weights;
  weights.parameters.resize(shape.parameter_count());
  for (std::size_t i = 0; i < weights.parameters.size(); ++i) {
    weights.parameters[i] =
        0.3F * (uniform_24(philox({static_cast<std::uint32_t>(i), 0, 0, 0}, {2, 3})[0]) - 0.5F);
  }
  return {shape, weights};
}

TEST_P(BackendContract, SegmentHasARowOfEveryStepAndAStateIfThereIsOne) {
  Policy policy = make_policy(GetParam().shape);
  const auto backend = GetParam().make(1);
  auto task = make_tasks(1, 30);
  task[0].frame_stride = 10;
  const RolloutSegment s = run_rollout(*backend, policy, task, {})[0];
  ASSERT_EQ(s.failed, 0U) << s.failure;
  EXPECT_EQ(s.steps, 30U);
  EXPECT_EQ(s.observations.size(), 30U * static_cast<std::size_t>(backend->observation_size()));
  EXPECT_EQ(s.actions.size(), 30 * GetParam().shape.columns());
  EXPECT_EQ(s.actions_continuous.size(), GetParam().shape.continuous ? 4 * 30U : 0U);
  EXPECT_EQ(s.rewards.size(), 30U);
  EXPECT_EQ(s.flags.size(), 30U);
  EXPECT_EQ(s.flags[0] & step_flag::kFirst, step_flag::kFirst);
  EXPECT_EQ(s.exposures.size(), 30U);
  EXPECT_EQ(s.tool_positions_in_world_m.size(), 3 * 30U);
  EXPECT_EQ(s.bootstrap_observation.size(), static_cast<std::size_t>(backend->observation_size()));
  const bool states = backend->snapshots() != nullptr;
  EXPECT_EQ(s.state_format != 0, states);
  EXPECT_EQ(s.end_state.empty(), !states);
  EXPECT_EQ(s.state_hashes.size(), states ? 30U : 0U);
  EXPECT_EQ(s.frame_positions_in_world_m.empty(), !states);
}

TEST_P(BackendContract, ScriptActsInPlaceOfThePolicy) {
  const auto backend = GetParam().make(1);
  const bool continuous = GetParam().shape.continuous;
  const Actor actor(
      [](std::uint32_t step, std::span<Action> actions) { actions[0] = random_action(7, step); },
      continuous);
  auto task = make_tasks(1, 20);
  task[0].episode_limit = 10;
  const RolloutSegment s = run_rollout(*backend, actor, task, {})[0];
  ASSERT_EQ(s.failed, 0U) << s.failure;
  ASSERT_EQ(s.steps, 20U);
  for (std::uint32_t step = 0; step < 20; ++step) {
    const Action expected = random_action(7, step);
    const auto columns = static_cast<std::ptrdiff_t>(backend->columns());
    EXPECT_TRUE(std::equal(expected.branch.begin(), expected.branch.begin() + columns,
                           s.actions.begin() + columns * static_cast<std::ptrdiff_t>(step)));
    EXPECT_EQ(s.flags[step] & step_flag::kScripted, step_flag::kScripted);
  }
  EXPECT_EQ(s.actions_continuous.empty(), !continuous);
  EXPECT_EQ(s.episode_end_step, std::vector<std::uint32_t>{19}) << "one episode, to its last step";
  EXPECT_TRUE(s.end_state.empty());
}

TEST_P(BackendContract, StopLeavesNothingHalfDone) {
  Policy policy = make_policy(GetParam().shape);
  const auto backend = GetParam().make(1);
  int polled = 0;
  EXPECT_TRUE(run_rollout(*backend, policy, make_tasks(1, 60), [&polled] {
                return ++polled > 10;
              }).empty());
}

}  // namespace omentum::test
