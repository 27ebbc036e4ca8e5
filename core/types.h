#pragma once

// What travels between learner, workers and gateway, as plain values. core/wire.* alone maps these
// to the IDL types. Meaning and limits of the fields: docs/wire.md 2.

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "core/hash.h"

namespace omentum {

using Bytes = std::vector<std::byte>;

/// Layout of the state bytes that SimBackend::save writes; raise it when they change. Reaches wire
/// and disk.
inline constexpr std::uint32_t kSimStateFormat = 3;

/// Branches of an action at most: x, y, z, gripper, roll, pitch, yaw.
inline constexpr std::size_t kActionBranches = 7;

/// Entries of an action in segments, batches and recordings, for a head of this many branches: four
/// (unused ones are 0), or all seven where the tool is turned as well.
constexpr std::size_t action_columns(std::size_t branches) {
  return branches > 4 ? kActionBranches : 4;
}

inline constexpr float kMaxFramesHz = 50;                ///< of live frames of one slot
inline constexpr std::size_t kMaxFrameValues = 196'608;  ///< of one live frame: 65,536 particles

/// Values reach the wire: do not change.
enum class TaskKind : std::uint32_t { kRollout = 0, kEvaluate = 1 };

/// Which fixed starts an evaluate task uses. Values reach the wire: do not change.
enum class StartSet : std::uint32_t {
  kTraining = 0,   ///< drawn from (run_seed, slot, episode)
  kGrid = 1,       ///< scene.start_grid, the 100 cells
  kRobotGrid = 2,  ///< scene.robot_grid, the 25 cells
  /// Settled sheet, jaw closed on particle start_index, no policy: lift to p_T and hold.
  kGraspLattice = 3,
  /// The starts of kGrid, with parameters of scene and arm drawn from config.randomise by draws
  /// that training never makes (Purpose::kEvaluationDynamics, start_index).
  kGridDrawn = 4,
};

enum class Source : std::uint32_t { kSimulation = 0, kDvrk = 1 };

/// Values reach the wire: do not change.
enum class Outcome : std::uint8_t {
  kTargetReached = 0,
  kTruncated = 1,
  kGraspLost = 2,
  kSafetyStop = 3,
  kError = 4
};

/// Bits of RolloutSegment::flags. Values reach the wire: do not change.
namespace step_flag {
inline constexpr std::uint8_t kTerminated = 1;
inline constexpr std::uint8_t kTruncated = 2;
inline constexpr std::uint8_t kFirst = 4;       ///< first step of an episode
inline constexpr std::uint8_t kHeld = 8;        ///< tissue held before the step
inline constexpr std::uint8_t kGraspLost = 16;  ///< tissue lost during the step
inline constexpr std::uint8_t kScripted = 32;   ///< action of the hold script, not of the policy
}  // namespace step_flag

/// A version of the policy: all parameters of actor and critic in the order of core/policy.h, and
/// the observation normaliser that belongs to them.
struct PolicyWeights {
  std::uint32_t policy_id = 0;  ///< hash of the run name
  std::uint32_t learner_epoch = 0;
  std::uint64_t policy_version = 0;  ///< finished updates
  Sha256 weights_hash{};             ///< of parameters and normaliser, canonical bytes
  std::uint64_t layout_hash = 0;
  std::uint64_t config_hash = 0;
  std::vector<float> parameters;
  std::vector<float> obs_mean;     ///< empty = not normalised
  std::vector<float> obs_inv_std;  ///< same size as obs_mean
  std::int64_t published_at_ns = 0;
};

/// One grant: a pure function call for some worker.
struct RolloutTask {
  std::uint32_t slot = 0;
  std::uint64_t segment = 0;
  std::uint32_t grant = 0;
  std::uint32_t worker_id = 0;
  std::uint32_t learner_epoch = 0;
  std::uint64_t task_hash = 0;  ///< hash_task() below
  std::uint64_t policy_version = 0;
  Sha256 weights_hash{};
  std::uint64_t config_hash = 0;
  TaskKind kind = TaskKind::kRollout;
  bool greedy = false;
  StartSet start_set = StartSet::kTraining;
  std::uint32_t start_index = 0;
  std::uint32_t steps = 0;  ///< decisions to run; evaluate: upper limit, hold included
  std::uint64_t run_seed = 0;
  std::uint64_t episode = 0;
  std::uint32_t episode_step = 0;
  /// Decisions until this episode is truncated; 0 = task default.
  std::uint32_t episode_limit = 0;
  std::uint32_t policy_steps = 0;  ///< evaluate: most decisions of the policy
  std::uint32_t hold_steps = 0;    ///< evaluate: decisions of hold at p_T once reached
  bool reset = false;              ///< start a fresh episode; start_state is empty
  std::uint32_t state_format = 0;
  std::uint64_t start_hash = 0;
  Bytes start_state;
  std::uint32_t frame_stride = 0;  ///< > 0: the segment carries tissue frames and state hashes
  std::int64_t granted_at_ns = 0;
  /// > 0: the worker publishes SimFrame so often while the task runs [Hz]; no part of its hash.
  float live_frames_hz = 0;
};

/// Result of a task: steps and end state. Arrays are row-major, first index the step.
struct RolloutSegment {
  std::uint32_t slot = 0;
  std::uint64_t segment = 0;
  std::uint32_t grant = 0;
  std::uint32_t worker_id = 0;
  std::uint32_t learner_epoch = 0;
  std::uint64_t task_hash = 0;
  std::uint64_t policy_version = 0;
  std::uint64_t build_id = 0;
  Source source = Source::kSimulation;
  std::uint32_t steps = 0;
  std::vector<float> observations;           ///< steps x O, raw
  std::vector<std::uint8_t> actions;         ///< steps x action_columns(), branch indices
  std::vector<float> actions_continuous;     ///< steps x 4 with a Gaussian head, else empty
  std::vector<float> log_probs;              ///< steps, joint
  std::vector<float> rewards;                ///< steps
  std::vector<float> values;                 ///< steps
  std::vector<std::uint8_t> flags;           ///< steps, step_flag
  std::vector<float> bootstrap_observation;  ///< O, after the last step
  std::vector<float> final_observations;     ///< O per truncated episode inside the segment
  std::vector<std::uint32_t> episode_end_step;
  std::vector<double> episode_return;
  std::vector<std::uint32_t> episode_length;
  std::vector<std::uint8_t> episode_outcome;  ///< Outcome
  std::vector<float> episode_exposure;        ///< at the end of the episode
  std::vector<std::uint8_t> episode_grasped;  ///< 1 if tissue was held at any step of the episode
  std::vector<std::uint8_t> episode_held;     ///< 1 if tissue was held at the episode's end
  /// 3 per episode, first grasp in W [m]; NaN if none.
  std::vector<float> episode_grasp_position_in_world_m;
  std::vector<float> episode_start_position_in_world_m;  ///< 3 per episode, tool start in W [m]
  std::uint64_t end_episode = 0;
  std::uint32_t end_episode_step = 0;
  std::uint32_t end_episode_limit = 0;
  std::uint32_t state_format = 0;
  std::uint64_t end_hash = 0;
  Bytes end_state;
  std::uint32_t failed = 0;         ///< 1: a lane went non-finite; steps counts the good ones
  std::string failure;              ///< reason when failed
  std::uint64_t physics_ticks = 0;  ///< solver substeps run
  std::vector<std::uint64_t> state_hashes;        ///< steps, when frame_stride > 0
  std::vector<float> frame_positions_in_world_m;  ///< frames x particles x 3
  std::vector<float> tool_positions_in_world_m;   ///< steps x 3, when frame_stride > 0
  std::vector<float> exposures;                   ///< steps, when frame_stride > 0
  std::uint32_t payload_crc32c = 0;
  std::int64_t compute_time_ns = 0;
  std::int64_t wait_time_ns = 0;
  std::int64_t granted_at_ns = 0;
  Sha256 weights_hash{};  ///< of the policy, as the task named it
};

enum class WorkerPhase : std::uint32_t { kStarting = 0, kIdle = 1, kCollecting = 2, kDraining = 3 };

struct WorkerStatus {
  std::uint32_t worker_id = 0;
  std::string host;
  std::string program_version;
  std::uint32_t pid = 0;
  std::uint64_t build_id = 0;
  std::uint32_t lanes = 0;
  WorkerPhase phase = WorkerPhase::kStarting;
  std::uint32_t learner_epoch = 0;
  std::uint64_t policy_version = 0;
  std::uint64_t tasks_received = 0;
  std::uint64_t tasks_declined_no_weights = 0;
  std::uint64_t tasks_declined_config = 0;
  std::uint64_t tasks_declined_state = 0;
  std::uint64_t tasks_declined_epoch = 0;
  std::uint64_t tasks_abandoned = 0;
  std::uint64_t tasks_in_progress = 0;
  std::uint64_t segments_published = 0;
  std::uint64_t write_timeouts = 0;
  std::uint64_t steps = 0;
  double steps_per_s = 0;
  double sim_time_fraction = 0;
  std::uint64_t socket_receive_buffer_bytes = 0;
  std::uint64_t rexmit_bytes = 0;
  std::uint64_t throttle_count = 0;
  std::uint64_t time_throttle_ns = 0;
  std::vector<std::string> warnings;
  std::vector<std::string> alarms;  ///< that hold now; at most 16
  std::uint64_t alarms_raised = 0;  ///< since the start
  std::uint64_t frames_published = 0;
};

enum class LearnerPhase : std::uint32_t {
  kWaiting = 0,
  kUpdating = 1,
  kSaving = 2,
  kEvaluating = 3,
  kPaused = 4,
  kDone = 5
};

/// Counters of docs/wire.md 4.3. Every grant ends in exactly one of admitted, cancelled,
/// regranted, and every segment in exactly one of admitted, duplicate, stale, invalid, foreign,
/// overflow.
struct Ledger {
  std::uint64_t granted = 0;    ///< grants written, re-grants and audits included
  std::uint64_t regranted = 0;  ///< grants that lapsed and were replaced by another
  std::uint64_t received = 0;
  std::uint64_t admitted = 0;  ///< evaluated ones included
  std::uint64_t duplicate = 0;
  std::uint64_t stale = 0;
  std::uint64_t invalid = 0;
  std::uint64_t cancelled = 0;  ///< grants of a task of which another grant was admitted first
  std::uint64_t foreign = 0;
  std::uint64_t overflow = 0;
  std::uint64_t outstanding = 0;     ///< grants alive now
  std::uint64_t audit_mismatch = 0;  ///< results of one task that differ: impure worker, memory
  std::uint64_t evaluated = 0;       ///< admitted results of evaluation tasks; not on the wire
  std::uint64_t failed = 0;          ///< invalid ones with a diverged lane; not on the wire
};

/// The counters by the name under which metrics, checkpoints and logs have them.
struct LedgerCounter {
  const char* name;
  std::uint64_t Ledger::*value;
};
inline constexpr LedgerCounter kLedgerCounters[] = {
    {"granted", &Ledger::granted},         {"regranted", &Ledger::regranted},
    {"received", &Ledger::received},       {"admitted", &Ledger::admitted},
    {"duplicate", &Ledger::duplicate},     {"stale", &Ledger::stale},
    {"invalid", &Ledger::invalid},         {"cancelled", &Ledger::cancelled},
    {"foreign", &Ledger::foreign},         {"overflow", &Ledger::overflow},
    {"outstanding", &Ledger::outstanding}, {"audit_mismatch", &Ledger::audit_mismatch},
    {"evaluated", &Ledger::evaluated},     {"failed", &Ledger::failed}};

struct LearnerStatus : Ledger {
  std::string run_id;
  std::uint32_t learner_epoch = 0;
  std::uint64_t policy_version = 0;
  std::uint64_t batch = 0;
  LearnerPhase phase = LearnerPhase::kWaiting;
  std::uint32_t workers_alive = 0;
  double oldest_task_age_s = 0;
  std::uint64_t steps_total = 0;
  double steps_per_s = 0, bytes_up_per_s = 0, bytes_down_per_s = 0;
  double mean_return = 0, mean_length = 0, approx_kl = 0, entropy = 0, explained_variance = 0;
  Sha256 weights_hash{};
  std::vector<std::uint32_t> worker_ids;
  std::vector<std::uint8_t> worker_phases;
  std::vector<double> worker_steps_per_s;
  std::vector<std::uint32_t> barred_worker_ids;  ///< get no task for a while; at most 64 are told
  std::vector<std::string> barred_reasons;
  std::vector<std::string> alarms;  ///< that hold now; at most 16
  std::uint64_t alarms_raised = 0;  ///< since the start
  std::uint64_t steps_wanted = 0;   ///< of the whole run
  /// Shall join anew: the learner does not hear them, or they not it; at most 64 are told.
  std::vector<std::uint32_t> unheard_worker_ids;
};

struct EpisodeSummary {
  Source source = Source::kSimulation;
  std::uint32_t slot = 0;
  std::uint64_t episode = 0;
  std::uint64_t first_version = 0, last_version = 0;
  std::uint32_t length_steps = 0;
  double return_sum = 0, return_discounted = 0;
  Outcome outcome = Outcome::kTruncated;
  float exposure_fraction = 0;
  std::array<double, 3> start_position_in_world_m{};
  std::array<double, 3> grasp_position_in_world_m{};
};

struct RunManifest {
  std::string run_id;
  std::uint32_t learner_epoch = 0;
  std::string config_text;  ///< resolved text protobuf
  std::uint64_t config_hash = 0, layout_hash = 0, build_id = 0;
  std::string git_revision;
  std::uint64_t run_seed = 0;
  std::uint32_t slots = 0, steps_per_segment = 0, lead = 0, state_format = 0;
  std::vector<std::string> observation_names, action_names;
};

/// Values reach the wire: do not change.
enum class ControlAction : std::uint32_t {
  kPause = 0,  ///< no grants until kResume; what is out comes in
  kResume = 1,
  kEvaluate = 2,    ///< the present weights, before the next batch
  kCheckpoint = 3,  ///< now
  kStop = 4,        ///< as Ctrl-C: with a resumable checkpoint
  kDrain = 5,       ///< one worker hands its work back and leaves
  kFramesOn = 6,    ///< SimFrame of one slot from its next task on
  kFramesOff = 7,
};

/// The operator's wish (docs/wire.md 3.1).
struct ControlCommand {
  std::string run_id;
  std::uint64_t request = 0;  ///< chosen by the operator; the reply repeats it
  std::string issuer;         ///< for the log
  ControlAction action = ControlAction::kPause;
  std::uint32_t worker_id = 0;  ///< kDrain
  std::uint32_t slot = 0;       ///< kFramesOn, kFramesOff
  float frames_hz = 0;          ///< kFramesOn
  std::int64_t sent_at_ns = 0;
};

struct ControlReply {
  std::string run_id;
  std::uint64_t request = 0;
  std::string program;          ///< "learner" or "sim_worker"
  std::uint32_t worker_id = 0;  ///< 0: the learner
  bool done = false;
  std::string text;  ///< what was done, or why it was not
};

/// One environment while it runs, for viewers.
struct SimFrame {
  std::uint32_t slot = 0;
  std::string run_id;
  std::uint32_t worker_id = 0;
  std::uint64_t policy_version = 0;
  std::uint64_t episode = 0;
  std::uint32_t episode_step = 0;
  double sim_time_s = 0;                             ///< of the episode
  std::vector<float> particle_positions_in_world_m;  ///< 3 per particle, in W
  std::array<double, 3> tool_position_in_world_m{};
  bool grasped = false;
};

/// Values reach the wire and are those of SafetyPhase: do not change.
enum class RobotPhase : std::uint32_t {
  kListening = 0,
  kWaiting = 1,
  kReady = 2,
  kActive = 3,
  kStopped = 4
};

inline constexpr double kNotKnown = std::numeric_limits<double>::quiet_NaN();

/// A robot as its gateway sees it (topic omentum/robot/state, docs/dvrk.md 10), in CRTK words.
/// Positions in W; counters since the gateway's start; kNotKnown for a number that is not known.
struct RobotStatus {
  std::uint32_t gateway_id = 0;  ///< hash of host, process and start time
  std::string run_id;
  std::string robot;  ///< name of the arm, as PSM1
  std::string host;
  std::uint32_t pid = 0;
  std::string program_version;
  RobotPhase phase = RobotPhase::kListening;
  bool armed = false;        ///< goals are taken and sent
  bool dry_run = false;      ///< nothing is sent, whatever the phase
  std::uint32_t reason = 0;  ///< StopReason: of the stop while stopped, else why it is not ready
  std::string reason_name;
  std::string reason_text;      ///< with its figures
  std::string operating_state;  ///< CRTK: DISABLED, ENABLED, PAUSED, FAULT, ...
  bool is_homed = false;
  bool is_busy = false;
  bool registered = false;  ///< positions in W are of a registration, not of the scene file
  std::array<double, 3> measured_cp_in_world_m{kNotKnown, kNotKnown, kNotKnown};
  std::array<double, 3> setpoint_cp_in_world_m{kNotKnown, kNotKnown, kNotKnown};
  std::array<double, 3> goal_cp_in_world_m{kNotKnown, kNotKnown, kNotKnown};  ///< the goal in force
  std::array<double, 3> measured_tip_in_world_m{kNotKnown, kNotKnown, kNotKnown};
  std::vector<double> measured_jp;  ///< yaw, pitch [rad], insertion [m], roll ... [rad]
  std::vector<double> setpoint_jp;
  std::vector<double> goal_jp;
  double measured_jaw_rad = kNotKnown, setpoint_jaw_rad = kNotKnown, goal_jaw_rad = kNotKnown;
  std::uint64_t datagrams = 0;  ///< taken; what became of the others follows
  std::uint64_t malformed = 0, foreign = 0, unknown_keys = 0, not_finite = 0, reordered = 0;
  std::uint64_t restarts = 0, cut = 0;
  std::uint64_t sent = 0, unsent = 0;      ///< commands
  std::vector<std::uint64_t> refusals;     ///< stops by reason, index = StopReason
  std::vector<std::string> refusal_names;  ///< of the indices of refusals
  std::uint64_t stops = 0;                 ///< their sum
  // Of the last second, as LoopTimes has them.
  double latency_p50_ms = kNotKnown, latency_max_ms = kNotKnown;
  double jitter_p50_ms = kNotKnown, jitter_max_ms = kNotKnown;
  double state_age_p50_ms = kNotKnown, state_age_max_ms = kNotKnown;
  std::uint64_t periods = 0, late = 0, missed = 0, unwatched = 0;
  std::uint64_t episodes = 0;  ///< that ended
  std::uint64_t segments_published = 0, write_failures = 0;
  std::uint64_t policy_version = 0;  ///< pinned for the present or next episode
  Sha256 weights_hash{};
  std::int64_t sent_at_ns = 0;
};

/// Of the i-th episode that ended in the segment; its number, `episode`, is left to the caller.
EpisodeSummary summary_of(const RolloutSegment& segment, std::size_t i);

/// Identity of a task (docs/wire.md 2): FNV-1a over the canonical little-endian bytes of everything
/// that decides its result. Grant, worker, epoch and times are excluded.
std::uint64_t hash_task(const RolloutTask& task);

}  // namespace omentum
