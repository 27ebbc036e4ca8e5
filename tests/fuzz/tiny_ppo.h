#pragma once

#include <memory>

#include "learner/ppo.h"

namespace omentum::test {

/// The smallest learner there is: two observations, one branch of three actions. Its state is what
/// the checkpoint corpus holds.
inline std::unique_ptr<Ppo> make_tiny_ppo() {
  pb::Config config;
  config.mutable_ppo()->set_hidden(8);
  PolicyShape shape;
  shape.observations = 2;
  shape.branches = {3};
  shape.hidden = 8;
  return std::make_unique<Ppo>(config, shape, 1);
}

}  // namespace omentum::test
