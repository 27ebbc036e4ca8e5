#pragma once

// What every Backend promises (core/backend.h). Instantiate for a new back end with a case that
// makes one with a given number of lanes:  INSTANTIATE_TEST_SUITE_P(Mine, BackendContract,
// testing::Values(BackendCase{...}));

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
  Action action;
  for (std::size_t b = 0; b < 4; ++b) {
    action.branch[b] = static_cast<std::uint8_t>(bounded(words[b], b < 3 ? 3 : 2));
    action.continuous[b] = 2 * uniform_24(words[b]) - 1;
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

TEST_P(BackendContract, LaneEqualsARunAlone) {
  const auto many = GetParam().make(5);
  const auto one = GetParam().make(1);
  for (int lane = 0; lane < 5; ++lane)
    many->reset(lane, training_start(static_cast<std::uint32_t>(lane)));
  play(*many, 0, 0, 40);
  for (int lane = 0; lane < 5; ++lane) {
    one->reset(0, training_start(static_cast<std::uint32_t>(lane)));
    play(*one, static_cast<std::uint32_t>(lane), 0, 40);
    EXPECT_EQ(one->save(0), many->save(lane)) << "lane " << lane;
  }
}

TEST_P(BackendContract, SaveLoadContinueEqualsContinue) {
  const auto through = GetParam().make(1);
  through->reset(0, training_start(3));
  play(*through, 3, 0, 25);
  const Bytes middle = through->save(0);
  play(*through, 3, 25, 25);
  const auto resumed = GetParam().make(3);
  ASSERT_TRUE(resumed->load(0, middle).has_value());
  EXPECT_EQ(resumed->save(0), middle);
  play(*resumed, 3, 25, 25);
  EXPECT_EQ(resumed->save(0), through->save(0));
}

TEST_P(BackendContract, ResetLeavesNoTrace) {
  const auto used = GetParam().make(2);
  const auto fresh = GetParam().make(2);
  play(*used, 9, 0, 30);
  used->reset(1, training_start(4));
  fresh->reset(1, training_start(4));
  EXPECT_EQ(used->save(1), fresh->save(1));
}

TEST_P(BackendContract, ResetOfOneLaneLeavesOthers) {
  const auto backend = GetParam().make(3);
  play(*backend, 0, 0, 10);
  const Bytes before0 = backend->save(0);
  const Bytes before2 = backend->save(2);
  backend->reset(1, training_start(8));
  EXPECT_EQ(backend->save(0), before0);
  EXPECT_EQ(backend->save(2), before2);
}

TEST_P(BackendContract, LoadRefusesEveryPrefixAndChangesNothing) {
  const auto backend = GetParam().make(1);
  backend->reset(0, training_start(1));
  play(*backend, 1, 0, 5);
  const Bytes state = backend->save(0);
  const Bytes other = [&] {
    const auto second = GetParam().make(1);
    second->reset(0, training_start(2));
    return second->save(0);
  }();
  // Every short prefix and then in strides: a state has tens of thousands of bytes.
  for (std::size_t size = 0; size < other.size(); size += size < 300 ? 1 : 97) {
    EXPECT_FALSE(backend->load(0, std::span(other).first(size)).has_value()) << size;
    ASSERT_EQ(backend->save(0), state) << size;
  }
}

TEST_P(BackendContract, ObservationsAreFiniteAndOfTheDeclaredSize) {
  const auto backend = GetParam().make(2);
  backend->reset(0, training_start(0));
  std::vector<float> observation(static_cast<std::size_t>(backend->observation_size()));
  for (std::uint32_t step = 0; step < 30; ++step) {
    play(*backend, 0, step, 1);
    backend->observe(0, observation);
    for (const float v : observation) ASSERT_TRUE(std::isfinite(v));
  }
  EXPECT_EQ(backend->observation_size(), GetParam().shape.observations);
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

TEST_P(BackendContract, SegmentIsAPureFunctionOfItsTask) {
  Policy policy = make_policy(GetParam().shape);
  const auto tasks = make_tasks(4, 60);
  const auto wide = GetParam().make(6);
  const auto narrow = GetParam().make(1);
  play(*wide, 20, 0, 7);  // whatever the lanes held before
  const auto together = run_rollout(*wide, policy, tasks, {});
  for (std::size_t k = 0; k < tasks.size(); ++k) {
    const auto alone = run_rollout(*narrow, policy, std::span(tasks).subspan(k, 1), {});
    EXPECT_EQ(alone[0].payload_crc32c, together[k].payload_crc32c) << k;
    EXPECT_EQ(alone[0].end_hash, together[k].end_hash) << k;
    EXPECT_EQ(alone[0].log_probs, together[k].log_probs) << k;
    EXPECT_EQ(together[k].steps, 60U);
  }
}

TEST_P(BackendContract, TwoHalvesEqualOneWhole) {
  Policy policy = make_policy(GetParam().shape);
  const auto backend = GetParam().make(1);
  auto whole = make_tasks(1, 100);
  const RolloutSegment expected = run_rollout(*backend, policy, whole, {})[0];
  auto half = make_tasks(1, 50);
  const RolloutSegment first = run_rollout(*backend, policy, half, {})[0];
  half[0].reset = false;
  half[0].segment = 1;
  half[0].start_state = first.end_state;
  half[0].episode = first.end_episode;
  const auto other = GetParam().make(2);
  const RolloutSegment second = run_rollout(*other, policy, half, {})[0];
  EXPECT_EQ(second.end_hash, expected.end_hash);
  std::vector<float> joined = first.rewards;
  joined.insert(joined.end(), second.rewards.begin(), second.rewards.end());
  EXPECT_EQ(joined, expected.rewards);
}

TEST_P(BackendContract, ReplayOfRecordedActionsDerivesTheSameHashesAndRewards) {
  Policy policy = make_policy(GetParam().shape);
  const auto backend = GetParam().make(2);
  auto task = make_tasks(1, 40);
  task[0].frame_stride = 10;
  task[0].kind = TaskKind::kEvaluate;
  task[0].policy_steps = 40;
  task[0].hold_steps = 3;
  const RolloutSegment recorded = run_rollout(*backend, policy, task, {})[0];
  ASSERT_EQ(recorded.state_hashes.size(), recorded.steps);
  std::vector<Action> actions(recorded.steps);
  for (std::size_t i = 0; i < actions.size(); ++i) {
    std::copy_n(recorded.actions.data() + 4 * i, 4, actions[i].branch.begin());
    if (!recorded.actions_continuous.empty())
      std::copy_n(recorded.actions_continuous.data() + 4 * i, 4, actions[i].continuous.begin());
  }
  task[0].steps = recorded.steps;
  // Another policy, so that nothing but the recorded actions can lead to the same states.
  PolicyWeights weights = policy.weights();
  for (float& weight : weights.parameters) weight = -weight;
  Policy stranger(GetParam().shape, std::move(weights));
  const auto other = GetParam().make(1);
  const RolloutSegment again = run_rollout(*other, stranger, task, {}, actions)[0];
  EXPECT_EQ(again.state_hashes, recorded.state_hashes);
  EXPECT_EQ(again.observations, recorded.observations);
  EXPECT_EQ(again.rewards, recorded.rewards);
  EXPECT_EQ(again.frame_positions_in_world_m, recorded.frame_positions_in_world_m);
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
