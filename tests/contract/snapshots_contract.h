#pragma once

// What every back end with Snapshots promises (core/backend.h) beside contract/backend_contract.h:
// its environments are pure functions of their states. Instantiate with the same cases.

#include "contract/backend_contract.h"

namespace omentum::test {

class SnapshotsContract : public BackendContract {};

TEST_P(SnapshotsContract, LaneEqualsARunAlone) {
  const auto many = GetParam().make(5);
  const auto one = GetParam().make(1);
  for (int lane = 0; lane < 5; ++lane)
    many->reset(lane, training_start(static_cast<std::uint32_t>(lane)));
  play(*many, 0, 0, 40);
  for (int lane = 0; lane < 5; ++lane) {
    one->reset(0, training_start(static_cast<std::uint32_t>(lane)));
    play(*one, static_cast<std::uint32_t>(lane), 0, 40);
    EXPECT_EQ(one->snapshots()->save(0), many->snapshots()->save(lane)) << "lane " << lane;
  }
}

TEST_P(SnapshotsContract, SaveLoadContinueEqualsContinue) {
  const auto through = GetParam().make(1);
  through->reset(0, training_start(3));
  play(*through, 3, 0, 25);
  const Bytes middle = through->snapshots()->save(0);
  play(*through, 3, 25, 25);
  const auto resumed = GetParam().make(3);
  ASSERT_TRUE(resumed->snapshots()->load(0, middle).has_value());
  EXPECT_EQ(resumed->snapshots()->save(0), middle);
  play(*resumed, 3, 25, 25);
  EXPECT_EQ(resumed->snapshots()->save(0), through->snapshots()->save(0));
}

TEST_P(SnapshotsContract, ResetLeavesNoTrace) {
  const auto used = GetParam().make(2);
  const auto fresh = GetParam().make(2);
  play(*used, 9, 0, 30);
  used->reset(1, training_start(4));
  fresh->reset(1, training_start(4));
  EXPECT_EQ(used->snapshots()->save(1), fresh->snapshots()->save(1));
}

TEST_P(SnapshotsContract, ResetOfOneLaneLeavesOthers) {
  const auto backend = GetParam().make(3);
  play(*backend, 0, 0, 10);
  const Bytes before0 = backend->snapshots()->save(0);
  const Bytes before2 = backend->snapshots()->save(2);
  backend->reset(1, training_start(8));
  EXPECT_EQ(backend->snapshots()->save(0), before0);
  EXPECT_EQ(backend->snapshots()->save(2), before2);
}

TEST_P(SnapshotsContract, LoadRefusesEveryPrefixAndChangesNothing) {
  const auto backend = GetParam().make(1);
  backend->reset(0, training_start(1));
  play(*backend, 1, 0, 5);
  const Bytes state = backend->snapshots()->save(0);
  const Bytes other = [&] {
    const auto second = GetParam().make(1);
    second->reset(0, training_start(2));
    return second->snapshots()->save(0);
  }();
  // Every short prefix and then in strides: a state has tens of thousands of bytes.
  for (std::size_t size = 0; size < other.size(); size += size < 300 ? 1 : 97) {
    EXPECT_FALSE(backend->snapshots()->load(0, std::span(other).first(size)).has_value()) << size;
    ASSERT_EQ(backend->snapshots()->save(0), state) << size;
  }
}

TEST_P(SnapshotsContract, SegmentIsAPureFunctionOfItsTask) {
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

TEST_P(SnapshotsContract, TwoHalvesEqualOneWhole) {
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

TEST_P(SnapshotsContract, ReplayOfRecordedActionsDerivesTheSameHashesAndRewards) {
  Policy policy = make_policy(GetParam().shape);
  const auto backend = GetParam().make(2);
  auto task = make_tasks(1, 40);
  task[0].frame_stride = 10;
  task[0].kind = TaskKind::kEvaluate;
  task[0].policy_steps = 40;
  task[0].hold_steps = 3;
  const RolloutSegment recorded = run_rollout(*backend, policy, task, {})[0];
  ASSERT_EQ(recorded.state_hashes.size(), recorded.steps);
  const Actor replay(
      [&recorded](std::uint32_t step, std::span<Action> actions) {
        const std::size_t columns = recorded.actions.size() / recorded.steps;
        for (std::size_t k = 0; k < columns; ++k)
          actions[0].branch[k] = recorded.actions[columns * step + k];
        for (std::size_t k = 0; k < 4 && !recorded.actions_continuous.empty(); ++k)
          actions[0].continuous[k] = recorded.actions_continuous[std::size_t{4} * step + k];
      },
      GetParam().shape.continuous);
  task[0].steps = recorded.steps;
  const auto other = GetParam().make(1);
  const RolloutSegment again = run_rollout(*other, replay, task, {})[0];
  EXPECT_EQ(again.state_hashes, recorded.state_hashes);
  EXPECT_EQ(again.observations, recorded.observations);
  EXPECT_EQ(again.rewards, recorded.rewards);
  EXPECT_EQ(again.frame_positions_in_world_m, recorded.frame_positions_in_world_m);
}

}  // namespace omentum::test
