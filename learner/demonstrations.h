#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "learner/batch.h"
#include "proto/config.pb.h"

namespace omentum {

/// Episodes that somebody else acted in, for Ppo::clone.
struct Demonstrations {
  /// One slot, the episodes one after the other; the last step of each has kTerminated or
  /// kTruncated. Observations, actions, rewards and flags alone.
  Batch batch;
  std::size_t episodes = 0;
  std::vector<std::string> left_out;  ///< files whose episode did not reach p_T
};

/// Reads the recordings (*.mcap) of a folder, or of its recordings/, in order of name. Throws
/// Error, one line with the file and what is wrong with it: none there, damaged or cut off, an
/// episode that failed or ran on a robot, numbers that are not finite, a scene, task or grasp that
/// differs from those of `config`, and none that reached p_T.
Demonstrations read_demonstrations(const std::string& folder, const pb::Config& config);

}  // namespace omentum
