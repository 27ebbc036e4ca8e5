#include "learner/task_book.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "core/hash.h"
#include "core/segment_fields.h"
#include "learner/segment_check.h"

namespace omentum {
namespace {

constexpr std::size_t kWorkerHistory = 32;  // results per worker in the age rule
constexpr std::size_t kBookHistory = 256;   // results in the straggler rule
constexpr std::size_t kKnownVersions = 64;  // announced weights remembered
constexpr std::uint64_t kInvalidToBar = 3;  // invalid results in a row

void remember(std::deque<double>& values, double value, std::size_t limit) {
  values.push_back(value);
  if (values.size() > limit) values.pop_front();
}

// Whole batches are audited, since a group of a worker costs the same with one task as with all its
// lanes. Multiples of the golden ratio spread them evenly, from the first batch on.
bool chosen_for_audit(std::uint64_t batch, double rate) {
  const std::uint64_t mixed = batch * 0x9e3779b97f4a7c15ULL;  // 2^64 / golden ratio
  return static_cast<double>(mixed >> 11) * 0x1p-53 < rate;
}

}  // namespace

// --- start, resume

TaskBook::TaskBook(TaskBookConfig config) : config_(std::move(config)) {
  check_config();
  slots_.resize(config_.slots);
  const std::uint64_t episode = config_.episode_decisions;
  for (std::uint64_t s = 0; s < config_.slots; ++s) {
    SlotStart& start = slots_[s].starts.emplace_back();
    if (config_.stagger) {
      start.episode_limit =
          static_cast<std::uint32_t>((episode * (s + 1) + config_.slots - 1) / config_.slots);
    }
  }
}

TaskBook::TaskBook(TaskBookConfig config, const SlotTable& table)
    : config_(std::move(config)), batch_(table.batch), ledger_(table.ledger) {
  check_config();
  if (table.slots.size() != config_.slots) {
    throw_error("checkpoint has {} slots, the configuration {}", table.slots.size(), config_.slots);
  }
  slots_.resize(config_.slots);
  for (std::size_t s = 0; s < slots_.size(); ++s) {
    const SlotStart& start = table.slots[s];
    if (start.segment != batch_ || start.reset != start.state.empty()) {
      throw_error("checkpoint: slot {} starts segment {} of batch {}", s, start.segment, batch_);
    }
    slots_[s].starts.push_back(start);
  }
}

void TaskBook::check_config() const {
  OMENTUM_CHECK(config_.slots >= 1 && config_.slots < kEvaluationSlot && config_.steps >= 1);
  OMENTUM_CHECK(config_.lead <= 1 && config_.episode_decisions >= 1);
}

void TaskBook::announce_weights(std::uint64_t version, const Sha256& hash) {
  versions_[version] = hash;
  if (versions_.size() > kKnownVersions) versions_.erase(versions_.begin());
  open_jobs();
}

// --- jobs

TaskBook::Job* TaskBook::find_job(std::uint32_t slot) {
  if (slot < slots_.size()) return &slots_[slot].job;
  if (slot >= kEvaluationSlot && slot - kEvaluationSlot < evaluations_.size())
    return &evaluations_[slot - kEvaluationSlot].job;
  return nullptr;
}

TaskBook::Job* TaskBook::find_open_job(std::uint32_t slot, std::uint64_t task_hash) {
  Job* job = find_job(slot);
  return job != nullptr && job->open && job->task.task_hash == task_hash ? job : nullptr;
}

const TaskBook::Admitted* TaskBook::find_admitted(std::uint32_t slot,
                                                  std::uint64_t task_hash) const {
  if (task_hash == 0) return nullptr;
  if (slot < slots_.size()) {
    for (const Admitted& result : slots_[slot].recent) {
      if (result.task_hash == task_hash) return &result;
    }
  } else if (slot >= kEvaluationSlot && slot - kEvaluationSlot < evaluations_.size()) {
    const Admitted& result = evaluations_[slot - kEvaluationSlot].admitted;
    if (result.task_hash == task_hash) return &result;
  }
  return nullptr;
}

/// Precondition: the weights are announced.
RolloutTask TaskBook::make_task(std::uint32_t slot, std::uint64_t segment,
                                std::uint64_t version) const {
  RolloutTask task;
  task.slot = slot;
  task.segment = segment;
  task.learner_epoch = config_.learner_epoch;
  task.policy_version = version;
  task.weights_hash = versions_.at(version);
  task.config_hash = config_.config_hash;
  task.run_seed = config_.run_seed;
  task.state_format = config_.state_format;
  return task;
}

void TaskBook::open_jobs() {
  for (std::uint32_t s = 0; s < slots_.size(); ++s) {
    if (!slots_[s].job.open) open_job(s);
  }
}

void TaskBook::open_job(std::uint32_t slot) {
  const SlotStart& start = slots_[slot].starts.back();
  if (config_.batches > 0 && start.segment >= config_.batches) return;
  const std::uint64_t version =
      start.segment >= config_.lead ? start.segment - config_.lead : std::uint64_t{0};
  if (!versions_.contains(version)) return;

  Job job;
  job.open = true;
  job.home = slots_[slot].job.home;
  RolloutTask& task = job.task = make_task(slot, start.segment, version);
  task.steps = config_.steps;
  task.episode = start.episode;
  task.episode_step = start.episode_step;
  task.episode_limit = start.episode_limit;
  task.reset = start.reset;
  task.start_hash = start.hash;  // the state itself is added when the grant is written
  task.task_hash = hash_task(task);
  job.audit = chosen_for_audit(start.segment, config_.audit_rate);
  slots_[slot].job = std::move(job);
}

void TaskBook::advance(std::uint32_t slot, RolloutSegment segment) {
  Slot& row = slots_[slot];
  SlotStart& next = row.starts.emplace_back();
  next.segment = segment.segment + 1;
  next.episode = segment.end_episode;
  next.episode_step = segment.end_episode_step;
  next.episode_limit = segment.end_episode_limit;
  next.reset = segment.end_state.empty();
  next.hash = next.reset ? 0 : segment.end_hash;
  next.state = std::move(segment.end_state);  // the batch has no use for it
  row.done.push_back(std::move(segment));
  if (row.done.size() == 1) ++admitted_in_batch_;
  open_job(slot);
}

void TaskBook::skip_episode(std::uint32_t slot, const RolloutSegment& segment) {
  SlotStart& start = slots_[slot].starts.back();
  SlotStart fresh;
  fresh.segment = start.segment;
  fresh.episode = start.episode + segment.episode_end_step.size() + 1;
  start = std::move(fresh);
  open_job(slot);
}

// --- admission

Verdict TaskBook::refuse(Job& job, const RolloutSegment& segment, const std::string& reason,
                         std::int64_t now_ns) {
  ++ledger_.invalid;
  last_refusal_ = fmt::format("slot={} segment={} worker={} build={:016x}: {}", segment.slot,
                              segment.segment, segment.worker_id, segment.build_id, reason);
  lapse_if(job, [&](const Grant& grant) { return grant.worker_id == segment.worker_id; });
  Worker* worker = find_worker(segment.worker_id);
  if (worker != nullptr && ++worker->invalid_in_row >= kInvalidToBar) {
    bar(*worker, "invalid results: " + reason, now_ns);
  }
  return Verdict::kInvalid;
}

Verdict TaskBook::repeat(const Admitted& first, const RolloutSegment& segment) {
  // Every duplicate is an audit, unless it was damaged on its way.
  if (segment_crc(segment) != segment.payload_crc32c) {
    ++ledger_.invalid;
    last_refusal_ = fmt::format("slot={} segment={} worker={}: CRC of a duplicate", segment.slot,
                                segment.segment, segment.worker_id);
    return Verdict::kInvalid;
  }
  ++ledger_.duplicate;
  const bool end_state = first.end_hash != segment.end_hash;
  if (end_state || first.crc != segment.payload_crc32c) {
    ++ledger_.audit_mismatch;
    if (!difference_) {
      difference_ = {
          segment.slot, segment.segment, end_state, {first.worker_id, segment.worker_id}};
    }
  }
  return Verdict::kDuplicate;
}

void TaskBook::settle(Job& job, const RolloutSegment& segment, std::int64_t now_ns, bool admitted) {
  auto own = std::find_if(job.grants.begin(), job.grants.end(), [&segment](const Grant& grant) {
    return grant.worker_id == segment.worker_id && grant.number == segment.grant;
  });
  if (own != job.grants.end()) {
    const auto turnaround = static_cast<double>(std::max<std::int64_t>(now_ns - own->at_ns, 1));
    const double per_step = turnaround / job.task.steps;
    remember(ns_per_step_, per_step, kBookHistory);
    ns_per_step_median_ = quantile(ns_per_step_, 0.5);
    if (Worker* worker = find_worker(segment.worker_id)) {
      remember(worker->ns_per_step, per_step, kWorkerHistory);
      worker->ns_per_step_p95 = quantile(worker->ns_per_step, 0.95);
      worker->invalid_in_row = 0;
    }
  }
  // A result of an earlier session or of a lapsed grant uses up any grant of the task.
  ledger_.cancelled += job.grants.size();
  if (admitted) {
    ++ledger_.admitted;
    if (job.grants.empty()) {
      ++ledger_.granted;  // granted in an earlier session of the learner
    } else {
      --ledger_.cancelled;
    }
  }
  lapse_if(job, [](const Grant& /*every*/) { return true; });
  job.grants.clear();
  job.home = segment.worker_id;
  job.open = false;
}

Verdict TaskBook::receive(RolloutSegment segment, std::int64_t now_ns) {
  ++ledger_.received;
  if (segment.source != Source::kSimulation || segment.slot >= kForeignSlot) {
    ++ledger_.foreign;
    return Verdict::kForeign;
  }
  if (Worker* worker = find_worker(segment.worker_id))
    worker->suspect_until_ns = worker->suspect_span_ns = 0;
  Job* job = find_open_job(segment.slot, segment.task_hash);
  if (job == nullptr) {
    if (const Admitted* first = find_admitted(segment.slot, segment.task_hash))
      return repeat(*first, segment);
    ++ledger_.stale;
    return Verdict::kStale;
  }
  if (const Result<void> ok = check_segment(segment, config_.shape, job->task); !ok) {
    return refuse(*job, segment, ok.error(), now_ns);
  }

  const Admitted record{segment.task_hash, segment.end_hash, segment.payload_crc32c,
                        segment.worker_id};
  if (segment.slot >= kEvaluationSlot) {
    settle(*job, segment, now_ns, true);
    ++ledger_.evaluated;
    Evaluation& evaluation = evaluations_[segment.slot - kEvaluationSlot];
    evaluation.admitted = record;
    // A recorded evaluation keeps its observations; of one that is only judged pictures would fill
    // the memory.
    if (evaluation.job.task.frame_stride == 0) segment.observations = {};
    evaluation.result = std::move(segment);
    return Verdict::kAdmitted;
  }
  Slot& slot = slots_[segment.slot];
  slot.recent[slot.recent_next++ % slot.recent.size()] = record;
  settle(*job, segment, now_ns, segment.failed == 0);
  if (segment.failed != 0) {
    ++ledger_.invalid;
    ++ledger_.failed;
    last_failure_ =
        fmt::format("slot={} segment={} episode={} worker={}: {}", segment.slot, segment.segment,
                    segment.end_episode, segment.worker_id, segment.failure);
    skip_episode(segment.slot, segment);
    return Verdict::kInvalid;
  }
  const std::uint32_t at = segment.slot;
  advance(at, std::move(segment));
  return Verdict::kAdmitted;
}

void TaskBook::overflowed(std::uint32_t slot, std::uint64_t task_hash) {
  ++ledger_.received;
  ++ledger_.overflow;
  if (Job* job = find_open_job(slot, task_hash))
    lapse_if(*job, [](const Grant& /*every*/) { return true; });
}

void TaskBook::foreign(std::uint64_t count) {
  ledger_.received += count;
  ledger_.foreign += count;
}

void TaskBook::refused(std::uint64_t count) {
  ledger_.received += count;
  ledger_.invalid += count;
}

// --- batches

std::vector<RolloutSegment> TaskBook::take_batch() {
  OMENTUM_CHECK(batch_complete(), "batch {}: {} of {}", batch_, admitted_in_batch_, config_.slots);
  std::vector<RolloutSegment> segments;
  segments.reserve(slots_.size());
  for (Slot& slot : slots_) {
    segments.push_back(std::move(slot.done.front()));
    slot.done.pop_front();
    slot.starts.pop_front();
    if (slot.done.empty()) --admitted_in_batch_;
  }
  ++batch_;
  open_jobs();
  return segments;
}

void TaskBook::evaluate(std::span<const EvaluationTask> tasks) {
  OMENTUM_CHECK(evaluations_.empty() && !tasks.empty());
  OMENTUM_CHECK(tasks.size() < kForeignSlot - kEvaluationSlot);
  for (std::uint32_t i = 0; i < tasks.size(); ++i) {
    const EvaluationTask& from = tasks[i];
    OMENTUM_CHECK(versions_.contains(from.policy_version), "weights {} not announced",
                  from.policy_version);
    Evaluation evaluation;
    evaluation.job.open = true;
    RolloutTask& task = evaluation.job.task =
        make_task(kEvaluationSlot + i, evaluation_round_, from.policy_version);
    task.kind = TaskKind::kEvaluate;
    task.greedy = from.greedy;
    task.start_set = from.start_set;
    task.start_index = from.start_index;
    task.steps = from.steps;
    task.policy_steps = from.policy_steps;
    task.hold_steps = from.hold_steps;
    task.episode_limit = from.steps;
    task.reset = true;
    task.frame_stride = from.frame_stride;
    task.task_hash = hash_task(task);
    evaluations_.push_back(std::move(evaluation));
  }
  ++evaluation_round_;
}

bool TaskBook::evaluation_complete() const {
  return !evaluations_.empty() &&
         std::all_of(evaluations_.begin(), evaluations_.end(),
                     [](const Evaluation& e) { return e.result.has_value(); });
}

std::vector<RolloutTask> TaskBook::granted_evaluation() const {
  std::vector<RolloutTask> tasks;
  for (const Evaluation& evaluation : evaluations_) tasks.push_back(evaluation.job.task);
  return tasks;
}

std::vector<RolloutSegment> TaskBook::take_evaluation() {
  OMENTUM_CHECK(evaluation_complete());
  std::vector<RolloutSegment> results;
  results.reserve(evaluations_.size());
  for (Evaluation& evaluation : evaluations_) results.push_back(std::move(*evaluation.result));
  evaluations_.clear();
  return results;
}

// --- accounts

Ledger TaskBook::ledger() const {
  Ledger ledger = ledger_;
  ledger.outstanding = 0;
  for_each_job([&ledger](const Job& job) { ledger.outstanding += job.grants.size(); });
  return ledger;
}

Result<void> TaskBook::check_balance() const {
  const Ledger l = ledger();
  std::uint64_t stored = 0;
  for (const Slot& slot : slots_) stored += slot.done.size();
  const bool balanced =
      l.received == l.admitted + l.duplicate + l.stale + l.invalid + l.foreign + l.overflow &&
      l.granted == l.admitted + l.outstanding + l.cancelled + l.regranted &&
      l.admitted == batch_ * config_.slots + stored + l.evaluated;
  if (balanced) return {};
  std::string text = fmt::format("ledger of batch {} with {} of the next", batch_, stored);
  for (const auto& [name, value] : kLedgerCounters) text += fmt::format(" {}={}", name, l.*value);
  return Failure{text};
}

SlotTable TaskBook::table() const {
  SlotTable table;
  table.batch = batch_;
  table.ledger = ledger();
  std::uint64_t stored = 0;
  for (const Slot& slot : slots_) {
    table.slots.push_back(slot.starts.front());
    stored += slot.done.size();
  }
  // After a crash now these results are gone and will be collected again.
  table.ledger.admitted -= stored;
  table.ledger.stale += stored;
  table.ledger.cancelled += stored + table.ledger.outstanding;
  table.ledger.outstanding = 0;
  return table;
}

}  // namespace omentum
