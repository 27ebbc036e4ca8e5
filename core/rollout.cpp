#include "core/rollout.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/clock.h"
#include "core/hash.h"
#include "core/segment_fields.h"

namespace omentum {
namespace {

/// What one lane is doing with its task.
struct LaneRun {
  bool rollout = false;     ///< one episode follows the other, and the state at the end goes on
  bool evaluation = false;  ///< one episode; at p_T the hold script replaces the policy
  bool done = false;        ///< no more steps are recorded
  bool holding = false;     ///< the hold script acts
  std::uint32_t hold_left = 0;
};

void append(auto& array, const auto& values) {
  array.insert(array.end(), values.begin(), values.end());
}

void fail(RolloutSegment& segment, LaneRun& run, const std::string& reason) {
  segment.failed = 1;
  segment.failure = reason;
  run.done = true;
}

Outcome outcome_of(const EpisodeFacts& facts, const StepOutcome& last) {
  if (last.stopped) return Outcome::kSafetyStop;
  if (facts.reached || last.terminated) return Outcome::kTargetReached;
  return facts.lost_ever ? Outcome::kGraspLost : Outcome::kTruncated;
}

void close_episode(const Backend& backend, int lane, const StepOutcome& last,
                   RolloutSegment& segment) {
  const EpisodeFacts facts = backend.facts(lane);
  segment.episode_end_step.push_back(segment.steps - 1);
  segment.episode_return.push_back(facts.episode_return);
  segment.episode_length.push_back(facts.episode_step);
  segment.episode_outcome.push_back(static_cast<std::uint8_t>(outcome_of(facts, last)));
  segment.episode_exposure.push_back(facts.exposure);
  segment.episode_grasped.push_back(facts.grasped_ever ? 1 : 0);
  segment.episode_held.push_back(facts.held ? 1 : 0);
  for (std::size_t k = 0; k < 3; ++k) {
    segment.episode_grasp_position_in_world_m.push_back(
        static_cast<float>(facts.grasp_position[k]));
    segment.episode_start_position_in_world_m.push_back(
        static_cast<float>(facts.start_position[k]));
  }
}

/// The tissue before this step, every `stride` steps.
void record_frame(Backend& backend, int lane, std::uint32_t stride, std::vector<float>& scratch,
                  RolloutSegment& segment) {
  const Snapshots* states = backend.snapshots();
  if (states == nullptr || stride == 0 || segment.steps % stride != 0) return;
  states->positions(lane, scratch);
  append(segment.frame_positions_in_world_m, scratch);
}

/// What proves a replay: hash of the whole state after the step, beside where the tool is and what
/// the camera sees.
void record_step(Backend& backend, int lane, RolloutSegment& segment) {
  const EpisodeFacts facts = backend.facts(lane);
  if (const Snapshots* states = backend.snapshots(); states != nullptr)
    segment.state_hashes.push_back(hash_state(states->save(lane)));
  segment.exposures.push_back(facts.exposure);
  for (const double v : facts.tool_position)
    segment.tool_positions_in_world_m.push_back(static_cast<float>(v));
}

/// Resets the lane or loads the state that its task starts from.
Result<void> start_lane(Backend& backend, int lane, const RolloutTask& task) {
  if (task.reset) {
    backend.reset(lane, start_of(task));
    return {};
  }
  if (backend.snapshots() == nullptr)
    return Failure{"task continues from a state, and this back end cannot load one"};
  return backend.snapshots()->load(lane, task.start_state);
}

}  // namespace

void Actor::act(std::uint32_t step, std::span<const float> observations,
                std::span<const ActionCounter> counters, bool greedy,
                std::span<Decision> decisions) const {
  if (!scripted()) {
    policy_->act(observations, counters, greedy, decisions);
    return;
  }
  std::vector<Action> actions(decisions.size());
  script_(step, actions);
  for (std::size_t k = 0; k < decisions.size(); ++k)
    decisions[k] = {actions[k].branch, actions[k].continuous};
}

std::vector<RolloutSegment> run_rollout(Backend& backend, const Actor& actor,
                                        std::span<const RolloutTask> tasks,
                                        const std::function<bool()>& stop) {
  const auto lanes = static_cast<std::size_t>(backend.lanes());
  OMENTUM_CHECK(!tasks.empty() && tasks.size() <= lanes, "{} tasks for {} lanes", tasks.size(),
                lanes);
  const auto width = static_cast<std::size_t>(backend.observation_size());
  OMENTUM_CHECK(actor.takes(backend.observation_size(), backend.columns()));
  const bool continuous = actor.continuous();
  const std::int64_t began = steady_now_ns();

  std::vector<RolloutSegment> segments(tasks.size());
  std::vector<LaneRun> runs(tasks.size());
  std::uint32_t longest = 0;
  for (std::size_t k = 0; k < tasks.size(); ++k) {
    const RolloutTask& task = tasks[k];
    RolloutSegment& segment = segments[k];
    segment.slot = task.slot;
    segment.segment = task.segment;
    segment.grant = task.grant;
    segment.worker_id = task.worker_id;
    segment.learner_epoch = task.learner_epoch;
    segment.task_hash = task.task_hash;
    segment.policy_version = task.policy_version;
    segment.weights_hash = task.weights_hash;
    segment.granted_at_ns = task.granted_at_ns;
    segment.source = backend.source();
    if (backend.snapshots() != nullptr) segment.state_format = backend.snapshots()->state_format();
    longest = std::max(longest, task.steps);
    if (const Result<void> started = start_lane(backend, static_cast<int>(k), task); !started)
      fail(segment, runs[k], started.error());
    runs[k].rollout = !actor.scripted() && task.kind == TaskKind::kRollout;
    runs[k].evaluation = !actor.scripted() && task.kind == TaskKind::kEvaluate;
    runs[k].holding = runs[k].evaluation && task.start_set == StartSet::kGraspLattice;
    runs[k].hold_left = task.hold_steps;
  }

  std::vector<float> observations(tasks.size() * width);
  std::vector<ActionCounter> counters(tasks.size());
  std::vector<Decision> decisions(tasks.size());
  std::vector<Action> actions(lanes);
  std::vector<StepOutcome> outcomes(lanes);
  std::vector<EpisodeFacts> before(tasks.size());
  std::vector<float> scratch;
  for (std::uint32_t step = 0; step < longest; ++step) {
    if (stop && stop()) return {};
    if (std::all_of(runs.begin(), runs.end(), [](const LaneRun& run) { return run.done; })) break;

    for (std::size_t k = 0; k < tasks.size(); ++k) {
      backend.observe(static_cast<int>(k), std::span(observations).subspan(k * width, width));
      before[k] = backend.clock(static_cast<int>(k));
      const Purpose purpose =
          tasks[k].kind == TaskKind::kRollout ? Purpose::kAction : Purpose::kEvaluation;
      counters[k] = {tasks[k].run_seed, tasks[k].slot, before[k].episode, before[k].episode_step,
                     purpose};
    }
    actor.act(step, observations, counters, tasks.front().greedy, decisions);
    for (std::size_t k = 0; k < tasks.size(); ++k) {
      actions[k] = {decisions[k].branch, decisions[k].continuous};
      if (runs[k].holding || runs[k].done) actions[k] = backend.hold_action(static_cast<int>(k));
      if (!runs[k].done)
        record_frame(backend, static_cast<int>(k), tasks[k].frame_stride, scratch, segments[k]);
    }
    backend.step(actions, outcomes);

    for (std::size_t k = 0; k < tasks.size(); ++k) {
      const RolloutTask& task = tasks[k];
      LaneRun& run = runs[k];
      RolloutSegment& segment = segments[k];
      const int lane = static_cast<int>(k);
      if (run.done) continue;
      if (!backend.healthy(lane)) {
        fail(segment, run,
             fmt::format("{} at step {} of episode {}", backend.failure(lane),
                         before[k].episode_step, before[k].episode));
        continue;
      }
      const StepOutcome& outcome = outcomes[k];
      const bool scripted = run.holding || actor.scripted();
      std::uint8_t flags = before[k].episode_step == 0 ? step_flag::kFirst : std::uint8_t{0};
      flags |= outcome.terminated ? step_flag::kTerminated : 0;
      flags |= outcome.truncated ? step_flag::kTruncated : 0;
      flags |= outcome.held_before ? step_flag::kHeld : 0;
      flags |= outcome.grasp_lost ? step_flag::kGraspLost : 0;
      flags |= scripted ? step_flag::kScripted : 0;
      append(segment.observations, std::span(observations).subspan(k * width, width));
      append(segment.actions, std::span(actions[k].branch).first(backend.columns()));
      if (continuous) append(segment.actions_continuous, actions[k].continuous);
      segment.log_probs.push_back(scripted ? 0.0F : decisions[k].log_prob);
      segment.values.push_back(decisions[k].value);
      segment.rewards.push_back(outcome.reward);
      segment.flags.push_back(flags);
      ++segment.steps;
      segment.physics_ticks += backend.ticks_per_step();
      if (task.frame_stride > 0) record_step(backend, lane, segment);
      if (outcome.stopped) {  // what was done stays
        close_episode(backend, lane, outcome, segment);
        fail(segment, run, backend.failure(lane));
        continue;
      }
      if (outcome.ended) {
        close_episode(backend, lane, outcome, segment);
        run.done = true;
        continue;
      }

      if (run.rollout) {
        if (outcome.truncated && !outcome.terminated) {
          segment.final_observations.resize(segment.final_observations.size() + width);
          backend.observe(lane, std::span(segment.final_observations).last(width));
        }
        if (outcome.terminated || outcome.truncated) {
          close_episode(backend, lane, outcome, segment);
          EpisodeStart next = start_of(task);
          next.episode = before[k].episode + 1;
          next.episode_limit = 0;
          next.follows_episode = true;
          backend.reset(lane, next);
        }
      } else if (run.evaluation) {
        const EpisodeFacts after = backend.clock(lane);
        if (run.holding) {
          // The hold counts from the arrival at p_T.
          const bool there = backend.at_target(lane);
          run.done = there && run.hold_left == 0;
          if (there && !run.done) --run.hold_left;
        } else if (after.reached || outcome.terminated) {
          run.holding = true;
        } else if (task.policy_steps > 0 && segment.steps >= task.policy_steps) {
          run.done = true;  // not arrived within policy_steps
        }
      }
      if (segment.steps >= task.steps) run.done = true;
      if (run.done && !run.rollout) {
        record_frame(backend, lane, task.frame_stride, scratch, segment);
        close_episode(backend, lane, {}, segment);
      }
    }
  }

  const std::int64_t spent = steady_now_ns() - began;
  for (std::size_t k = 0; k < tasks.size(); ++k) {
    RolloutSegment& segment = segments[k];
    const int lane = static_cast<int>(k);
    segment.compute_time_ns = spent / static_cast<std::int64_t>(tasks.size());
    if (segment.failed == 0) {
      segment.bootstrap_observation.resize(width);
      backend.observe(lane, segment.bootstrap_observation);
      const EpisodeFacts end = backend.clock(lane);
      segment.end_episode = end.episode;
      segment.end_episode_step = end.episode_step;
      segment.end_episode_limit = end.episode_limit;
      if (runs[k].rollout && backend.snapshots() != nullptr) {
        segment.end_state = backend.snapshots()->save(lane);
        segment.end_hash = hash_state(segment.end_state);
      }
    }
    segment.payload_crc32c = segment_crc(segment);
  }
  return segments;
}

}  // namespace omentum
