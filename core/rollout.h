#pragma once

#include <functional>
#include <span>
#include <vector>

#include "core/backend.h"
#include "core/policy.h"
#include "core/types.h"

namespace omentum {

/// Chooses the actions of one decision, of lane k in actions[k]. May read the back end, which is in
/// the state before the step, but not change it. There are as many actions as tasks.
using Script = std::function<void(std::uint32_t step, std::span<Action> actions)>;

/// Who acts in a rollout: a policy, or a script (a replay of recorded actions, a study). Under a
/// script a task is one episode of exactly `steps` decisions, unless the back end ends it: no hold
/// at p_T, no next episode, no end state.
class Actor {
 public:
  Actor(Policy& policy) : policy_(&policy) {}  // NOLINT(google-explicit-constructor)
  /// `continuous`: the script fills Action::continuous.
  Actor(Script script, bool continuous) : script_(std::move(script)), continuous_(continuous) {}

  bool scripted() const { return policy_ == nullptr; }
  bool continuous() const { return scripted() ? continuous_ : policy_->shape().continuous; }
  /// Observations of so many numbers can be acted upon by actions of so many entries.
  bool takes(int observations, std::size_t columns) const {
    return scripted() ||
           (policy_->shape().observations == observations && policy_->shape().columns() == columns);
  }
  /// Decides for the tasks of a rollout; under a script log-probability and value are 0.
  void act(std::uint32_t step, std::span<const float> observations,
           std::span<const ActionCounter> counters, bool greedy,
           std::span<Decision> decisions) const;

 private:
  Policy* policy_ = nullptr;
  Script script_;
  bool continuous_ = false;
};

/// The one rollout loop. Runs `tasks` (1 ... backend.lanes(), else it aborts; all of the same
/// policy version, kind and length, and greedy or not alike) to their end and returns one segment
/// per task in the same order. segment = run_task(policy, task): the result of a task does not
/// depend on the other tasks, the backend's lane count, or anything outside the arguments (a
/// robot's does: a lane that it stops ends its task there, failed, with the steps that were done).
/// `stop` is polled once per step; when it turns true the loop returns an empty vector (nothing
/// half-done). A back end without Snapshots runs tasks that begin with a reset; its segments have
/// no states, hashes or frames. Aborts unless actor.takes() what the back end observes. One thread
/// at a time for back end and policy.
std::vector<RolloutSegment> run_rollout(Backend& backend, const Actor& actor,
                                        std::span<const RolloutTask> tasks,
                                        const std::function<bool()>& stop);

}  // namespace omentum
