#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>

#include "core/result.h"
#include "core/types.h"

namespace omentum {

/// One decision for one environment. Discrete heads fill `branch` (x, y, z, gripper, roll, pitch,
/// yaw indices of the preset's action table); the Gaussian head fills `continuous`: increment in
/// units of task.increment_m, clipped to [-1, 1] per axis, and jaw, closed when > 0.
struct Action {
  std::array<std::uint8_t, kActionBranches> branch{};
  std::array<float, 4> continuous{};
};

/// Result of one decision. The reward is of the state before the motion (docs/task.md 7).
struct StepOutcome {
  float reward = 0;
  bool terminated = false;
  bool truncated = false;
  bool held_before = false;
  bool grasp_lost = false;
  bool stopped = false;  ///< the episode ends here by a stop: Backend::failure() says why
  bool ended = false;    ///< the episode ends here, and that is no failure
};

/// Facts of the running episode, for evaluation and summaries. Positions in W [m].
struct EpisodeFacts {
  std::uint64_t episode = 0;
  std::uint32_t episode_step = 0;
  std::uint32_t episode_limit = 0;
  bool held = false;
  bool grasped_ever = false;
  bool reached = false;  ///< held and within success_radius of p_T at some step
  bool lost_ever = false;
  float exposure = 0;  ///< of the present state, by the reward's samples
  double episode_return = 0;
  std::array<double, 3> start_position{};
  std::array<double, 3> grasp_position{};
  std::array<double, 3> tool_position{};
};

/// Which episode to begin.
struct EpisodeStart {
  std::uint64_t run_seed = 0;
  std::uint32_t slot = 0;
  std::uint64_t episode = 0;
  std::uint32_t episode_limit = 0;  ///< 0 = task default
  StartSet start_set = StartSet::kTraining;
  std::uint32_t start_index = 0;
  /// The lane just finished an episode of the same slot; read by named defects only.
  bool follows_episode = false;
};

/// The episode that a task begins.
inline EpisodeStart start_of(const RolloutTask& task) {
  EpisodeStart start;
  start.run_seed = task.run_seed;
  start.slot = task.slot;
  start.episode = task.episode;
  start.episode_limit = task.episode_limit;
  start.start_set = task.start_set;
  start.start_index = task.start_index;
  return start;
}

/// The states of a back end's environments as bytes: what a simulation has and a robot lacks. With
/// it a rollout is a pure function of its task. Contract test: tests/contract/snapshots_contract.h.
class Snapshots {
 public:
  virtual ~Snapshots() = default;

  /// Of the bytes of save() and load(); reaches wire and disk. Never 0.
  virtual std::uint32_t state_format() const = 0;
  /// The whole state of one lane, canonical bytes (independent of lane count and position).
  virtual Bytes save(int lane) const = 0;
  /// Restores a state written by save(). Fails, changing nothing, on a state of another format or
  /// size.
  virtual Result<void> load(int lane, std::span<const std::byte> state) = 0;
  /// Particle positions in W [m], x y z interleaved, in the place of what `out` held; for frames of
  /// recordings.
  virtual void positions(int lane, std::vector<float>& out) const = 0;
};

/// A set of `lanes()` environments that advance together: a simulation, a robot or a replay. Lane
/// k's results never depend on other lanes. One thread at a time. Contract test:
/// tests/contract/backend_contract.h.
class Backend {
 public:
  virtual ~Backend() = default;

  virtual int lanes() const = 0;
  virtual int observation_size() const = 0;
  /// Entries of an action in its segments: action_columns() of its task.
  virtual std::size_t columns() const { return action_columns(0); }

  // Everywhere 0 <= lane < lanes(), which is not checked.

  /// Begins an episode, independent of what the lane held before.
  virtual void reset(int lane, const EpisodeStart& start) = 0;
  /// Writes observation_size() raw values; a span of another size aborts in a simulation.
  virtual void observe(int lane, std::span<float> observation) const = 0;
  /// Advances every lane by one decision. Spans have lanes() entries.
  virtual void step(std::span<const Action> actions, std::span<StepOutcome> outcomes) = 0;

  /// All facts, the exposure of the present state included (that costs a projection of the
  /// surface).
  virtual EpisodeFacts facts(int lane) const = 0;
  /// The same without the exposure: cheap, for every step.
  virtual EpisodeFacts clock(int lane) const = 0;
  /// The tool stands at p_T as near as the action table can bring it.
  virtual bool at_target(int lane) const = 0;
  /// Action of the hold script: jaw closed, straight towards p_T, then stay.
  virtual Action hold_action(int lane) const = 0;
  /// False once the state of the lane went non-finite; the other lanes are untouched.
  virtual bool healthy(int lane) const = 0;
  /// Why the lane is not healthy or was stopped.
  virtual std::string failure(int /*lane*/) const { return "state not finite"; }
  /// Solver substeps per decision, for step accounting.
  virtual std::uint32_t ticks_per_step() const = 0;

  /// Who makes the segments; those of a robot are never trained on.
  virtual Source source() const { return Source::kSimulation; }
  /// Null for a back end whose states cannot be saved.
  virtual Snapshots* snapshots() { return nullptr; }
};

}  // namespace omentum
