#include "learner/task_book.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "core/check.h"
#include "core/hash.h"
#include "core/segment_fields.h"
#include "learner/segment_check.h"

namespace omentum {
namespace {

constexpr std::size_t kKnownVersions = 64;  // announced weights remembered
constexpr double kStragglerShare = 0.9;     // of the batch admitted, docs/wire.md 4.1
// Evaluation tasks are granted last.
constexpr std::uint64_t kEvaluationRank = std::numeric_limits<std::uint64_t>::max();

GrantRules rules_of(const TaskBookConfig& config) {
  return {config.slots, config.lead, config.min_task_age_ns, config.first_task_age_ns};
}

// Whole batches are audited, since a group of a worker costs the same with one task as with all its
// lanes. Multiples of the golden ratio spread them evenly, from the first batch on.
bool chosen_for_audit(std::uint64_t batch, double rate) {
  const std::uint64_t mixed = batch * 0x9e3779b97f4a7c15ULL;  // 2^64 / golden ratio
  return static_cast<double>(mixed >> 11) * 0x1p-53 < rate;
}

}  // namespace

// --- start, resume

TaskBook::TaskBook(TaskBookConfig config) : config_(std::move(config)), grants_(rules_of(config_)) {
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
    : config_(std::move(config)), grants_(rules_of(config_)), batch_(table.batch) {
  check_config();
  grants_.counts() = table.ledger;
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
  open_tasks();
}

// --- tasks

const RolloutTask& TaskBook::task_of(std::uint32_t slot) const {
  return slot < slots_.size() ? slots_[slot].task : evaluations_[slot - kEvaluationSlot].task;
}

const RolloutTask* TaskBook::find_open_task(std::uint32_t slot, std::uint64_t task_hash) const {
  if (!grants_.is_open(slot)) return nullptr;
  const RolloutTask& task = task_of(slot);
  return task.task_hash == task_hash ? &task : nullptr;
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

void TaskBook::open_tasks() {
  for (std::uint32_t s = 0; s < slots_.size(); ++s) {
    if (!grants_.is_open(s)) open_task(s);
  }
}

void TaskBook::open_task(std::uint32_t slot) {
  const SlotStart& start = slots_[slot].starts.back();
  if (config_.batches > 0 && start.segment >= config_.batches) return;
  const std::uint64_t version =
      start.segment >= config_.lead ? start.segment - config_.lead : std::uint64_t{0};
  if (!versions_.contains(version)) return;

  RolloutTask& task = slots_[slot].task = make_task(slot, start.segment, version);
  task.steps = config_.steps;
  task.episode = start.episode;
  task.episode_step = start.episode_step;
  task.episode_limit = start.episode_limit;
  task.reset = start.reset;
  task.start_hash = start.hash;  // the state itself is added when the grant is written
  task.task_hash = hash_task(task);
  grants_.open(slot, {.rank = task.segment,
                      .steps = task.steps,
                      .audit = chosen_for_audit(start.segment, config_.audit_rate),
                      .home = slots_[slot].home});
}

std::vector<RolloutTask> TaskBook::grant(std::int64_t now_ns) {
  const bool late = admitted_in_batch_ >= kStragglerShare * config_.slots;
  std::vector<RolloutTask> tasks;
  for (const NewGrant& grant : grants_.grant(now_ns, late ? std::optional(batch_) : std::nullopt)) {
    RolloutTask& task = tasks.emplace_back(task_of(grant.task));
    task.worker_id = grant.worker_id;
    task.grant = grant.number;
    task.granted_at_ns = now_ns;
    if (task.slot < slots_.size()) task.start_state = slots_[task.slot].starts.back().state;
  }
  return tasks;
}

void TaskBook::undelivered(const RolloutTask& task) {
  if (find_open_task(task.slot, task.task_hash) != nullptr)
    grants_.undelivered(task.slot, task.grant);
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
  open_task(slot);
}

void TaskBook::skip_episode(std::uint32_t slot, const RolloutSegment& segment) {
  SlotStart& start = slots_[slot].starts.back();
  SlotStart fresh;
  fresh.segment = start.segment;
  fresh.episode = start.episode + segment.episode_end_step.size() + 1;
  start = std::move(fresh);
  open_task(slot);
}

// --- admission

Verdict TaskBook::refuse(const RolloutSegment& segment, const std::string& reason,
                         std::int64_t now_ns) {
  ++grants_.counts().invalid;
  last_refusal_ = fmt::format("slot={} segment={} worker={} build={:016x}: {}", segment.slot,
                              segment.segment, segment.worker_id, segment.build_id, reason);
  grants_.refuse(segment.slot, segment.worker_id, reason, now_ns);
  return Verdict::kInvalid;
}

Verdict TaskBook::repeat(const Admitted& first, const RolloutSegment& segment) {
  // Every duplicate is an audit, unless it was damaged on its way.
  if (segment_crc(segment) != segment.payload_crc32c) {
    ++grants_.counts().invalid;
    last_refusal_ = fmt::format("slot={} segment={} worker={}: CRC of a duplicate", segment.slot,
                                segment.segment, segment.worker_id);
    return Verdict::kInvalid;
  }
  ++grants_.counts().duplicate;
  const bool end_state = first.end_hash != segment.end_hash;
  if (end_state || first.crc != segment.payload_crc32c) {
    ++grants_.counts().audit_mismatch;
    if (!difference_) {
      difference_ = {
          segment.slot, segment.segment, end_state, {first.worker_id, segment.worker_id}};
    }
  }
  return Verdict::kDuplicate;
}

Verdict TaskBook::receive(RolloutSegment segment, std::int64_t now_ns) {
  ++grants_.counts().received;
  if (segment.source != Source::kSimulation || segment.slot >= kForeignSlot) {
    ++grants_.counts().foreign;
    return Verdict::kForeign;
  }
  grants_.worker_answered(segment.worker_id);
  const RolloutTask* task = find_open_task(segment.slot, segment.task_hash);
  if (task == nullptr) {
    if (const Admitted* first = find_admitted(segment.slot, segment.task_hash))
      return repeat(*first, segment);
    ++grants_.counts().stale;
    return Verdict::kStale;
  }
  if (const Result<void> ok = check_segment(segment, config_.shape, *task); !ok) {
    return refuse(segment, ok.error(), now_ns);
  }

  const Admitted record{segment.task_hash, segment.end_hash, segment.payload_crc32c,
                        segment.worker_id};
  const bool evaluation = segment.slot >= kEvaluationSlot;
  grants_.settle(segment.slot, segment.worker_id, segment.grant, now_ns,
                 evaluation || segment.failed == 0);
  if (evaluation) {
    ++grants_.counts().evaluated;
    Evaluation& row = evaluations_[segment.slot - kEvaluationSlot];
    row.admitted = record;
    // A recorded evaluation keeps its observations; of one that is only judged pictures would fill
    // the memory.
    if (row.task.frame_stride == 0) segment.observations = {};
    row.result = std::move(segment);
    return Verdict::kAdmitted;
  }
  Slot& slot = slots_[segment.slot];
  slot.recent[slot.recent_next++ % slot.recent.size()] = record;
  slot.home = segment.worker_id;
  if (segment.failed != 0) {
    ++grants_.counts().invalid;
    ++grants_.counts().failed;
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
  ++grants_.counts().received;
  ++grants_.counts().overflow;
  if (find_open_task(slot, task_hash) != nullptr) grants_.lapse_all(slot);
}

void TaskBook::foreign(std::uint64_t count) {
  grants_.counts().received += count;
  grants_.counts().foreign += count;
}

void TaskBook::refused(std::uint64_t count) {
  grants_.counts().received += count;
  grants_.counts().invalid += count;
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
  open_tasks();
  return segments;
}

void TaskBook::evaluate(std::span<const EvaluationTask> tasks) {
  OMENTUM_CHECK(evaluations_.empty() && !tasks.empty());
  OMENTUM_CHECK(tasks.size() < kForeignSlot - kEvaluationSlot);
  for (std::uint32_t i = 0; i < tasks.size(); ++i) {
    const EvaluationTask& from = tasks[i];
    OMENTUM_CHECK(versions_.contains(from.policy_version), "weights {} not announced",
                  from.policy_version);
    RolloutTask task = make_task(kEvaluationSlot + i, evaluation_round_, from.policy_version);
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
    grants_.open(task.slot, {.rank = kEvaluationRank, .steps = task.steps});
    evaluations_.emplace_back().task = std::move(task);
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
  for (const Evaluation& evaluation : evaluations_) tasks.push_back(evaluation.task);
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

Result<void> TaskBook::check_balance() const {
  const Ledger l = ledger();
  std::uint64_t stored = 0;
  for (const Slot& slot : slots_) stored += slot.done.size();
  if (grants_.balanced() && l.admitted == batch_ * config_.slots + stored + l.evaluated) return {};
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
