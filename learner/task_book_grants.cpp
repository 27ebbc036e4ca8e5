// Who gets which task, and when it is granted again.

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "learner/task_book.h"

namespace omentum {
namespace {

constexpr double kAgeFactor = 4;            // x p95 of the worker, docs/wire.md 4.1
constexpr double kStragglerShare = 0.9;     // of the batch admitted, docs/wire.md 4.1
constexpr double kStragglerFactor = 1.5;    // x median: younger tasks are just on their way
constexpr double kStragglerFloorNs = 20e6;  // below this a second grant costs more than it saves
constexpr double kMaxSuspectNs = 60e9;

}  // namespace

double TaskBook::age_limit_ns(const Job& job, const Grant& grant) const {
  const auto worker = workers_.find(grant.worker_id);
  double per_step = worker == workers_.end() ? 0 : worker->second.ns_per_step_p95;
  if (per_step == 0) per_step = quantile(ns_per_step_, 0.95);
  const auto least = static_cast<double>(config_.min_task_age_ns);
  double limit = per_step == 0 ? static_cast<double>(config_.first_task_age_ns)
                               : std::max(least, kAgeFactor * per_step * job.task.steps);
  // A task that was granted often is a slow task: be more patient every time.
  const int repeats = static_cast<int>(std::min(grant.number, std::uint32_t{6}));
  return std::ldexp(limit, repeats);
}

void TaskBook::mark_overdue(std::int64_t now_ns) {
  for_each_job([this, now_ns](Job& job) {
    for (Grant& grant : job.grants) {
      const auto age = static_cast<double>(now_ns - grant.at_ns);
      if (grant.lapsed || grant.overdue || age < static_cast<double>(config_.min_task_age_ns)) {
        continue;
      }
      const double limit = age_limit_ns(job, grant);
      if (age <= limit) continue;
      grant.overdue = true;
      const auto found = workers_.find(grant.worker_id);
      if (found == workers_.end() || found->second.suspect_until_ns > now_ns) continue;
      Worker& worker = found->second;
      const double span =
          std::min(kMaxSuspectNs, std::max(limit, 2 * static_cast<double>(worker.suspect_span_ns)));
      worker.suspect_span_ns = static_cast<std::int64_t>(span);
      worker.suspect_until_ns = now_ns + worker.suspect_span_ns;
    }
  });
}

TaskBook::Need TaskBook::need_of(const Job& job, std::int64_t now_ns) const {
  std::size_t live = 0;
  bool all_overdue = true;
  double oldest = 0;
  for (const Grant& grant : job.grants) {
    if (grant.lapsed) continue;
    ++live;
    all_overdue = all_overdue && grant.overdue;
    oldest = std::max(oldest, static_cast<double>(now_ns - grant.at_ns));
  }
  if (live == 0) return Need::kFirst;
  if (all_overdue) return Need::kOverdue;
  if (live > 1) return Need::kNone;
  if (job.audit && job.granted == 1) return Need::kAudit;
  if (job.task.slot >= kEvaluationSlot || job.task.segment != batch_) return Need::kNone;
  const bool late_phase = admitted_in_batch_ >= kStragglerShare * config_.slots;
  const double young =
      std::max(kStragglerFloorNs, kStragglerFactor * ns_per_step_median_ * job.task.steps);
  const bool straggles = late_phase && ns_per_step_median_ > 0 && oldest > young;
  return straggles ? Need::kStraggler : Need::kNone;
}

std::optional<std::uint32_t> TaskBook::choose_worker(const Job& job, Need need,
                                                     std::int64_t now_ns) const {
  const auto holds = [&job](std::uint32_t id) {
    return std::any_of(job.grants.begin(), job.grants.end(),
                       [id](const Grant& grant) { return !grant.lapsed && grant.worker_id == id; });
  };
  std::optional<std::uint32_t> best;
  std::optional<std::uint32_t> best_suspect;
  bool others = false;  // is there anyone else at all?
  // A group costs the same however many of its lanes are taken, and only tasks of one policy
  // version run together. So tasks fill one group before they begin another: the fewest groups
  // first; then the worker that had the slot, whose other slots are as far; then the fullest group.
  // A group is a worker's share of the slots, at most its lanes.
  std::uint64_t all_lanes = 0;
  for (const auto& [id, worker] : workers_)
    all_lanes += worker.barred || worker.silent ? 0 : worker.lanes;
  const auto load = [&](std::uint32_t id) {
    const Worker& worker = workers_.at(id);
    const std::uint64_t share =
        (std::uint64_t{config_.slots} * worker.lanes + all_lanes - 1) / all_lanes;
    const std::uint64_t group = std::min<std::uint64_t>(share, worker.lanes);
    return std::tuple(worker.live / group, id != job.home, group - worker.live % group);
  };
  const auto better = [&load](std::uint32_t id, const std::optional<std::uint32_t>& than) {
    return !than || load(id) < load(*than);
  };
  for (const auto& [id, worker] : workers_) {
    if (worker.barred || worker.silent || holds(id)) continue;
    const bool suspect = worker.suspect_until_ns > now_ns;
    others = others || !suspect;
    const bool spare = need == Need::kAudit || need == Need::kStraggler;
    if (worker.live >= (spare ? worker.lanes : credits(worker))) continue;
    std::optional<std::uint32_t>& place = suspect ? best_suspect : best;
    if (better(id, place)) place = id;
  }
  if (best) return best;
  if (need == Need::kFirst) return others ? std::nullopt : best_suspect;
  if (need != Need::kOverdue || others) return std::nullopt;
  if (best_suspect) return best_suspect;
  // Nobody else: after twice the limit the same worker gets it again, in case it never arrived.
  for (const Grant& grant : job.grants) {
    const auto worker = workers_.find(grant.worker_id);
    if (grant.lapsed || worker == workers_.end()) continue;
    if (worker->second.barred || worker->second.silent) continue;
    if (static_cast<double>(now_ns - grant.at_ns) > 2 * age_limit_ns(job, grant)) {
      return grant.worker_id;
    }
  }
  return std::nullopt;
}

RolloutTask TaskBook::write_grant(Job& job, std::uint32_t worker_id, std::int64_t now_ns) {
  // At most two live grants; a worker holds a task once (its reader keeps one sample per slot).
  const auto live = [&job] {
    return std::count_if(job.grants.begin(), job.grants.end(),
                         [](const Grant& grant) { return !grant.lapsed; });
  };
  for (Grant& grant : job.grants) {
    if (!grant.lapsed && (grant.worker_id == worker_id || live() >= 2)) lapse(grant);
  }
  const auto lapsed = std::find_if(job.grants.begin(), job.grants.end(),
                                   [](const Grant& grant) { return grant.lapsed; });
  if (lapsed != job.grants.end()) {
    job.grants.erase(lapsed);
    ++ledger_.regranted;
  }
  job.grants.push_back({.worker_id = worker_id, .number = job.granted, .at_ns = now_ns});
  ++workers_.at(worker_id).live;
  ++ledger_.granted;

  RolloutTask task = job.task;
  task.worker_id = worker_id;
  task.grant = job.granted++;
  task.granted_at_ns = now_ns;
  if (task.slot < slots_.size()) task.start_state = slots_[task.slot].starts.back().state;
  return task;
}

std::vector<RolloutTask> TaskBook::grant(std::int64_t now_ns) {
  mark_overdue(now_ns);
  std::vector<std::pair<Job*, Need>> wanted;
  for_each_job([&](Job& job) {
    const Need need = need_of(job, now_ns);
    if (need != Need::kNone) wanted.emplace_back(&job, need);
  });
  // Evaluation last, then by segment and slot; for_each_job already yields slots in order.
  std::stable_sort(wanted.begin(), wanted.end(), [](const auto& a, const auto& b) {
    const auto key = [](const auto& entry) {
      const RolloutTask& task = entry.first->task;
      return std::pair(task.slot >= kEvaluationSlot, task.segment);
    };
    return key(a) < key(b);
  });
  std::vector<RolloutTask> tasks;
  for (auto& [job, need] : wanted) {
    const std::optional<std::uint32_t> worker = choose_worker(*job, need, now_ns);
    if (worker) tasks.push_back(write_grant(*job, *worker, now_ns));
  }
  // An audited task is granted a second time at once.
  for (auto& [job, need] : wanted) {
    if (need != Need::kFirst || need_of(*job, now_ns) != Need::kAudit) continue;
    const std::optional<std::uint32_t> worker = choose_worker(*job, Need::kAudit, now_ns);
    if (worker) tasks.push_back(write_grant(*job, *worker, now_ns));
  }
  std::stable_sort(tasks.begin(), tasks.end(), [](const RolloutTask& a, const RolloutTask& b) {
    return a.worker_id < b.worker_id;
  });
  return tasks;
}

void TaskBook::undelivered(const RolloutTask& task) {
  Job* job = find_job(task.slot);
  if (job == nullptr || !job->open || job->task.task_hash != task.task_hash) return;
  for (Grant& grant : job->grants) {
    if (grant.number == task.grant) lapse(grant);
  }
}

}  // namespace omentum
