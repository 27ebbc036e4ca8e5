#include "learner/segment_check.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "core/hash.h"
#include "core/segment_fields.h"
#include "learner/initialise.h"
#include "tests/learner/fake_rollout.h"
#include "tests/learner/toy.h"

namespace omentum {
namespace {

using Damage = std::pair<const char*, std::function<void(RolloutSegment&)>>;

struct Checked {
  PolicyShape shape;
  std::vector<RolloutTask> tasks;
  std::vector<RolloutSegment> segments;
};

/// The second segments of three slots: 45 steps, episodes of 20 that the first segments began.
template <typename Environment>
Checked collect_checked(bool continuous) {
  Checked c;
  c.shape.observations = 6;
  c.shape.continuous = continuous;
  if (!continuous) c.shape.branches = {3, 3, 3, 2};
  c.shape.hidden = 32;
  PolicyWeights weights;
  weights.parameters = initial_parameters(c.shape, pb::Ppo(), 1);
  Policy policy(c.shape, weights);
  toy::Slots<Environment> slots(1, 3, 20);
  for (int batch = 0; batch < 2; ++batch) {
    c.tasks.clear();
    c.segments = slots.collect(policy, 45, &c.tasks);
  }
  return c;
}

/// What a faulty worker would send: the damage, and hashes that fit it.
RolloutSegment damaged(RolloutSegment segment, const Damage& damage) {
  damage.second(segment);
  segment.end_hash = hash_state(segment.end_state);
  segment.payload_crc32c = segment_crc(segment);
  return segment;
}

void expect_refused(const RolloutSegment& segment, const PolicyShape& shape,
                    const RolloutTask& task, const std::vector<Damage>& damages) {
  ASSERT_TRUE(check_segment(segment, shape, task)) << check_segment(segment, shape, task).error();
  for (const Damage& damage : damages) {
    const Result<void> result = check_segment(damaged(segment, damage), shape, task);
    EXPECT_FALSE(result) << damage.first;
    EXPECT_NE(result.error(), "CRC") << damage.first;
    EXPECT_EQ(result.error().find('\n'), std::string::npos) << damage.first;
  }
}

TEST(CheckSegment, AcceptsWhatTheLoopMakes) {
  for (const Checked& c :
       {collect_checked<toy::Reach>(false), collect_checked<toy::ContinuousReach>(true)}) {
    for (std::size_t i = 0; i < c.tasks.size(); ++i) {
      const Result<void> result = check_segment(c.segments[i], c.shape, c.tasks[i]);
      EXPECT_TRUE(result) << result.error();
    }
  }
}

TEST(CheckSegment, RefusesEveryDamage) {
  const Checked c = collect_checked<toy::Reach>(false);
  const std::vector<Damage> damages = {
      {"slot", [](RolloutSegment& s) { ++s.slot; }},
      {"segment", [](RolloutSegment& s) { ++s.segment; }},
      {"hash", [](RolloutSegment& s) { ++s.task_hash; }},
      {"version", [](RolloutSegment& s) { ++s.policy_version; }},
      {"state format", [](RolloutSegment& s) { ++s.state_format; }},
      {"failed", [](RolloutSegment& s) { s.failed = 2; }},
      {"of a robot", [](RolloutSegment& s) { s.source = Source::kDvrk; }},
      {"too few steps", [](RolloutSegment& s) { --s.steps; }},
      {"too many steps", [](RolloutSegment& s) { ++s.steps; }},
      {"steps", [](RolloutSegment& s) { s.steps = 0xffffffff; }},
      {"observations", [](RolloutSegment& s) { s.observations.pop_back(); }},
      {"no observations", [](RolloutSegment& s) { s.observations.clear(); }},
      {"observation nan", [](RolloutSegment& s) { s.observations[7] = std::nanf(""); }},
      {"bootstrap", [](RolloutSegment& s) { s.bootstrap_observation.clear(); }},
      {"final", [](RolloutSegment& s) { s.final_observations.push_back(0); }},
      {"no final", [](RolloutSegment& s) { s.final_observations.clear(); }},
      {"one final", [](RolloutSegment& s) { s.final_observations.resize(6); }},
      {"actions", [](RolloutSegment& s) { s.actions.pop_back(); }},
      {"no actions", [](RolloutSegment& s) { s.actions.clear(); }},
      {"action range", [](RolloutSegment& s) { s.actions[2] = 3; }},
      {"gripper range", [](RolloutSegment& s) { s.actions[3] = 2; }},
      {"continuous", [](RolloutSegment& s) { s.actions_continuous.assign(s.steps * 4, 0.0F); }},
      {"log-prob",
       [](RolloutSegment& s) { s.log_probs[1] = std::numeric_limits<float>::infinity(); }},
      {"log-probs", [](RolloutSegment& s) { s.log_probs.push_back(0); }},
      {"reward", [](RolloutSegment& s) { s.rewards[1] = std::nanf(""); }},
      {"rewards", [](RolloutSegment& s) { s.rewards.clear(); }},
      {"values", [](RolloutSegment& s) { s.values.clear(); }},
      {"flags", [](RolloutSegment& s) { s.flags.pop_back(); }},
      {"unknown flag", [](RolloutSegment& s) { s.flags[1] |= 128; }},
      {"scripted", [](RolloutSegment& s) { s.flags[1] |= step_flag::kScripted; }},
      {"first flag", [](RolloutSegment& s) { s.flags[1] |= step_flag::kFirst; }},
      {"hidden end", [](RolloutSegment& s) { s.flags[1] |= step_flag::kTerminated; }},
      {"both ends",
       [](RolloutSegment& s) { s.flags[s.episode_end_step[0]] |= step_flag::kTerminated; }},
      {"end step", [](RolloutSegment& s) { ++s.episode_end_step[0]; }},
      {"end step beyond", [](RolloutSegment& s) { s.episode_end_step[1] = s.steps; }},
      {"one more end", [](RolloutSegment& s) { s.episode_end_step.push_back(1); }},
      {"length", [](RolloutSegment& s) { ++s.episode_length[0]; }},
      {"lengths", [](RolloutSegment& s) { s.episode_length.pop_back(); }},
      {"outcome", [](RolloutSegment& s) { s.episode_outcome[0] = 9; }},
      {"outcomes", [](RolloutSegment& s) { s.episode_outcome.clear(); }},
      {"return", [](RolloutSegment& s) { s.episode_return[0] = std::nan(""); }},
      {"returns", [](RolloutSegment& s) { s.episode_return.pop_back(); }},
      {"exposure", [](RolloutSegment& s) { s.episode_exposure.clear(); }},
      {"grasped", [](RolloutSegment& s) { s.episode_grasped.clear(); }},
      {"held", [](RolloutSegment& s) { s.episode_held.clear(); }},
      {"grasp position", [](RolloutSegment& s) { s.episode_grasp_position_in_world_m.pop_back(); }},
      {"start position", [](RolloutSegment& s) { s.episode_start_position_in_world_m.pop_back(); }},
      {"start nan",
       [](RolloutSegment& s) { s.episode_start_position_in_world_m[0] = std::nanf(""); }},
      {"episode", [](RolloutSegment& s) { ++s.end_episode; }},
      {"episode step", [](RolloutSegment& s) { ++s.end_episode_step; }},
      {"end state", [](RolloutSegment& s) { s.end_state.clear(); }},
      {"hashes", [](RolloutSegment& s) { s.state_hashes.push_back(0); }},
      {"frames", [](RolloutSegment& s) { s.frame_positions_in_world_m.push_back(0); }},
      {"tool", [](RolloutSegment& s) { s.tool_positions_in_world_m.push_back(0); }},
      {"exposures", [](RolloutSegment& s) { s.exposures.push_back(0); }},
  };
  expect_refused(c.segments[1], c.shape, c.tasks[1], damages);
}

TEST(CheckSegment, AGaussianHeadHasNumbersInPlaceOfBranches) {
  const Checked c = collect_checked<toy::ContinuousReach>(true);
  expect_refused(c.segments[1], c.shape, c.tasks[1],
                 {{"none", [](RolloutSegment& s) { s.actions_continuous.clear(); }},
                  {"one less", [](RolloutSegment& s) { s.actions_continuous.pop_back(); }},
                  {"nan", [](RolloutSegment& s) { s.actions_continuous[3] = std::nanf(""); }},
                  {"branch", [](RolloutSegment& s) { s.actions[1] = 1; }}});
}

TEST(CheckSegment, AFlippedBitOfAnythingIsSeen) {
  const Checked c = collect_checked<toy::Reach>(false);
  RolloutSegment segment = c.segments[1];
  segment.rewards[5] += 1;
  EXPECT_EQ(check_segment(segment, c.shape, c.tasks[1]).error(), "CRC");
  segment = c.segments[1];
  segment.end_state[3] ^= std::byte{4};
  EXPECT_FALSE(check_segment(segment, c.shape, c.tasks[1]));
}

// The task book skips as many episodes as a failed segment says it began.
TEST(CheckSegment, AFailedSegmentEndsEarlyAndCountsItsEpisodes) {
  const Checked c = collect_checked<toy::Reach>(false);
  RolloutSegment failed = c.segments[1];
  failed.failed = 1;
  failed.steps = 18;  // one episode ended after 15
  for_each_array(failed, [](auto& array, const ArrayField& field) {
    if (field.rows == Rows::kStep) array.resize(array.size() / 45 * 18);
    if (field.rows == Rows::kEpisode) array.resize(field.width);
    if (field.rows == Rows::kTruncation) array.resize(6);
    if (field.rows == Rows::kEnd || field.rows == Rows::kState) array.clear();
  });
  failed = damaged(failed, {"", [](RolloutSegment&) {}});
  expect_refused(failed, c.shape, c.tasks[1],
                 {{"more steps than asked for", [](RolloutSegment& s) { s.steps = 46; }},
                  {"no such end",
                   [](RolloutSegment& s) {
                     for_each_array(s, [](auto& array, const ArrayField& field) {
                       if (field.rows == Rows::kEpisode) array.resize(2 * field.width);
                     });
                   }},
                  {"hidden end", [](RolloutSegment& s) { s.flags[12] |= step_flag::kTerminated; }},
                  {"final", [](RolloutSegment& s) { s.final_observations.clear(); }}});
}

TEST(CheckSegment, AnEvaluationIsOneEpisodeWithWholeFrames) {
  RolloutTask task;
  task.kind = TaskKind::kEvaluate;
  task.reset = true;
  task.steps = 30;
  task.policy_steps = 30;
  task.frame_stride = 7;
  task.task_hash = hash_task(task);
  const std::vector<Damage> damages = {
      {"no episode",
       [](RolloutSegment& s) {
         for_each_array(s, [](auto& array, const ArrayField& field) {
           if (field.rows == Rows::kEpisode) array.clear();
         });
       }},
      {"end", [](RolloutSegment& s) { s.episode_end_step[0] = 3; }},
      {"no outcome", [](RolloutSegment& s) { s.episode_outcome.clear(); }},
      {"outcome", [](RolloutSegment& s) { s.episode_outcome[0] = 5; }},
      {"no held", [](RolloutSegment& s) { s.episode_held.clear(); }},
      {"no start", [](RolloutSegment& s) { s.episode_start_position_in_world_m.clear(); }},
      {"flags", [](RolloutSegment& s) { s.flags[2] = 64; }},
      {"final", [](RolloutSegment& s) { s.final_observations.assign(3, 0); }},
      {"action", [](RolloutSegment& s) { s.actions[2] = 3; }},
      {"frames", [](RolloutSegment& s) { s.frame_positions_in_world_m.pop_back(); }},
      {"frame missing",
       [](RolloutSegment& s) {
         s.frame_positions_in_world_m.resize(s.frame_positions_in_world_m.size() - 6);
       }},
      {"hashes", [](RolloutSegment& s) { s.state_hashes.pop_back(); }},
      {"tool", [](RolloutSegment& s) { s.tool_positions_in_world_m.clear(); }},
      {"exposure nan", [](RolloutSegment& s) { s.exposures[1] = std::nanf(""); }},
      {"steps", [](RolloutSegment& s) { s.steps = 31; }},
      {"nothing",
       [](RolloutSegment& s) {
         s.steps = 0;
         for_each_array(s, [](auto& array, const ArrayField& field) {
           if (field.rows == Rows::kStep || field.rows == Rows::kRecordedStep) array.clear();
         });
       }},
  };
  expect_refused(test::fake_rollout(task), test::fake_shape(), task, damages);
}

}  // namespace
}  // namespace omentum
