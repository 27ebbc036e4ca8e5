#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/types.h"

// granting/ decides which worker gets which task and when it is granted again, the same for the
// rollouts of a learner and the simulations of mismatch.

namespace omentum {

/// How, not what: never changes a result.
struct GrantRules {
  std::uint32_t slots = 1;  ///< tasks that are open at a time: how they spread over lanes
  std::uint32_t ahead = 0;  ///< of each worker's lanes, so many times more tasks are granted to it
  std::int64_t min_task_age_ns = 1'000'000'000;     ///< no task is granted again earlier
  std::int64_t first_task_age_ns = 15'000'000'000;  ///< limit while no time of a task is known
};

/// A worker that gets no task for a while.
struct Barred {
  std::uint32_t worker_id = 0;
  std::string reason;
  double for_s = 0;  ///< from now on
};

/// A task as far as granting looks at it.
struct GrantTerms {
  std::uint64_t rank = 0;   ///< tasks of a lower one are granted first
  std::uint32_t steps = 1;  ///< how much work it is
  bool audit = false;       ///< granted twice, to compare the results
  std::uint32_t home = 0;   ///< worker that gets it if it is as good as another; 0 = none
};

struct NewGrant {
  std::uint32_t task = 0;
  std::uint32_t worker_id = 0;
  std::uint32_t number = 0;  ///< of this task's grants, from 0
};

/// Which worker gets which task, and when it is granted again (docs/wire.md 1, 4.1). Tasks have
/// numbers that the caller chooses; what they are and what came back is the caller's. No DDS, no
/// clock, no thread; times are nanoseconds of any steady clock.
class Grants {
 public:
  explicit Grants(const GrantRules& rules) : rules_(rules) {}

  // Workers. Ids are arbitrary; unknown ones are ignored.
  void worker_joined(std::uint32_t worker_id, std::uint32_t lanes);
  /// Gone, on purpose or not: its tasks are granted again at once.
  void worker_left(std::uint32_t worker_id);
  /// It declined tasks: they are granted again. With a reason it is barred, for longer each time,
  /// and so it is after results that are invalid one after the other.
  void worker_declined(std::uint32_t worker_id, const std::string& reason, std::int64_t now_ns);
  /// Silent: it gets nothing new until it speaks again. Its tasks are left to the age rule.
  void worker_silent(std::uint32_t worker_id, bool silent);
  /// It gave a result of whatever kind: it is not suspected any more.
  void worker_answered(std::uint32_t worker_id);
  std::vector<Barred> barred(std::int64_t now_ns) const;
  /// Grants of it that are waited for.
  std::uint32_t live_of(std::uint32_t worker_id) const;

  /// Wants a task. A task of the same number is forgotten, its grants too.
  void open(std::uint32_t task, const GrantTerms& terms);
  bool is_open(std::uint32_t task) const { return jobs_.contains(task); }
  std::size_t open_tasks() const { return jobs_.size(); }
  /// Whether no open task waits for its first grant or another one after it.
  bool all_granted() const;
  /// Grants to write now, grouped by worker, lowest rank first. Tasks of `late_rank` hold up the
  /// others: where they take long they are granted a second time to idle lanes. A caller that
  /// cannot write one calls undelivered().
  std::vector<NewGrant> grant(std::int64_t now_ns, std::optional<std::uint64_t> late_rank);
  void undelivered(std::uint32_t task, std::uint32_t number);
  /// All grants of a task are waited for no more: it is granted again.
  void lapse_all(std::uint32_t task);
  /// Its task is not wanted any more.
  void withdraw(std::uint32_t task);

  /// A result of an open task is there, which is closed by it. Not `admitted`: the task is over and
  /// nothing came of it.
  void settle(std::uint32_t task, std::uint32_t worker_id, std::uint32_t number,
              std::int64_t now_ns, bool admitted);
  /// A result that is not one: of this worker the task is waited for no more.
  void refuse(std::uint32_t task, std::uint32_t worker_id, const std::string& reason,
              std::int64_t now_ns);

  /// What the caller counts as well: received, duplicate, stale, invalid, ...
  Ledger& counts() { return ledger_; }
  const Ledger& counts() const { return ledger_; }
  Ledger ledger() const;
  /// The first two equations of docs/wire.md 4.3.
  bool balanced() const;
  double oldest_task_age_s(std::int64_t now_ns) const;

 private:
  struct Grant {
    std::uint32_t worker_id = 0;
    std::uint32_t number = 0;
    std::int64_t at_ns = 0;
    bool lapsed = false;   ///< not waited for; counted as regranted when the replacement is written
    bool overdue = false;  ///< older than its limit
  };
  // One task until its result is there. At most two grants are not lapsed.
  struct Job {
    std::uint32_t task = 0;
    GrantTerms terms;
    std::vector<Grant> grants;
    std::uint32_t granted = 0;
  };
  struct Worker {
    std::uint32_t lanes = 0;
    std::uint32_t live = 0;
    std::deque<double> ns_per_step;  ///< grant to result by the steps asked for; newest last
    double ns_per_step_p95 = 0;      ///< 0 = unknown
    std::uint64_t invalid_in_row = 0;
    std::int64_t suspect_until_ns = 0;
    std::int64_t suspect_span_ns = 0;
    bool silent = false;
    std::string barred_for;  ///< reason of the last bar
    std::int64_t barred_until_ns = 0;
    std::int64_t barred_span_ns = 0;  ///< of the last bar; 0 = none yet
  };

  Job* find_job(std::uint32_t task);
  Worker* find_worker(std::uint32_t worker_id);
  std::uint32_t credits(const Worker& worker) const { return worker.lanes * (1 + rules_.ahead); }
  double age_limit_ns(const Job& job, const Grant& grant) const;
  void mark_overdue(std::int64_t now_ns);
  enum class Need { kNone, kFirst, kAudit, kOverdue, kStraggler };
  Need need_of(const Job& job, std::optional<std::uint64_t> late_rank, std::int64_t now_ns) const;
  std::optional<std::uint32_t> choose_worker(const Job& job, Need need, std::int64_t now_ns) const;
  NewGrant add_grant(Job& job, std::uint32_t worker_id, std::int64_t now_ns);
  void lapse(Grant& grant);
  template <typename Predicate>
  void lapse_if(Job& job, Predicate&& predicate) {
    for (Grant& grant : job.grants) {
      if (predicate(grant)) lapse(grant);
    }
  }
  void drop_worker_grants(std::uint32_t worker_id);
  static void bar(Worker& worker, const std::string& reason, std::int64_t now_ns);

  GrantRules rules_;
  std::map<std::uint32_t, Job> jobs_;  ///< open ones, by their number
  std::map<std::uint32_t, Worker> workers_;
  std::deque<double> ns_per_step_;  ///< of all workers, recent
  double ns_per_step_median_ = 0;   ///< 0 = unknown
  Ledger ledger_;                   ///< outstanding is derived
};

}  // namespace omentum
