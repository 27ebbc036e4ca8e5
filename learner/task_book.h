#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/policy.h"
#include "core/result.h"
#include "core/types.h"
#include "granting/grants.h"

namespace omentum {

/// Evaluation tasks use slots from here on; they never enter a batch.
inline constexpr std::uint32_t kEvaluationSlot = std::uint32_t{1} << 30;
/// Slots of the gateway's own segments.
inline constexpr std::uint32_t kForeignSlot = std::uint32_t{1} << 31;

/// What a book needs to know about its run. All but the last group is part of the configuration
/// hash.
struct TaskBookConfig {
  std::uint64_t run_seed = 0;
  std::uint64_t config_hash = 0;
  std::uint32_t learner_epoch = 0;
  std::uint32_t slots = 1;              ///< E
  std::uint32_t steps = 1;              ///< T, decisions per segment
  std::uint32_t lead = 0;               ///< 0 or 1
  std::uint32_t episode_decisions = 1;  ///< length of an episode, for the stagger
  bool stagger = true;
  std::uint64_t batches = 0;  ///< tasks beyond this many batches are not granted; 0 = no end

  // What check_segment() holds a segment to.
  std::uint32_t state_format = 0;
  PolicyShape shape;

  // How, not what: never changes a result.
  double audit_rate = 0;  ///< fraction of batches whose tasks are granted twice and compared
  std::int64_t min_task_age_ns = 1'000'000'000;     ///< no task is granted again earlier
  std::int64_t first_task_age_ns = 15'000'000'000;  ///< limit while no segment time is known
};

/// Where a slot begins its next segment.
struct SlotStart {
  std::uint64_t segment = 0;
  std::uint64_t episode = 0;
  std::uint32_t episode_step = 0;
  std::uint32_t episode_limit = 0;
  bool reset = true;  ///< a fresh episode; no state
  std::uint64_t hash = 0;
  Bytes state;
};

/// What a checkpoint keeps of a book: the boundary of the batch that is not complete yet. A book
/// made from it grants the same tasks again, hash for hash, and ends with the same batches.
struct SlotTable {
  std::uint64_t batch = 0;  ///< next batch to complete
  std::vector<SlotStart> slots;
  Ledger ledger;  ///< as after a crash at this moment: nothing outstanding, no partial batch
};

/// One task outside the batches.
struct EvaluationTask {
  StartSet start_set = StartSet::kGrid;
  std::uint32_t start_index = 0;
  bool greedy = true;
  std::uint64_t policy_version = 0;  ///< must be announced
  std::uint32_t steps = 0;           ///< upper limit, hold included
  std::uint32_t policy_steps = 0;    ///< the policy acts for at most so many
  std::uint32_t hold_steps = 0;      ///< at p_T, after arrival
  std::uint32_t frame_stride = 0;
};

/// Two workers that gave different results for one task: one of them computes wrongly, or another
/// build or scene.
struct AuditDifference {
  std::uint32_t slot = 0;
  std::uint64_t segment = 0;
  bool end_state = false;  ///< the environments ended differently, or else only what was told of it
  std::array<std::uint32_t, 2> worker_ids{};
};

enum class Verdict { kAdmitted, kDuplicate, kStale, kInvalid, kForeign };

/// Decides what is wanted and what counts (docs/learner.md 1, 2; docs/wire.md 2, 4.3); its Grants
/// decide who gets it. No DDS, no clock, no thread; times are nanoseconds of any steady clock and
/// never reach a result. The content of the batches depends on the configuration and the announced
/// weights only, not on workers or on the order, loss or repetition of segments.
///
/// Batch k is E segments with number k, one per slot. It is collected with weights v(k) = k with
/// lead 0, max(k - 1, 0) with lead 1; a slot gets its segment k when its own segment k - 1 is
/// admitted and weights v(k) are announced.
///
/// Failed segments (a lane went non-finite; the same on every worker) are not admitted: the slot
/// drops that episode and runs the same segment number again from a fresh one. See failures().
class TaskBook {
 public:
  /// A new run. Aborts unless 1 <= slots < kEvaluationSlot, steps >= 1, lead <= 1 and
  /// episode_decisions >= 1.
  explicit TaskBook(TaskBookConfig config);
  /// Continues from a checkpoint. Throws Error when the table does not fit the configuration.
  TaskBook(TaskBookConfig config, const SlotTable& table);

  /// Weights that workers can get now; the 64 highest versions are remembered. After a resume with
  /// lead 1 announce batch - 1 and batch.
  void announce_weights(std::uint64_t version, const Sha256& hash);

  // Workers, as Grants has them.
  void worker_joined(std::uint32_t worker_id, std::uint32_t lanes) {
    grants_.worker_joined(worker_id, lanes);
  }
  void worker_left(std::uint32_t worker_id) { grants_.worker_left(worker_id); }
  void worker_declined(std::uint32_t worker_id, const std::string& reason, std::int64_t now_ns) {
    grants_.worker_declined(worker_id, reason, now_ns);
  }
  std::vector<Barred> barred(std::int64_t now_ns) const { return grants_.barred(now_ns); }
  /// Tasks that it was granted and that are waited for.
  std::uint32_t grants_of(std::uint32_t worker_id) const { return grants_.live_of(worker_id); }
  void worker_silent(std::uint32_t worker_id, bool silent) {
    grants_.worker_silent(worker_id, silent);
  }

  /// Tasks to write now, grouped by worker (RolloutTask::worker_id), oldest batch first. Counted as
  /// granted: a caller that cannot write one reports it with undelivered().
  std::vector<RolloutTask> grant(std::int64_t now_ns);
  void undelivered(const RolloutTask& task);

  /// Judges one segment. Admitted ones are kept.
  Verdict receive(RolloutSegment segment, std::int64_t now_ns);
  /// Counts a segment that was dropped because the ring was full; its task is granted again.
  void overflowed(std::uint32_t slot, std::uint64_t task_hash);
  /// Counts segments that did not come from the process of the worker they name.
  void foreign(std::uint64_t count);
  /// Counts segments the wire layer refused.
  void refused(std::uint64_t count);
  /// Why the last invalid segment was refused; empty if none.
  const std::string& last_refusal() const { return last_refusal_; }

  /// Number of the batch being collected.
  std::uint64_t batch() const { return batch_; }
  std::uint32_t admitted_in_batch() const { return admitted_in_batch_; }
  bool batch_complete() const { return admitted_in_batch_ == config_.slots; }
  /// E segments in slot order; the next batch begins. Precondition: batch_complete().
  std::vector<RolloutSegment> take_batch();

  /// Adds tasks outside the batches. Aborts for an empty list, for weights that are not announced,
  /// and before the list of the last call was taken by take_evaluation().
  void evaluate(std::span<const EvaluationTask> tasks);
  bool evaluation_complete() const;
  /// The list as granted, in its order, without grant and worker; empty when nothing is evaluated.
  std::vector<RolloutTask> granted_evaluation() const;
  /// Results in the order of the list, failed ones included. Precondition: evaluation_complete().
  std::vector<RolloutSegment> take_evaluation();

  /// For a checkpoint; call between an update and the next take_batch().
  SlotTable table() const;
  Ledger ledger() const { return grants_.ledger(); }
  /// The equations of docs/wire.md 4.3; the failure lists all counters.
  Result<void> check_balance() const;
  double oldest_task_age_s(std::int64_t now_ns) const { return grants_.oldest_task_age_s(now_ns); }
  /// Diverged lanes since the start or resume, and the last reason.
  std::uint64_t failures() const { return grants_.counts().failed; }
  const std::string& last_failure() const { return last_failure_; }
  /// The first one of this session.
  const std::optional<AuditDifference>& audit_difference() const { return difference_; }

 private:
  struct Admitted {
    std::uint64_t task_hash = 0, end_hash = 0;
    std::uint32_t crc = 0, worker_id = 0;
  };
  struct Slot {
    /// Of segments batch_, batch_ + 1, ...; the last is not admitted yet.
    std::deque<SlotStart> starts;
    std::deque<RolloutSegment> done;   ///< of segments batch_, ...; one less than starts
    std::array<Admitted, 4> recent{};  ///< ring of results, to tell duplicates from strangers
    std::size_t recent_next = 0;
    RolloutTask task;        ///< wanted while grants_ has it open, by the number of the slot
    std::uint32_t home = 0;  ///< worker of the last result, if any
  };
  struct Evaluation {
    RolloutTask task;  ///< as that of a slot
    std::optional<RolloutSegment> result;
    Admitted admitted;
  };

  void check_config() const;
  void open_tasks();
  void open_task(std::uint32_t slot);
  void advance(std::uint32_t slot, RolloutSegment segment);
  void skip_episode(std::uint32_t slot, const RolloutSegment& segment);
  RolloutTask make_task(std::uint32_t slot, std::uint64_t segment, std::uint64_t version) const;
  const RolloutTask& task_of(std::uint32_t slot) const;
  const RolloutTask* find_open_task(std::uint32_t slot, std::uint64_t task_hash) const;
  const Admitted* find_admitted(std::uint32_t slot, std::uint64_t task_hash) const;
  Verdict refuse(const RolloutSegment& segment, const std::string& reason, std::int64_t now_ns);
  Verdict repeat(const Admitted& first, const RolloutSegment& segment);

  TaskBookConfig config_;
  Grants grants_;
  std::uint64_t batch_ = 0;
  std::vector<Slot> slots_;
  std::uint32_t admitted_in_batch_ = 0;  ///< slots with a result for batch_
  std::vector<Evaluation> evaluations_;
  std::uint64_t evaluation_round_ = 0;
  std::map<std::uint64_t, Sha256> versions_;
  std::string last_refusal_, last_failure_;
  std::optional<AuditDifference> difference_;
};

}  // namespace omentum
