#pragma once

#include <memory>
#include <string>

#include "core/checkpoint_file.h"
#include "core/policy.h"

namespace omentum {

/// Where the policy of the gateway comes from. One version is pinned for an episode; another is
/// taken between two only. One thread.
class PolicySource {
 public:
  PolicySource() = default;
  virtual ~PolicySource() = default;
  PolicySource(const PolicySource&) = delete;
  PolicySource& operator=(const PolicySource&) = delete;

  /// Of the run; never changes.
  virtual const pb::Config& config() const = 0;
  /// The policy of the episode that begins now. Valid until the next call.
  virtual Policy& for_next_episode() = 0;
};

/// Weights as a policy for the observations and actions of a configuration. Throws Error: one line
/// that begins with `name` where they do not fit.
std::unique_ptr<Policy> fitting_policy(const std::string& name, const pb::Config& config,
                                       const PolicyWeights& weights);

/// One version for all episodes: of a checkpoint, or of a run folder.
class FilePolicySource final : public PolicySource {
 public:
  /// Throws Error where they do not fit.
  explicit FilePolicySource(SavedPolicy saved);

  const pb::Config& config() const override { return saved_.config; }
  Policy& for_next_episode() override { return *policy_; }

 private:
  SavedPolicy saved_;
  std::unique_ptr<Policy> policy_;
};

}  // namespace omentum
