#include "core/wire.h"

#include <algorithm>
#include <array>
#include <string_view>
#include <type_traits>
#include <utility>

#include "core/check.h"
#include "omentum.h"

namespace omentum {
namespace {

// Every record has one list of its fields, fields(generated, core, visitor), used in both
// directions: Borrow fills the generated struct from the core one, Copy the reverse. A field that
// is missing in the list fails the round-trip test.

// -------------------------------------------------------------------------------------------- out

// Points generated sequences at memory of the core record. Nothing is owned: _release stays false,
// and the generated struct must not outlive the record.
class Borrow {
 public:
  template <typename T>
  void value(T& wire, const T& core, std::string_view /*name*/) {
    wire = core;
  }

  template <typename E, typename C>
  void enumerator(E& wire, const C& core, C last, std::string_view name) {
    if (core > last) fail(name, "enumerator out of range");
    wire = static_cast<E>(core);
  }

  template <typename S, typename T>
  void sequence(S& wire, const std::vector<T>& core, std::size_t bound, std::string_view name) {
    borrow(wire, core.data(), core.size(), bound, name);
  }

  template <typename S, typename T, std::size_t N>
  void fixed(S& wire, const std::array<T, N>& core, std::string_view name) {
    borrow(wire, core.data(), N, N, name);
  }

  void text(char*& wire, const std::string& core, std::string_view name) {
    if (core.find('\0') != std::string::npos) fail(name, "contains a zero byte");
    wire = const_cast<char*>(core.c_str());  // the C types have no const; never written through
  }

  template <typename S>
  void texts(S& wire, const std::vector<std::string>& core, std::size_t bound,
             std::string_view name) {
    std::vector<char*>& pointers = lists_.at(next_list_++);
    for (const std::string& entry : core) text(pointers.emplace_back(), entry, name);
    borrow(wire, pointers.data(), pointers.size(), bound, name);
  }

  Result<void> result() const {
    return failure_.empty() ? Result<void>() : Result<void>(Failure{failure_});
  }

 private:
  template <typename S, typename T>
  void borrow(S& wire, const T* data, std::size_t size, std::size_t bound, std::string_view name) {
    using Element = std::remove_pointer_t<decltype(wire._buffer)>;
    static_assert(sizeof(Element) == sizeof(T));
    if (size > bound) fail(name, fmt::format("length {} exceeds {}", size, bound));
    wire._buffer = const_cast<Element*>(reinterpret_cast<const Element*>(data));
    wire._length = static_cast<std::uint32_t>(size);
    wire._maximum = wire._length;
    wire._release = false;
  }

  void fail(std::string_view name, std::string_view reason) {
    if (failure_.empty()) failure_ = fmt::format("{}: {}", name, reason);
  }

  std::array<std::vector<char*>, 2> lists_;  // pointers of sequences of strings
  std::size_t next_list_ = 0;
  std::string failure_;
};

// --------------------------------------------------------------------------------------------- in

// Copies a received sample; stops at the first field that does not pass.
class Copy {
 public:
  template <typename T>
  void value(const T& wire, T& core, std::string_view /*name*/) {
    core = wire;
  }

  template <typename E, typename C>
  void enumerator(const E& wire, C& core, C last, std::string_view name) {
    const auto number = static_cast<std::uint32_t>(wire);
    if (number > static_cast<std::uint32_t>(last)) {
      return fail(name, fmt::format("enumerator {} out of range", number));
    }
    core = static_cast<C>(number);
  }

  template <typename S, typename T>
  void sequence(const S& wire, std::vector<T>& core, std::size_t bound, std::string_view name) {
    static_assert(sizeof(*wire._buffer) == sizeof(T));
    if (!plausible(wire, bound, name)) return;
    const T* data = reinterpret_cast<const T*>(wire._buffer);
    core.assign(data, data + wire._length);
  }

  template <typename S, typename T, std::size_t N>
  void fixed(const S& wire, std::array<T, N>& core, std::string_view name) {
    if (wire._length != N || wire._buffer == nullptr) {
      return fail(name, fmt::format("length {} is not {}", wire._length, N));
    }
    std::copy_n(wire._buffer, N, core.begin());
  }

  void text(char* const& wire, std::string& core, std::string_view name) {
    if (wire == nullptr) return fail(name, "no string");
    core = wire;
  }

  template <typename S>
  void texts(const S& wire, std::vector<std::string>& core, std::size_t bound,
             std::string_view name) {
    if (!plausible(wire, bound, name)) return;
    core.resize(wire._length);
    for (std::uint32_t i = 0; i < wire._length; ++i) text(wire._buffer[i], core[i], name);
  }

  Result<void> result() const {
    return failure_.empty() ? Result<void>() : Result<void>(Failure{failure_});
  }

 private:
  template <typename S>
  bool plausible(const S& wire, std::size_t bound, std::string_view name) {
    if (wire._length > bound) {
      fail(name, fmt::format("length {} exceeds {}", wire._length, bound));
      return false;
    }
    if (wire._length > 0 && wire._buffer == nullptr) {
      fail(name, "no buffer");
      return false;
    }
    return failure_.empty();
  }

  void fail(std::string_view name, std::string_view reason) {
    if (failure_.empty()) failure_ = fmt::format("{}: {}", name, reason);
  }

  std::string failure_;
};

// ------------------------------------------------------------------------------------ field lists

constexpr std::size_t kMaxWarnings = 8;  // bounds idlc has no name for
constexpr std::size_t kMaxNames = 64;

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, PolicyWeights>
void fields(G& g, C& c, V& v) {
  v.value(g.policy_id, c.policy_id, "policy_id");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.value(g.policy_version, c.policy_version, "policy_version");
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
  v.value(g.layout_hash, c.layout_hash, "layout_hash");
  v.value(g.config_hash, c.config_hash, "config_hash");
  v.sequence(g.parameters, c.parameters, omentum_v1_MAX_PARAMETERS, "parameters");
  v.sequence(g.obs_mean, c.obs_mean, omentum_v1_MAX_OBSERVATION, "obs_mean");
  v.sequence(g.obs_inv_std, c.obs_inv_std, omentum_v1_MAX_OBSERVATION, "obs_inv_std");
  v.value(g.published_at_ns, c.published_at_ns, "published_at_ns");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, RolloutTask>
void fields(G& g, C& c, V& v) {
  v.value(g.slot, c.slot, "slot");
  v.value(g.segment, c.segment, "segment");
  v.value(g.grant, c.grant, "grant");
  v.value(g.worker_id, c.worker_id, "worker_id");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.value(g.task_hash, c.task_hash, "task_hash");
  v.value(g.policy_version, c.policy_version, "policy_version");
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
  v.value(g.config_hash, c.config_hash, "config_hash");
  v.enumerator(g.kind, c.kind, TaskKind::kReplay, "kind");
  v.value(g.greedy, c.greedy, "greedy");
  v.enumerator(g.start_set, c.start_set, StartSet::kGraspLattice, "start_set");
  v.value(g.start_index, c.start_index, "start_index");
  v.value(g.steps, c.steps, "steps");
  v.value(g.run_seed, c.run_seed, "run_seed");
  v.value(g.episode, c.episode, "episode");
  v.value(g.episode_step, c.episode_step, "episode_step");
  v.value(g.episode_limit, c.episode_limit, "episode_limit");
  v.value(g.reset, c.reset, "reset");
  v.value(g.state_format, c.state_format, "state_format");
  v.value(g.start_hash, c.start_hash, "start_hash");
  v.sequence(g.start_state, c.start_state, omentum_v1_MAX_STATE_BYTES, "start_state");
  v.text(g.scene_override, c.scene_override, "scene_override");
  v.sequence(g.commands, c.commands, omentum_v1_MAX_STEP_VALUES, "commands");
  v.value(g.frame_stride, c.frame_stride, "frame_stride");
  v.value(g.policy_steps, c.policy_steps, "policy_steps");
  v.value(g.hold_steps, c.hold_steps, "hold_steps");
  v.value(g.granted_at_ns, c.granted_at_ns, "granted_at_ns");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, RolloutSegment>
void fields(G& g, C& c, V& v) {
  v.value(g.slot, c.slot, "slot");
  v.value(g.segment, c.segment, "segment");
  v.value(g.grant, c.grant, "grant");
  v.value(g.worker_id, c.worker_id, "worker_id");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.value(g.task_hash, c.task_hash, "task_hash");
  v.value(g.policy_version, c.policy_version, "policy_version");
  v.value(g.build_id, c.build_id, "build_id");
  v.enumerator(g.source, c.source, Source::kReplay, "source");
  v.value(g.steps, c.steps, "steps");
  v.sequence(g.observations, c.observations, omentum_v1_MAX_OBSERVATIONS, "observations");
  v.sequence(g.actions, c.actions, omentum_v1_MAX_STEP_VALUES, "actions");
  v.sequence(g.actions_continuous, c.actions_continuous, omentum_v1_MAX_STEP_VALUES,
             "actions_continuous");
  v.sequence(g.masks, c.masks, omentum_v1_MAX_STEPS, "masks");
  v.sequence(g.log_probs, c.log_probs, omentum_v1_MAX_STEPS, "log_probs");
  v.sequence(g.rewards, c.rewards, omentum_v1_MAX_STEPS, "rewards");
  v.sequence(g.values, c.values, omentum_v1_MAX_STEPS, "values");
  v.sequence(g.flags, c.flags, omentum_v1_MAX_STEPS, "flags");
  v.sequence(g.bootstrap_observation, c.bootstrap_observation, omentum_v1_MAX_OBSERVATION,
             "bootstrap_observation");
  v.sequence(g.final_observations, c.final_observations, omentum_v1_MAX_OBSERVATIONS,
             "final_observations");
  v.sequence(g.episode_end_step, c.episode_end_step, omentum_v1_MAX_EPISODES, "episode_end_step");
  v.sequence(g.episode_return, c.episode_return, omentum_v1_MAX_EPISODES, "episode_return");
  v.sequence(g.episode_length, c.episode_length, omentum_v1_MAX_EPISODES, "episode_length");
  v.sequence(g.episode_outcome, c.episode_outcome, omentum_v1_MAX_EPISODES, "episode_outcome");
  v.sequence(g.episode_exposure, c.episode_exposure, omentum_v1_MAX_EPISODES, "episode_exposure");
  v.sequence(g.episode_grasped, c.episode_grasped, omentum_v1_MAX_EPISODES, "episode_grasped");
  v.sequence(g.episode_held, c.episode_held, omentum_v1_MAX_EPISODES, "episode_held");
  v.sequence(g.episode_grasp_position_in_world_m, c.episode_grasp_position,
             omentum_v1_MAX_STEP_VALUES, "episode_grasp_position");
  v.sequence(g.episode_start_position_in_world_m, c.episode_start_position,
             omentum_v1_MAX_STEP_VALUES, "episode_start_position");
  v.value(g.end_episode, c.end_episode, "end_episode");
  v.value(g.end_episode_step, c.end_episode_step, "end_episode_step");
  v.value(g.end_episode_limit, c.end_episode_limit, "end_episode_limit");
  v.value(g.state_format, c.state_format, "state_format");
  v.value(g.end_hash, c.end_hash, "end_hash");
  v.sequence(g.end_state, c.end_state, omentum_v1_MAX_STATE_BYTES, "end_state");
  v.value(g.failed, c.failed, "failed");
  v.text(g.failure, c.failure, "failure");
  v.value(g.physics_ticks, c.physics_ticks, "physics_ticks");
  v.sequence(g.state_hashes, c.state_hashes, omentum_v1_MAX_STEPS, "state_hashes");
  v.sequence(g.frame_positions_in_world_m, c.frame_positions_in_world_m,
             omentum_v1_MAX_OBSERVATIONS, "frame_positions_in_world_m");
  v.sequence(g.tool_positions_in_world_m, c.tool_positions_in_world_m, omentum_v1_MAX_STEP_VALUES,
             "tool_positions_in_world_m");
  v.sequence(g.exposures, c.exposures, omentum_v1_MAX_STEPS, "exposures");
  v.value(g.payload_crc32c, c.payload_crc32c, "payload_crc32c");
  v.value(g.compute_time_ns, c.compute_time_ns, "compute_time_ns");
  v.value(g.wait_time_ns, c.wait_time_ns, "wait_time_ns");
  v.value(g.granted_at_ns, c.granted_at_ns, "granted_at_ns");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, WorkerStatus>
void fields(G& g, C& c, V& v) {
  v.value(g.worker_id, c.worker_id, "worker_id");
  v.text(g.host, c.host, "host");
  v.text(g.program_version, c.program_version, "program_version");
  v.value(g.pid, c.pid, "pid");
  v.value(g.build_id, c.build_id, "build_id");
  v.value(g.lanes, c.lanes, "lanes");
  v.enumerator(g.phase, c.phase, WorkerPhase::kDraining, "phase");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.value(g.policy_version, c.policy_version, "policy_version");
  v.value(g.tasks_received, c.tasks_received, "tasks_received");
  v.value(g.tasks_declined_no_weights, c.tasks_declined_no_weights, "tasks_declined_no_weights");
  v.value(g.tasks_declined_config, c.tasks_declined_config, "tasks_declined_config");
  v.value(g.tasks_declined_state, c.tasks_declined_state, "tasks_declined_state");
  v.value(g.tasks_declined_epoch, c.tasks_declined_epoch, "tasks_declined_epoch");
  v.value(g.tasks_abandoned, c.tasks_abandoned, "tasks_abandoned");
  v.value(g.tasks_in_progress, c.tasks_in_progress, "tasks_in_progress");
  v.value(g.segments_published, c.segments_published, "segments_published");
  v.value(g.write_timeouts, c.write_timeouts, "write_timeouts");
  v.value(g.steps, c.steps, "steps");
  v.value(g.steps_per_s, c.steps_per_s, "steps_per_s");
  v.value(g.sim_time_fraction, c.sim_time_fraction, "sim_time_fraction");
  v.value(g.socket_receive_buffer_bytes, c.socket_receive_buffer_bytes,
          "socket_receive_buffer_bytes");
  v.value(g.rexmit_bytes, c.rexmit_bytes, "rexmit_bytes");
  v.value(g.throttle_count, c.throttle_count, "throttle_count");
  v.value(g.time_throttle_ns, c.time_throttle_ns, "time_throttle_ns");
  v.texts(g.warnings, c.warnings, kMaxWarnings, "warnings");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, LearnerStatus>
void fields(G& g, C& c, V& v) {
  v.text(g.run_id, c.run_id, "run_id");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.value(g.policy_version, c.policy_version, "policy_version");
  v.value(g.batch, c.batch, "batch");
  v.enumerator(g.phase, c.phase, LearnerPhase::kDone, "phase");
  v.value(g.granted, c.granted, "granted");
  v.value(g.regranted, c.regranted, "regranted");
  v.value(g.received, c.received, "received");
  v.value(g.admitted, c.admitted, "admitted");
  v.value(g.duplicate, c.duplicate, "duplicate");
  v.value(g.stale, c.stale, "stale");
  v.value(g.invalid, c.invalid, "invalid");
  v.value(g.cancelled, c.cancelled, "cancelled");
  v.value(g.foreign, c.foreign, "foreign");
  v.value(g.overflow, c.overflow, "overflow");
  v.value(g.outstanding, c.outstanding, "outstanding");
  v.value(g.audit_mismatch, c.audit_mismatch, "audit_mismatch");
  v.value(g.workers_alive, c.workers_alive, "workers_alive");
  v.value(g.oldest_task_age_s, c.oldest_task_age_s, "oldest_task_age_s");
  v.value(g.steps_total, c.steps_total, "steps_total");
  v.value(g.steps_per_s, c.steps_per_s, "steps_per_s");
  v.value(g.bytes_up_per_s, c.bytes_up_per_s, "bytes_up_per_s");
  v.value(g.bytes_down_per_s, c.bytes_down_per_s, "bytes_down_per_s");
  v.value(g.mean_return, c.mean_return, "mean_return");
  v.value(g.mean_length, c.mean_length, "mean_length");
  v.value(g.approx_kl, c.approx_kl, "approx_kl");
  v.value(g.entropy, c.entropy, "entropy");
  v.value(g.explained_variance, c.explained_variance, "explained_variance");
  v.fixed(g.weights_hash, c.weights_hash, "weights_hash");
  v.sequence(g.worker_ids, c.worker_ids, omentum_v1_MAX_WORKERS, "worker_ids");
  v.sequence(g.worker_phases, c.worker_phases, omentum_v1_MAX_WORKERS, "worker_phases");
  v.sequence(g.worker_steps_per_s, c.worker_steps_per_s, omentum_v1_MAX_WORKERS,
             "worker_steps_per_s");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, EpisodeSummary>
void fields(G& g, C& c, V& v) {
  v.enumerator(g.source, c.source, Source::kReplay, "source");
  v.value(g.slot, c.slot, "slot");
  v.value(g.episode, c.episode, "episode");
  v.value(g.first_version, c.first_version, "first_version");
  v.value(g.last_version, c.last_version, "last_version");
  v.value(g.length_steps, c.length_steps, "length_steps");
  v.value(g.return_sum, c.return_sum, "return_sum");
  v.value(g.return_discounted, c.return_discounted, "return_discounted");
  v.enumerator(g.outcome, c.outcome, Outcome::kError, "outcome");
  v.value(g.exposure_fraction, c.exposure_fraction, "exposure_fraction");
  v.fixed(g.start_position_in_world_m, c.start_position_in_world_m, "start_position_in_world_m");
  v.fixed(g.grasp_position_in_world_m, c.grasp_position_in_world_m, "grasp_position_in_world_m");
}

template <typename G, typename C, typename V>
requires std::is_same_v<std::remove_const_t<C>, RunManifest>
void fields(G& g, C& c, V& v) {
  v.text(g.run_id, c.run_id, "run_id");
  v.value(g.learner_epoch, c.learner_epoch, "learner_epoch");
  v.text(g.config_text, c.config_text, "config_text");
  v.value(g.config_hash, c.config_hash, "config_hash");
  v.value(g.layout_hash, c.layout_hash, "layout_hash");
  v.value(g.build_id, c.build_id, "build_id");
  v.text(g.git_revision, c.git_revision, "git_revision");
  v.value(g.run_seed, c.run_seed, "run_seed");
  v.value(g.slots, c.slots, "slots");
  v.value(g.steps_per_segment, c.steps_per_segment, "steps_per_segment");
  v.value(g.lead, c.lead, "lead");
  v.value(g.state_format, c.state_format, "state_format");
  v.texts(g.observation_names, c.observation_names, kMaxNames, "observation_names");
  v.texts(g.action_names, c.action_names, kMaxNames, "action_names");
}

// ------------------------------------------------------------------------------------------ keys

void read_key(const omentum_v1_PolicyWeights& g, PolicyWeights& c) {
  c.policy_id = g.policy_id;
  c.learner_epoch = g.learner_epoch;
}
void read_key(const omentum_v1_RolloutTask& g, RolloutTask& c) { c.slot = g.slot; }
void read_key(const omentum_v1_RolloutSegment& /*g*/, RolloutSegment& /*c*/) {}
void read_key(const omentum_v1_WorkerStatus& g, WorkerStatus& c) { c.worker_id = g.worker_id; }
void read_key(const omentum_v1_LearnerStatus& g, LearnerStatus& c) {
  c.run_id = g.run_id == nullptr ? "" : g.run_id;
  c.learner_epoch = g.learner_epoch;
}
void read_key(const omentum_v1_EpisodeSummary& /*g*/, EpisodeSummary& /*c*/) {}
void read_key(const omentum_v1_RunManifest& g, RunManifest& c) {
  c.run_id = g.run_id == nullptr ? "" : g.run_id;
  c.learner_epoch = g.learner_epoch;
}

// ---------------------------------------------------------------------------------------- records

template <typename Record>
struct Wire;

template <>
struct Wire<PolicyWeights> {
  using Generated = omentum_v1_PolicyWeights;
  static constexpr TopicId kTopic = TopicId::kPolicyWeights;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_PolicyWeights_desc; }
};
template <>
struct Wire<RolloutTask> {
  using Generated = omentum_v1_RolloutTask;
  static constexpr TopicId kTopic = TopicId::kRolloutTask;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_RolloutTask_desc; }
};
template <>
struct Wire<RolloutSegment> {
  using Generated = omentum_v1_RolloutSegment;
  static constexpr TopicId kTopic = TopicId::kRolloutSegment;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_RolloutSegment_desc; }
};
template <>
struct Wire<WorkerStatus> {
  using Generated = omentum_v1_WorkerStatus;
  static constexpr TopicId kTopic = TopicId::kWorkerStatus;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_WorkerStatus_desc; }
};
template <>
struct Wire<LearnerStatus> {
  using Generated = omentum_v1_LearnerStatus;
  static constexpr TopicId kTopic = TopicId::kLearnerStatus;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_LearnerStatus_desc; }
};
template <>
struct Wire<EpisodeSummary> {
  using Generated = omentum_v1_EpisodeSummary;
  static constexpr TopicId kTopic = TopicId::kEpisodeSummary;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_EpisodeSummary_desc; }
};
template <>
struct Wire<RunManifest> {
  using Generated = omentum_v1_RunManifest;
  static constexpr TopicId kTopic = TopicId::kRunManifest;
  static const dds_topic_descriptor_t& descriptor() { return omentum_v1_RunManifest_desc; }
};

// Lengths that belong together. Everything not named here is free.
class Lengths {
 public:
  Lengths& equal(std::size_t length, std::size_t wanted, std::string_view name) {
    if (length != wanted && failure_.empty()) {
      failure_ = fmt::format("{}: length {} is not {}", name, length, wanted);
    }
    return *this;
  }
  Lengths& none_or(std::size_t length, std::size_t wanted, std::string_view name) {
    return length == 0 ? *this : equal(length, wanted, name);
  }
  Lengths& require(bool ok, std::string_view reason) {
    if (!ok && failure_.empty()) failure_ = reason;
    return *this;
  }
  Result<void> result() const {
    return failure_.empty() ? Result<void>() : Result<void>(Failure{failure_});
  }

 private:
  std::string failure_;
};

}  // namespace

template <typename Record>
Result<void> check_record(const Record& /*record*/) {
  return {};
}

template <>
Result<void> check_record(const PolicyWeights& weights) {
  return Lengths()
      .equal(weights.obs_inv_std.size(), weights.obs_mean.size(), "obs_inv_std")
      .result();
}

template <>
Result<void> check_record(const RolloutTask& task) {
  return Lengths()
      .require(task.steps <= omentum_v1_MAX_STEPS, "steps: out of range")
      .none_or(task.commands.size(), std::size_t{4} * task.steps, "commands")
      .require(task.reset || !task.start_state.empty(), "start_state: empty without reset")
      .result();
}

template <>
Result<void> check_record(const RolloutSegment& s) {
  const std::size_t n = s.steps;
  const std::size_t observation = s.bootstrap_observation.size();
  const std::size_t episodes = s.episode_end_step.size();
  Lengths lengths;
  lengths.require(n <= omentum_v1_MAX_STEPS, "steps: out of range")
      .require(s.failed != 0 ? n == 0 || s.observations.size() % n == 0
                             : s.observations.size() == n * observation,
               "observations: length")
      .none_or(s.actions.size(), 4 * n, "actions")
      .none_or(s.actions_continuous.size(), 4 * n, "actions_continuous")
      .require(!s.actions.empty() || !s.actions_continuous.empty() || n == 0, "actions: none")
      .none_or(s.masks.size(), n, "masks")
      .equal(s.log_probs.size(), n, "log_probs")
      .equal(s.rewards.size(), n, "rewards")
      .equal(s.values.size(), n, "values")
      .equal(s.flags.size(), n, "flags")
      .equal(s.episode_return.size(), episodes, "episode_return")
      .equal(s.episode_length.size(), episodes, "episode_length")
      .equal(s.episode_outcome.size(), episodes, "episode_outcome")
      .equal(s.episode_exposure.size(), episodes, "episode_exposure")
      .equal(s.episode_grasped.size(), episodes, "episode_grasped")
      .equal(s.episode_held.size(), episodes, "episode_held")
      .equal(s.episode_grasp_position.size(), 3 * episodes, "episode_grasp_position")
      .equal(s.episode_start_position.size(), 3 * episodes, "episode_start_position")
      .none_or(s.state_hashes.size(), n, "state_hashes")
      .none_or(s.tool_positions_in_world_m.size(), 3 * n, "tool_positions_in_world_m")
      .none_or(s.exposures.size(), n, "exposures")
      .require(s.failed <= 1, "failed: out of range");
  // A failed segment ends without an observation.
  lengths.require(s.final_observations.empty() || s.failed != 0 ||
                      (observation > 0 && s.final_observations.size() % observation == 0),
                  "final_observations: not a multiple of the observation");
  for (std::size_t i = 0; i < std::min(episodes, s.episode_outcome.size()); ++i) {
    lengths.require(s.episode_outcome[i] <= static_cast<std::uint8_t>(Outcome::kError),
                    "episode_outcome: out of range");
    lengths.require(s.episode_end_step[i] < n, "episode_end_step: out of range");
  }
  return lengths.result();
}

template <>
Result<void> check_record(const LearnerStatus& status) {
  return Lengths()
      .equal(status.worker_phases.size(), status.worker_ids.size(), "worker_phases")
      .equal(status.worker_steps_per_s.size(), status.worker_ids.size(), "worker_steps_per_s")
      .result();
}

template <typename Record>
TopicId topic_of() {
  return Wire<Record>::kTopic;
}

// ---------------------------------------------------------------------------------------- writers

template <typename Record>
struct BusWriter<Record>::Endpoint {
  Endpoint(const dds::Participant& participant, std::vector<std::string> partitions,
           const std::string& name)
      : topic(participant, topic_spec(Wire<Record>::kTopic), Wire<Record>::descriptor()),
        writer(participant, topic, {.partitions = std::move(partitions), .entity_name = name}) {}
  dds::Topic topic;
  dds::Writer writer;
};

template <typename Record>
BusWriter<Record>::BusWriter(const dds::Participant& participant,
                             std::vector<std::string> partitions, const std::string& name)
    : endpoint_(std::make_unique<Endpoint>(participant, std::move(partitions), name)) {}
template <typename Record>
BusWriter<Record>::~BusWriter() = default;
template <typename Record>
BusWriter<Record>::BusWriter(BusWriter&&) noexcept = default;
template <typename Record>
BusWriter<Record>& BusWriter<Record>::operator=(BusWriter&&) noexcept = default;

template <typename Record>
Result<void> BusWriter<Record>::write(const Record& record) {
  typename Wire<Record>::Generated generated{};
  Borrow borrow;
  fields(generated, record, borrow);
  if (const Result<void> ok = borrow.result(); !ok) {
    return Failure{fmt::format("write {}: {}", topic_spec(Wire<Record>::kTopic).name, ok.error())};
  }
  return endpoint_->writer.write(&generated);
}

template <typename Record>
Result<void> BusWriter<Record>::dispose(const Record& record) {
  typename Wire<Record>::Generated generated{};
  Borrow borrow;
  fields(generated, record, borrow);
  return endpoint_->writer.dispose(&generated);
}

template <typename Record>
bool BusWriter<Record>::timed_out() const {
  return endpoint_->writer.timed_out();
}
template <typename Record>
int BusWriter<Record>::matched() const {
  return endpoint_->writer.matched();
}
template <typename Record>
dds::WriterCounters BusWriter<Record>::counters() const {
  return endpoint_->writer.counters();
}
template <typename Record>
bool BusWriter<Record>::wait_for_acknowledgments(std::int64_t timeout_ns) const {
  return endpoint_->writer.wait_for_acknowledgments(timeout_ns);
}
template <typename Record>
std::int32_t BusWriter<Record>::handle() const {
  return endpoint_->writer.handle();
}

// ---------------------------------------------------------------------------------------- readers

template <typename Record>
struct BusReader<Record>::Endpoint {
  Endpoint(const dds::Participant& participant, std::vector<std::string> partitions,
           const std::string& name, const Options& options)
      : topic(participant, topic_spec(Wire<Record>::kTopic), Wire<Record>::descriptor()),
        reader(participant, topic,
               {.partitions = std::move(partitions),
                .entity_name = name,
                .max_samples = options.max_samples,
                .best_effort = options.best_effort}) {}
  dds::Topic topic;
  dds::Reader reader;
  std::uint64_t refused = 0;
  std::string last_refusal;
};

template <typename Record>
BusReader<Record>::BusReader(const dds::Participant& participant,
                             std::vector<std::string> partitions, const std::string& name,
                             Options options)
    : endpoint_(std::make_unique<Endpoint>(participant, std::move(partitions), name, options)) {}
template <typename Record>
BusReader<Record>::~BusReader() = default;
template <typename Record>
BusReader<Record>::BusReader(BusReader&&) noexcept = default;
template <typename Record>
BusReader<Record>& BusReader<Record>::operator=(BusReader&&) noexcept = default;

template <typename Record>
Result<int> BusReader<Record>::take(int limit, const std::function<void(Arrival<Record>&&)>& fn) {
  Endpoint& endpoint = *endpoint_;
  return endpoint.reader.take(limit, [&](const void* sample, const dds::SampleInfo& info) {
    const auto& generated = *static_cast<const typename Wire<Record>::Generated*>(sample);
    Arrival<Record> arrival{{}, info};
    if (!info.valid) {
      read_key(generated, arrival.record);
      return fn(std::move(arrival));
    }
    Copy copy;
    fields(generated, arrival.record, copy);
    Result<void> ok = copy.result();
    if (ok) ok = check_record(arrival.record);
    if (!ok) {
      ++endpoint.refused;
      endpoint.last_refusal = ok.error();
      return;
    }
    fn(std::move(arrival));
  });
}

template <typename Record>
std::uint64_t BusReader<Record>::refused() const {
  return endpoint_->refused;
}
template <typename Record>
const std::string& BusReader<Record>::last_refusal() const {
  return endpoint_->last_refusal;
}
template <typename Record>
std::uint64_t BusReader<Record>::lost() const {
  return endpoint_->reader.lost();
}
template <typename Record>
std::uint64_t BusReader<Record>::rejected() const {
  return endpoint_->reader.rejected();
}
template <typename Record>
int BusReader<Record>::matched() const {
  return endpoint_->reader.matched();
}
template <typename Record>
const dds::Reader& BusReader<Record>::raw() const {
  return endpoint_->reader;
}

// ------------------------------------------------------------------------------------------ sizes

namespace {
constexpr std::size_t kFixedBytes = 256;  // headers and scalars of a bulk record, rounded up

template <typename... Vectors>
std::size_t payload_bytes(const Vectors&... vectors) {
  return kFixedBytes + ((vectors.size() * sizeof(typename Vectors::value_type)) + ... + 0);
}
}  // namespace

std::size_t wire_bytes(const RolloutSegment& s) {
  return payload_bytes(s.observations, s.actions, s.actions_continuous, s.masks, s.log_probs,
                       s.rewards, s.values, s.flags, s.final_observations, s.end_state,
                       s.state_hashes, s.frame_positions_in_world_m, s.tool_positions_in_world_m,
                       s.exposures);
}

std::size_t wire_bytes(const RolloutTask& task) {
  return payload_bytes(task.start_state, task.commands, task.scene_override);
}

std::size_t wire_bytes(const PolicyWeights& weights) {
  return payload_bytes(weights.parameters, weights.obs_mean, weights.obs_inv_std);
}

template TopicId topic_of<PolicyWeights>();
template TopicId topic_of<RolloutTask>();
template TopicId topic_of<RolloutSegment>();
template TopicId topic_of<WorkerStatus>();
template TopicId topic_of<LearnerStatus>();
template TopicId topic_of<EpisodeSummary>();
template TopicId topic_of<RunManifest>();
template Result<void> check_record(const WorkerStatus&);
template Result<void> check_record(const EpisodeSummary&);
template Result<void> check_record(const RunManifest&);
template class BusWriter<PolicyWeights>;
template class BusReader<PolicyWeights>;
template class BusWriter<RolloutTask>;
template class BusReader<RolloutTask>;
template class BusWriter<RolloutSegment>;
template class BusReader<RolloutSegment>;
template class BusWriter<WorkerStatus>;
template class BusReader<WorkerStatus>;
template class BusWriter<LearnerStatus>;
template class BusReader<LearnerStatus>;
template class BusWriter<EpisodeSummary>;
template class BusReader<EpisodeSummary>;
template class BusWriter<RunManifest>;
template class BusReader<RunManifest>;

}  // namespace omentum
