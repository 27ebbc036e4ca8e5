#include "granting/grants.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <tuple>
#include <utility>

namespace omentum {
namespace {

constexpr double kAgeFactor = 4;            // x p95 of the worker, docs/wire.md 4.1
constexpr double kStragglerFactor = 1.5;    // x median: younger tasks are not late
constexpr double kStragglerFloorNs = 20e6;  // below this a second grant costs more than it saves
constexpr double kMaxSuspectNs = 60e9;
// A worker that declined or gave invalid results is tried again after this long, then twice it ...
constexpr std::int64_t kFirstBarNs = 10'000'000'000;
constexpr std::int64_t kMostBarNs = 320'000'000'000;
constexpr std::size_t kWorkerHistory = 32;  // results per worker in the age rule
constexpr std::size_t kAllHistory = 256;    // results in the straggler rule
constexpr std::uint64_t kInvalidToBar = 3;  // invalid results in a row

void remember(std::deque<double>& values, double value, std::size_t limit) {
  values.push_back(value);
  if (values.size() > limit) values.pop_front();
}

double quantile(const std::deque<double>& values, double p) {
  if (values.empty()) return 0;
  std::vector<double> sorted(values.begin(), values.end());
  const auto rank = static_cast<std::ptrdiff_t>(p * static_cast<double>(sorted.size() - 1));
  std::nth_element(sorted.begin(), sorted.begin() + rank, sorted.end());
  return sorted[static_cast<std::size_t>(rank)];
}

}  // namespace

// --- workers

Grants::Worker* Grants::find_worker(std::uint32_t worker_id) {
  const auto found = workers_.find(worker_id);
  return found == workers_.end() ? nullptr : &found->second;
}

void Grants::worker_joined(std::uint32_t worker_id, std::uint32_t lanes) {
  drop_worker_grants(worker_id);  // a restarted worker with the same id has none of them
  Worker worker;
  worker.lanes = std::max(lanes, std::uint32_t{1});
  workers_[worker_id] = std::move(worker);
}

void Grants::worker_left(std::uint32_t worker_id) {
  drop_worker_grants(worker_id);
  workers_.erase(worker_id);
}

void Grants::worker_declined(std::uint32_t worker_id, const std::string& reason,
                             std::int64_t now_ns) {
  drop_worker_grants(worker_id);
  Worker* worker = find_worker(worker_id);
  if (worker != nullptr && !reason.empty()) bar(*worker, reason, now_ns);
}

void Grants::bar(Worker& worker, const std::string& reason, std::int64_t now_ns) {
  worker.barred_for = reason;
  worker.barred_span_ns = std::clamp(2 * worker.barred_span_ns, kFirstBarNs, kMostBarNs);
  worker.barred_until_ns = now_ns + worker.barred_span_ns;
}

std::uint32_t Grants::live_of(std::uint32_t worker_id) const {
  const auto found = workers_.find(worker_id);
  return found == workers_.end() ? 0 : found->second.live;
}

std::vector<Barred> Grants::barred(std::int64_t now_ns) const {
  std::vector<Barred> all;
  for (const auto& [id, worker] : workers_) {
    if (worker.barred_until_ns <= now_ns) continue;
    all.push_back({.worker_id = id,
                   .reason = worker.barred_for,
                   .for_s = static_cast<double>(worker.barred_until_ns - now_ns) * 1e-9});
  }
  return all;
}

void Grants::worker_silent(std::uint32_t worker_id, bool silent) {
  if (Worker* worker = find_worker(worker_id)) worker->silent = silent;
}

void Grants::worker_answered(std::uint32_t worker_id) {
  if (Worker* worker = find_worker(worker_id))
    worker->suspect_until_ns = worker->suspect_span_ns = 0;
}

// --- tasks

Grants::Job* Grants::find_job(std::uint32_t task) {
  const auto found = jobs_.find(task);
  return found == jobs_.end() ? nullptr : &found->second;
}

void Grants::open(std::uint32_t task, const GrantTerms& terms) {
  Job job;
  job.task = task;
  job.terms = terms;
  jobs_.insert_or_assign(task, std::move(job));
}

bool Grants::all_granted() const {
  return std::ranges::all_of(jobs_, [](const auto& entry) {
    return std::ranges::any_of(entry.second.grants, [](const Grant& g) { return !g.lapsed; });
  });
}

void Grants::lapse(Grant& grant) {
  if (std::exchange(grant.lapsed, true)) return;
  if (Worker* worker = find_worker(grant.worker_id); worker != nullptr && worker->live > 0)
    --worker->live;
}

void Grants::lapse_all(std::uint32_t task) {
  if (Job* job = find_job(task)) lapse_if(*job, [](const Grant& /*every*/) { return true; });
}

void Grants::withdraw(std::uint32_t task) {
  Job* job = find_job(task);
  if (job == nullptr) return;
  ledger_.cancelled += job->grants.size();
  lapse_all(task);
  jobs_.erase(task);
}

void Grants::undelivered(std::uint32_t task, std::uint32_t number) {
  if (Job* job = find_job(task))
    lapse_if(*job, [number](const Grant& grant) { return grant.number == number; });
}

void Grants::drop_worker_grants(std::uint32_t worker_id) {
  for (auto& [task, job] : jobs_)
    lapse_if(job, [&](const Grant& grant) { return grant.worker_id == worker_id; });
}

double Grants::age_limit_ns(const Job& job, const Grant& grant) const {
  const auto worker = workers_.find(grant.worker_id);
  double per_step = worker == workers_.end() ? 0 : worker->second.ns_per_step_p95;
  if (per_step == 0) per_step = quantile(ns_per_step_, 0.95);
  const auto least = static_cast<double>(rules_.min_task_age_ns);
  double limit = per_step == 0 ? static_cast<double>(rules_.first_task_age_ns)
                               : std::max(least, kAgeFactor * per_step * job.terms.steps);
  // A task that was granted often is a slow one: the limit doubles every time.
  const int repeats = static_cast<int>(std::min(grant.number, std::uint32_t{6}));
  return std::ldexp(limit, repeats);
}

void Grants::mark_overdue(std::int64_t now_ns) {
  for (auto& [task, job] : jobs_) {
    for (Grant& grant : job.grants) {
      const auto age = static_cast<double>(now_ns - grant.at_ns);
      if (grant.lapsed || grant.overdue || age < static_cast<double>(rules_.min_task_age_ns)) {
        continue;
      }
      const double limit = age_limit_ns(job, grant);
      if (age <= limit) continue;
      grant.overdue = true;
      Worker* worker = find_worker(grant.worker_id);
      if (worker == nullptr || worker->suspect_until_ns > now_ns) continue;
      const double span = std::min(
          kMaxSuspectNs, std::max(limit, 2 * static_cast<double>(worker->suspect_span_ns)));
      worker->suspect_span_ns = static_cast<std::int64_t>(span);
      worker->suspect_until_ns = now_ns + worker->suspect_span_ns;
    }
  }
}

Grants::Need Grants::need_of(const Job& job, std::optional<std::uint64_t> late_rank,
                             std::int64_t now_ns) const {
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
  if (job.terms.audit && job.granted == 1) return Need::kAudit;
  if (late_rank != job.terms.rank) return Need::kNone;
  const double young =
      std::max(kStragglerFloorNs, kStragglerFactor * ns_per_step_median_ * job.terms.steps);
  return ns_per_step_median_ > 0 && oldest > young ? Need::kStraggler : Need::kNone;
}

std::optional<std::uint32_t> Grants::choose_worker(const Job& job, Need need,
                                                   std::int64_t now_ns) const {
  const auto holds = [&job](std::uint32_t id) {
    return std::any_of(job.grants.begin(), job.grants.end(),
                       [id](const Grant& grant) { return !grant.lapsed && grant.worker_id == id; });
  };
  std::optional<std::uint32_t> best;
  std::optional<std::uint32_t> best_suspect;
  bool others = false;  // there is a worker that is not suspect
  // A group costs the same however many of its lanes are used, and only tasks of one policy version
  // run together. So tasks fill one group before they begin another: first the worker with the
  // fewest groups; then the one that had the slot, whose other slots have the same version; then
  // the one with the fullest group. A group is a worker's part of the slots, at most its lanes.
  std::uint64_t all_lanes = 0;
  for (const auto& [id, worker] : workers_)
    all_lanes += worker.barred_until_ns > now_ns || worker.silent ? 0 : worker.lanes;
  const auto load = [&](std::uint32_t id) {
    const Worker& worker = workers_.at(id);
    const std::uint64_t slots =
        (std::uint64_t{rules_.slots} * worker.lanes + all_lanes - 1) / all_lanes;
    const std::uint64_t group = std::min<std::uint64_t>(slots, worker.lanes);
    return std::tuple(worker.live / group, id != job.terms.home, group - worker.live % group);
  };
  for (const auto& [id, worker] : workers_) {
    if (worker.barred_until_ns > now_ns || worker.silent || holds(id)) continue;
    const bool suspect = worker.suspect_until_ns > now_ns;
    others = others || !suspect;
    // A straggler's copy takes idle lanes; an audited batch costs every worker one group more.
    std::uint32_t most = credits(worker);
    if (need == Need::kStraggler) most = worker.lanes;
    if (need == Need::kAudit) most += worker.lanes;
    if (worker.live >= most) continue;
    std::optional<std::uint32_t>& place = suspect ? best_suspect : best;
    if (!place || load(id) < load(*place)) place = id;
  }
  if (best) return best;
  if (need == Need::kFirst) return others ? std::nullopt : best_suspect;
  if (need != Need::kOverdue || others) return std::nullopt;
  if (best_suspect) return best_suspect;
  // No other worker: after twice the limit the same one is granted it again.
  for (const Grant& grant : job.grants) {
    const auto worker = workers_.find(grant.worker_id);
    if (grant.lapsed || worker == workers_.end()) continue;
    if (worker->second.barred_until_ns > now_ns || worker->second.silent) continue;
    if (static_cast<double>(now_ns - grant.at_ns) > 2 * age_limit_ns(job, grant))
      return grant.worker_id;
  }
  return std::nullopt;
}

NewGrant Grants::add_grant(Job& job, std::uint32_t worker_id, std::int64_t now_ns) {
  // At most two live grants; a worker holds a task once (its reader keeps one sample per slot).
  const auto has_lapsed = [](const Grant& grant) { return grant.lapsed; };
  lapse_if(job, [&](const Grant& grant) {
    return grant.worker_id == worker_id ||
           std::count_if(job.grants.begin(), job.grants.end(), std::not_fn(has_lapsed)) >= 2;
  });
  const auto lapsed = std::find_if(job.grants.begin(), job.grants.end(), has_lapsed);
  if (lapsed != job.grants.end()) {
    job.grants.erase(lapsed);
    ++ledger_.regranted;
  }
  job.grants.push_back({.worker_id = worker_id, .number = job.granted, .at_ns = now_ns});
  ++workers_.at(worker_id).live;
  ++ledger_.granted;
  return {.task = job.task, .worker_id = worker_id, .number = job.granted++};
}

std::vector<NewGrant> Grants::grant(std::int64_t now_ns, std::optional<std::uint64_t> late_rank) {
  mark_overdue(now_ns);
  std::vector<std::pair<Job*, Need>> wanted;
  for (auto& [task, job] : jobs_) {
    const Need need = need_of(job, late_rank, now_ns);
    if (need != Need::kNone) wanted.emplace_back(&job, need);
  }
  std::stable_sort(wanted.begin(), wanted.end(), [](const auto& a, const auto& b) {
    return a.first->terms.rank < b.first->terms.rank;
  });
  std::vector<NewGrant> grants;
  const auto try_grant = [&](Job& job, Need need) {
    const std::optional<std::uint32_t> worker = choose_worker(job, need, now_ns);
    if (worker) grants.push_back(add_grant(job, *worker, now_ns));
  };
  for (auto& [job, need] : wanted) try_grant(*job, need);
  // An audited task is granted a second time at once.
  for (auto& [job, need] : wanted) {
    if (need == Need::kFirst && need_of(*job, late_rank, now_ns) == Need::kAudit)
      try_grant(*job, Need::kAudit);
  }
  std::stable_sort(grants.begin(), grants.end(),
                   [](const NewGrant& a, const NewGrant& b) { return a.worker_id < b.worker_id; });
  return grants;
}

// --- results

void Grants::settle(std::uint32_t task, std::uint32_t worker_id, std::uint32_t number,
                    std::int64_t now_ns, bool admitted) {
  Job* job = find_job(task);
  if (job == nullptr) return;
  const auto own = std::find_if(job->grants.begin(), job->grants.end(), [&](const Grant& grant) {
    return grant.worker_id == worker_id && grant.number == number;
  });
  if (own != job->grants.end()) {
    const auto turnaround = static_cast<double>(std::max<std::int64_t>(now_ns - own->at_ns, 1));
    const double per_step = turnaround / job->terms.steps;
    remember(ns_per_step_, per_step, kAllHistory);
    ns_per_step_median_ = quantile(ns_per_step_, 0.5);
    if (Worker* worker = find_worker(worker_id)) {
      remember(worker->ns_per_step, per_step, kWorkerHistory);
      worker->ns_per_step_p95 = quantile(worker->ns_per_step, 0.95);
      worker->invalid_in_row = 0;
    }
  }
  // A result of an earlier session or of a lapsed grant uses up any grant of the task.
  ledger_.cancelled += job->grants.size();
  if (admitted) {
    ++ledger_.admitted;
    if (job->grants.empty()) {
      ++ledger_.granted;  // granted in an earlier session of the learner
    } else {
      --ledger_.cancelled;
    }
  }
  lapse_all(task);
  jobs_.erase(task);
}

void Grants::refuse(std::uint32_t task, std::uint32_t worker_id, const std::string& reason,
                    std::int64_t now_ns) {
  if (Job* job = find_job(task))
    lapse_if(*job, [&](const Grant& grant) { return grant.worker_id == worker_id; });
  Worker* worker = find_worker(worker_id);
  if (worker != nullptr && ++worker->invalid_in_row >= kInvalidToBar)
    bar(*worker, "invalid results: " + reason, now_ns);
}

// --- accounts

Ledger Grants::ledger() const {
  Ledger ledger = ledger_;
  ledger.outstanding = 0;
  for (const auto& [task, job] : jobs_) ledger.outstanding += job.grants.size();
  return ledger;
}

bool Grants::balanced() const {
  const Ledger l = ledger();
  return l.received == l.admitted + l.duplicate + l.stale + l.invalid + l.foreign + l.overflow &&
         l.granted == l.admitted + l.outstanding + l.cancelled + l.regranted;
}

double Grants::oldest_task_age_s(std::int64_t now_ns) const {
  std::int64_t oldest = now_ns;
  for (const auto& [task, job] : jobs_) {
    for (const Grant& grant : job.grants) oldest = std::min(oldest, grant.at_ns);
  }
  return static_cast<double>(now_ns - oldest) * 1e-9;
}

}  // namespace omentum
