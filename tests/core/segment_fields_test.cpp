#include "core/segment_fields.h"

#include <gtest/gtest.h>

#include <array>
#include <set>
#include <span>
#include <string>

#include "core/hash.h"
#include "core/wire.h"

namespace omentum {
namespace {

/// Every array two to five entries long, every number another one.
RolloutSegment filled() {
  RolloutSegment segment;
  segment.slot = 1;
  segment.segment = 2;
  segment.grant = 3;
  segment.worker_id = 4;
  segment.learner_epoch = 5;
  segment.task_hash = 6;
  segment.policy_version = 7;
  segment.build_id = 8;
  segment.steps = 9;
  segment.end_episode = 10;
  segment.end_episode_step = 11;
  segment.end_episode_limit = 12;
  segment.state_format = 13;
  segment.end_hash = 14;
  segment.failed = 15;
  segment.physics_ticks = 16;
  int count = 20;
  for_each_array(segment, [&count](auto& array, const ArrayField& /*about*/) {
    using Entry = typename std::decay_t<decltype(array)>::value_type;
    for (int k = count % 4; k < 6; ++k) array.push_back(static_cast<Entry>(++count));
  });
  return segment;
}

// The order and the choice are part of the wire: a segment of an older build has this CRC.
TEST(SegmentCrc, IsOfTwelveNumbersAndAllArraysInWireOrder) {
  const RolloutSegment s = filled();
  const std::array<std::uint64_t, 12> head = {
      s.slot,         s.segment,     s.task_hash,        s.policy_version,
      s.steps,        s.end_episode, s.end_episode_step, s.end_episode_limit,
      s.state_format, s.end_hash,    s.failed,           s.physics_ticks};
  std::uint32_t crc = 0;
  const auto add = [&crc](const auto& values) {
    crc = crc32c(std::as_bytes(std::span(values)), crc);
  };
  add(head);
  add(s.observations);
  add(s.actions);
  add(s.actions_continuous);
  add(s.log_probs);
  add(s.rewards);
  add(s.values);
  add(s.flags);
  add(s.bootstrap_observation);
  add(s.final_observations);
  add(s.episode_end_step);
  add(s.episode_return);
  add(s.episode_length);
  add(s.episode_outcome);
  add(s.episode_exposure);
  add(s.episode_grasped);
  add(s.episode_held);
  add(s.episode_grasp_position_in_world_m);
  add(s.episode_start_position_in_world_m);
  add(s.end_state);
  add(s.state_hashes);
  add(s.frame_positions_in_world_m);
  add(s.tool_positions_in_world_m);
  add(s.exposures);
  EXPECT_EQ(segment_crc(s), crc);
}

TEST(SegmentCrc, LeavesOutWhoComputedItAndWhen) {
  const RolloutSegment before = filled();
  RolloutSegment s = before;
  s.grant = s.worker_id = s.learner_epoch = s.payload_crc32c = 99;
  s.build_id = 99;
  s.source = Source::kDvrk;
  s.failure = "why";
  s.compute_time_ns = s.wait_time_ns = s.granted_at_ns = 99;
  EXPECT_EQ(segment_crc(s), segment_crc(before));
}

TEST(SegmentFields, EveryArrayIsInCrcAndBytesAndHasANameOfItsOwn) {
  const RolloutSegment before = filled();
  std::set<std::string> names;
  for_each_array(before, [&](const auto& /*array*/, const ArrayField& which) {
    EXPECT_TRUE(names.insert(which.name).second) << which.name;
    RolloutSegment changed = before;
    for_each_array(changed, [&](auto& array, const ArrayField& about) {
      using Entry = typename std::decay_t<decltype(array)>::value_type;
      if (std::string(about.name) == which.name) array.push_back(Entry{});
    });
    EXPECT_NE(segment_crc(changed), segment_crc(before)) << which.name;
    EXPECT_GT(wire_bytes(changed), wire_bytes(before)) << which.name;
  });
  EXPECT_EQ(names.size(), 23u);
}

}  // namespace
}  // namespace omentum
