#pragma once

#include <gtest/gtest.h>

#include "learner/task_book.h"
#include "tests/learner/fake_rollout.h"

namespace omentum::test {

/// Six slots, segments of 20 steps of the counter environment.
inline TaskBookConfig small_config(std::uint32_t lead) {
  TaskBookConfig config;
  config.run_seed = 7;
  config.config_hash = 99;
  config.learner_epoch = 1;
  config.slots = 6;
  config.steps = 20;
  config.lead = lead;
  config.episode_decisions = 50;
  config.state_format = 4;
  config.shape = fake_shape();
  return config;
}

inline Sha256 hash_of_version(std::uint64_t version) {
  Sha256 hash{};
  hash[0] = static_cast<std::uint8_t>(version + 1);
  return hash;
}

inline void expect_balance(const TaskBook& book) {
  const Result<void> ok = book.check_balance();
  ASSERT_TRUE(ok) << ok.error();
}

}  // namespace omentum::test
